"""Fits on the transforms of whole records."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import (
    NAMES,
    NOISE,
    TRUTH,
    Roll,
    campaign,
    with_response,
)

from casid import (
    Constraint,
    ConvergenceError,
    Fit,
    OutputError,
    bootstrap,
    output_error,
    profile_parameters,
)

CLEAN = campaign()


def test_a_prior_adds_its_information():
    records, R = campaign(5), np.diag([NOISE[name] ** 2 for name in TRUTH.outputs])
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


def test_prices_are_slopes_of_the_cost():
    records, R = campaign(5), np.diag([NOISE[name] ** 2 for name in TRUTH.outputs])
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


def test_constraints_hold():
    fit = output_error(Tied(), campaign(6), domain="frequency")
    assert fit.model.Lped == pytest.approx(0.15 * fit.model.Llat, rel=1e-8)
    assert fit.constraints[0].active


@pytest.mark.slow
def test_a_profile_holds_the_spectra_of_its_free_fit():
    values = {"Lped": TRUTH.Lped * np.array([0.94, 0.97, 1.0, 1.03, 1.06])}
    estimator = OutputError(domain="frequency")
    found = profile_parameters(TRUTH, campaign(7), values=values, estimator=estimator)
    assert np.nanmax(np.abs(found.cost - found.parabola)) < 0.2
    low, high = found.intervals["Lped"]
    expected = found.cramer_rao["Lped"]
    np.testing.assert_allclose([low, high], expected, atol=0.1 * (expected[1] - expected[0]))


def test_a_fit_is_written_and_read(tmp_path):
    fit = output_error(TRUTH, campaign(8), domain="frequency")
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
        ({"domain": "laplace"}, "domain = 'laplace'"),
    ],
)
def test_settings_without_meaning_are_refused(settings, culprit):
    with pytest.raises(ValueError, match=culprit):
        output_error(TRUTH, CLEAN, **{"domain": "frequency"} | settings)


def test_lost_samples_are_filled_in_and_lost_channels_do_without():
    records = campaign(9)
    y = records[0].y.copy()
    y[np.random.default_rng(1).random(y.shape) < 0.02] = np.nan
    y[:, 1] = np.nan
    fit = output_error(TRUTH, [replace(records[0], y=y), *records[1:]], domain="frequency")
    z = [(fit[n].value - getattr(TRUTH, n)) / fit[n].cramer_rao for n in NAMES]
    assert np.abs(z).max() < 4


def test_what_records_do_not_tell_is_named():
    still = [replace(record, u=record.u * [1.0, 0.0]) for record in CLEAN]
    rng = np.random.default_rng(0)
    still = [with_response(record, TRUTH).with_noise(NOISE, rng) for record in still]
    with pytest.raises(ConvergenceError, match="do not determine Lped"):
        output_error(TRUTH, still, domain="frequency")


def test_a_bootstrap_scatters_as_stated_and_refuses_other_records():
    records, estimator = campaign(10), OutputError(domain="frequency")
    fit = estimator.fit(TRUTH, records)
    found = bootstrap(fit, records, estimator=estimator, runs=8)
    # The scatter of eight runs is known to a quarter, seven parameters average it.
    scatter = np.std(found.values, axis=0, ddof=1) / np.sqrt(np.diag(fit.covariance))
    assert 0.6 < np.sqrt(np.mean(scatter**2)) < 1.5
    louder = [replace(each, y=1.5 * each.y) for each in records]
    with pytest.raises(ValueError, match="not one of these records"):
        bootstrap(fit, louder, estimator=estimator, runs=2)
