"""Output error on the transforms of whole records, against the time domain and the truth."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import NAMES, TRUTH, Roll, flown, off, relative_error, with_response

from casid import (
    Constraint,
    ConvergenceError,
    Fit,
    OutputError,
    Record,
    output_error,
    profile_parameters,
)
from casid.model import free_parameters
from casid.shooting.lines import transformed
from casid.shooting.spectral import SpectralResiduals
from casid.shooting.spectrum import smoothed

NOISE = {"ay": 0.05, "p": 0.01, "phi": 0.01}
CLEAN = [flown(seed=seed) for seed in range(3)]


def noisy(seed, records=CLEAN):
    rng = np.random.default_rng([seed, 3])
    return [record.with_noise(NOISE, rng) for record in records]


def residuals(records, values):
    lines = transformed(records)
    weights = [np.repeat(each.weight[:, None], each.Y.shape[1], 1) for each in lines]
    return SpectralResiduals(free_parameters(TRUTH), lines)(values, weights)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("N", [600, 599])
def test_the_truth_leaves_no_residual_on_any_line(hold, N):
    # An unstable model, a delay between samples, a state at the start and biases: all exact.
    record = replace(CLEAN[0].take(slice(0, N)), hold=hold)
    record = with_response(record, TRUTH, np.array([0.3, -0.02, 0.01]), [0.1, 0.2, 0.3])
    (found,) = residuals([record], TRUTH.vector())
    assert np.abs(found.E).max() < 1e-11 * np.abs(transformed([record])[0].Y).max()


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_gradient_is_that_of_the_cost_without_transients(hold):
    records = [replace(record, hold=hold) for record in noisy(0)[:2]]
    lam, gradient = 1.05 * TRUTH.vector(), np.zeros(len(NAMES))
    for i, size in enumerate(np.abs(lam)):
        step = 1e-5 * size * np.eye(len(lam))[i]
        ahead, behind = (sum(r.cost for r in residuals(records, lam + s)) for s in (step, -step))
        gradient[i] = (ahead - behind) / (2 * step[i])
    analytic = sum(each.g for each in residuals(records, lam))
    np.testing.assert_allclose(analytic, gradient, rtol=1e-5)


def test_a_noise_free_truth_is_found_from_afar():
    fit = output_error(off(share=0.2), CLEAN, domain="frequency")
    assert relative_error(fit).max() < 1e-5
    np.testing.assert_allclose(fit.initial_states[0], [0.3, -0.02, 0.01], atol=1e-4)
    np.testing.assert_allclose(fit.biases[0], [0.1, 0.01, -0.02], atol=1e-4)


def test_white_noise_of_known_variance_makes_both_domains_one():
    # Then the transform changes nothing: the likelihoods are the same function of λ, but for the
    # line of the biases.
    records, R = noisy(1), np.diag([NOISE[name] ** 2 for name in TRUTH.outputs])
    time = output_error(TRUTH, records, R=R)
    frequency = output_error(TRUTH, records, R=R, domain="frequency")
    for name in NAMES:
        row, other = time[name], frequency[name]
        assert abs(row.value - other.value) < 1e-3 * row.cramer_rao
        assert other.cramer_rao == pytest.approx(row.cramer_rao, rel=1e-4)


def test_both_domains_agree_where_the_structure_is_right():
    records = noisy(2)
    time, frequency = (output_error(off(), records, domain=d) for d in ("time", "frequency"))
    apart = [(frequency[n].value - time[n].value) / time[n].cramer_rao for n in NAMES]
    # A spectrum of some 40 degrees of freedom costs √(2/40) of a standard error at most.
    assert np.sqrt(np.mean(np.square(apart))) < 0.3


def test_spectra_are_those_of_the_noise():
    found = output_error(TRUTH, noisy(3), domain="frequency").notes.spectra
    assert [each.records for each in found] == [("record 0", "record 1", "record 2")]
    power = found[0].power / [NOISE[name] ** 2 for name in TRUTH.outputs]
    assert np.all((power > 0.5) & (power < 2.0))
    np.testing.assert_allclose(power[-10:].mean(axis=0), 1.0, atol=0.1)


def test_noise_in_a_band_counts_less_there():
    # A sine of noise as large as the signal, on one line of every record, ruins white weights.
    rng, k = np.random.default_rng(0), 12
    t = CLEAN[0].t
    spoilt = []
    for record in noisy(4):
        sine = 0.3 * np.sin(2 * np.pi * k * t / (600 * 0.02) + rng.uniform(0, 2 * np.pi))
        spoilt.append(replace(record, y=record.y + sine[:, None] * [1.0, 0.3, 0.3]))
    errors = [
        np.mean(relative_error(output_error(TRUTH, spoilt, domain=domain)))
        for domain in ("frequency", "time")
    ]
    assert errors[0] < 0.5 * errors[1]


def test_smoothing_keeps_a_flat_spectrum_and_widens_where_lines_are_few():
    omega = np.arange(1.0, 301.0)
    power, freedom = np.full(300, 6.0), np.full(300, 2.0)
    np.testing.assert_allclose(smoothed(omega, power, freedom, omega), 3.0)
    power = np.where(omega > 100, 8.0, 2.0)
    found = smoothed(omega, power, freedom, np.array([1.0, 60.0, 150.0]))
    np.testing.assert_allclose(found, [1.0, 1.0, 4.0])


def test_prices_are_slopes_of_the_cost():
    records, R = noisy(5), np.diag([NOISE[name] ** 2 for name in TRUTH.outputs])
    bounds, costs = -1.9, []
    for bound in (bounds - 1e-3, bounds + 1e-3):
        held = {"Lp": (bound, 0.0)}
        fit = output_error(TRUTH, records, R=R, domain="frequency", bounds=held)
        costs.append(fit.cost)
    price = output_error(TRUTH, records, R=R, domain="frequency", bounds={"Lp": (bounds, 0.0)})[
        "Lp"
    ]
    assert price.active
    assert price.multiplier == pytest.approx((costs[1] - costs[0]) / 2e-3, rel=1e-3)


def test_a_prior_adds_its_information():
    records, R = noisy(5), np.diag([NOISE[name] ** 2 for name in TRUTH.outputs])
    alone = output_error(TRUTH, records, R=R, domain="frequency")["Lp"]
    prior = {"Lp": (alone.value + 0.1 * alone.cramer_rao, 0.5 * alone.cramer_rao)}
    both = output_error(TRUTH, records, R=R, domain="frequency", priors=prior)["Lp"]
    # Two normal distributions of variances 1 and 1/4 meet at 4/5 of the way, with variance 1/5.
    shift = (both.value - alone.value) / alone.cramer_rao
    assert shift == pytest.approx(0.08, rel=0.05)
    assert both.cramer_rao == pytest.approx(alone.cramer_rao / np.sqrt(5), rel=0.01)


class Tied(Roll):
    """Twenty times its yaw control is three times its roll control."""

    def constraints(self):
        return [Constraint("tie", 20 * self.Lped - 3 * self.Llat, 0.0, 0.0)]


def test_constraints_hold():
    fit = output_error(Tied(), noisy(6), domain="frequency")
    assert fit.model.Lped == pytest.approx(0.15 * fit.model.Llat, rel=1e-8)
    assert fit.constraints[0].active


@pytest.mark.slow
def test_a_profile_holds_the_spectra_of_its_free_fit():
    values = {"Lped": TRUTH.Lped * np.array([0.94, 0.97, 1.0, 1.03, 1.06])}
    estimator = OutputError(domain="frequency")
    found = profile_parameters(TRUTH, noisy(7), values=values, estimator=estimator)
    assert np.nanmax(np.abs(found.cost - found.parabola)) < 0.2
    low, high = found.intervals["Lped"]
    expected = found.cramer_rao["Lped"]
    np.testing.assert_allclose([low, high], expected, atol=0.1 * (expected[1] - expected[0]))


def test_a_fit_is_written_and_read(tmp_path):
    fit = output_error(TRUTH, noisy(8), domain="frequency")
    fit.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json", model=Roll)
    np.testing.assert_array_equal(again.notes.spectra[0].power, fit.notes.spectra[0].power)


@pytest.mark.parametrize(
    ("settings", "culprit"),
    [
        ({"interval": 1.0}, "interval"),
        ({"process_noise": True}, "process_noise"),
        ({"biases": False}, "biases"),
        ({"R": "full"}, "R does not go"),
        ({"domain": "laplace"}, "domain='laplace'"),
    ],
)
def test_settings_without_meaning_are_refused(settings, culprit):
    with pytest.raises(ValueError, match=culprit):
        output_error(TRUTH, CLEAN, **{"domain": "frequency"} | settings)


def test_a_record_that_is_not_sampled_evenly_is_refused():
    t = CLEAN[0].t + 0.005 * np.sin(np.arange(600))
    record = Record(t, CLEAN[0].u, CLEAN[0].y, CLEAN[0].inputs, CLEAN[0].outputs, "uneven")
    with pytest.raises(ValueError, match="'uneven' is not sampled evenly"):
        output_error(TRUTH, record, domain="frequency")


def test_lost_samples_are_filled_in_and_lost_channels_do_without():
    records = noisy(9)
    y = records[0].y.copy()
    y[np.random.default_rng(1).random(y.shape) < 0.02] = np.nan
    y[:, 1] = np.nan
    fit = output_error(TRUTH, [replace(records[0], y=y), *records[1:]], domain="frequency")
    z = [(fit[n].value - getattr(TRUTH, n)) / fit[n].cramer_rao for n in NAMES]
    assert np.abs(z).max() < 4


def test_what_records_do_not_tell_is_named():
    still = [replace(record, u=record.u * [1.0, 0.0]) for record in CLEAN]
    still = [with_response(record, TRUTH) for record in still]
    with pytest.raises(ConvergenceError, match="do not determine Lped"):
        output_error(TRUTH, noisy(0, still), domain="frequency")


@pytest.mark.slow
def test_errors_are_as_small_as_stated():
    z = []
    for seed in range(60):
        fit = output_error(TRUTH, noisy(seed), domain="frequency")
        z.append([(fit[n].value - getattr(TRUTH, n)) / fit[n].cramer_rao for n in NAMES])
    # 60 runs of 7 parameters, not independent: 0.05 is two standard deviations or so.
    assert 0.9 < np.sqrt(np.mean(np.square(z))) < 1.1
    assert 0.92 < np.mean(np.abs(z) < 1.96) < 0.985
