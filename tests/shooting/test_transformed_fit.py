"""Fits on the transforms of whole records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter, lsim
from truths.closed_roll import (
    NAMES,
    NOISE,
    TRUTH,
    Roll,
    campaign,
    with_response,
)
from truths.structures import Banking

from casid import (
    Constraint,
    ConvergenceError,
    DataWarning,
    Fit,
    Model,
    OutputError,
    Record,
    Rows,
    Scalar,
    bootstrap,
    output_error,
    parameter,
    profile_parameters,
)

CLEAN = campaign()


@pytest.mark.second
def test_the_start_from_a_neighbour_of_more_records_changes_the_effort_only():
    records = campaign(5)
    estimator = OutputError(domain="frequency")
    wide = estimator.fit(TRUTH, records)
    beside = estimator.fit(wide.model, records[1:], near=wide)
    begun = estimator.fit(replace(TRUTH, Lp=0.7 * TRUTH.Lp), records[1:], near=wide)
    assert beside.iterations <= begun.iterations / 2
    assert beside.cost == pytest.approx(begun.cost, abs=1e-5)
    for one, other in zip(beside.parameters, begun.parameters, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-3 * other.std_error)


@pytest.mark.second
def test_a_neighbour_that_leads_nowhere_does_no_harm(monkeypatch):
    records, tried = campaign(5), []
    estimator = OutputError(domain="frequency")
    wide = estimator.fit(TRUTH, records)

    def hasty(options):
        tried.append(options)
        return replace(options, max_iterations=1)

    monkeypatch.setattr("casid.shooting.transformed_fit.close", hasty)
    start = replace(TRUTH, Lp=0.7 * TRUTH.Lp)
    again = estimator.fit(start, records, near=wide)
    assert len(tried) == 1
    assert again.cost == pytest.approx(wide.cost, abs=1e-4)


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


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:.*(few lines|follow the inputs)")
def test_prices_are_slopes_of_the_cost():  # held off the estimate, which colours the residuals
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
    np.testing.assert_array_equal(again.covariance, fit.covariance)
    assert again.notes.hold == campaign(8)[0].hold
    std = [again[name].std_error for name in again.free_names]
    np.testing.assert_allclose(np.sqrt(np.diag(again.covariance)), std)


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


@pytest.mark.second
@pytest.mark.filterwarnings("error::casid.DataWarning")
def test_samples_lost_by_the_clock_cost_what_they_tell_and_no_more():
    records = campaign(5)
    seventh = np.repeat(np.arange(records[0].N)[:, None] % 7 == 0, 3, axis=1)
    spoiled = [record.mask(seventh) for record in records]
    whole = output_error(TRUTH, records, domain="frequency")
    fit = output_error(TRUTH, spoiled, domain="frequency")
    # An estimate of 1/7 less data moves by sqrt(7/6 - 1) = 0.41 of its standard error.
    z = [(fit[n].value - whole[n].value) / whole[n].cramer_rao for n in NAMES]
    assert np.abs(z).max() < 4 * 0.41


def test_what_records_do_not_tell_is_named():
    still = [replace(record, u=record.u * [1.0, 0.0]) for record in CLEAN]
    rng = np.random.default_rng(0)
    still = [with_response(record, TRUTH).with_noise(NOISE, rng) for record in still]
    with pytest.raises(ConvergenceError, match="do not determine Lped"):
        output_error(TRUTH, still, domain="frequency")


@pytest.mark.slow
def test_a_bootstrap_scatters_as_stated_and_refuses_other_records():
    records, estimator = campaign(10), OutputError(domain="frequency")
    fit = estimator.fit(TRUTH, records)
    found = bootstrap(fit, records, estimator=estimator, runs=8)
    # The scatter of eight runs is known to a quarter, seven parameters average it.
    scatter = np.std(found.values, axis=0, ddof=1) / np.sqrt(np.diag(fit.covariance))
    assert 0.6 < np.sqrt(np.mean(scatter**2)) < 1.5
    louder = [replace(each, y=1.5 * each.y) for each in records]
    with pytest.raises(ValueError, match="not estimated from these records"):
        bootstrap(fit, louder, estimator=estimator, runs=2)


class Pitch(Model):
    """Two states of a short period."""

    states = ("w", "q")
    inputs = ("lon",)
    outputs = ("w", "q")
    Zw: Scalar = parameter(default=-0.7, lower=-5.0, upper=2.0, unit="1/s")
    Mw: Scalar = parameter(default=-0.08, lower=-2.0, upper=2.0, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-1.2, lower=-10.0, upper=2.0, unit="1/s")
    Mlon: Scalar = parameter(default=6.0, lower=-100.0, upper=100.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Zw, 20.0], [self.Mw, self.Mq]]

    def B(self) -> Rows:
        return [[-8.0], [self.Mlon]]


def gusty(seed, turbulence=(0.6, 0.03)):
    """A 3-2-1-1 of 12 s flown in white gusts, integrated by steps of a sampling interval."""
    rng, h = np.random.default_rng(seed), 0.04
    t = h * np.arange(300)
    s = (t - 1.0) / 0.5
    u = 0.05 * (-1) ** seed * np.select([s < 0, s < 3, s < 5, s < 6, s < 7], [0, 1, -1, 1, -1], 0.0)
    step = expm(h * np.array([[-0.7, 20.0, -8.0], [-0.08, -1.2, 6.0], [0, 0, 0]]))[:2]
    x = np.zeros((len(t), 2))
    for k in range(len(t) - 1):
        gust = np.array(turbulence) * np.sqrt(h) * rng.standard_normal(2)
        x[k + 1] = step @ [*x[k], u[k]] + gust
    y = x + np.array([0.2, 0.01]) * rng.standard_normal(x.shape)
    return Record(t, u[:, None], y, ("lon",), ("w", "q"), f"gusty {seed}", hold="zoh")


def test_a_spectrum_from_few_lines_is_told():
    with pytest.warns(DataWarning, match="rests on few lines"):
        output_error(Pitch(), [gusty(0)], domain="frequency")


def test_a_spectrum_from_many_lines_or_without_colour_is_not():
    output_error(Pitch(), [gusty(k) for k in range(5)], domain="frequency")
    output_error(Pitch(), gusty(0, (0.0, 0.0)), domain="frequency")


def test_a_covariance_that_is_given_leaves_errors_alone():
    records = [gusty(k, (0.0, 0.0)) for k in range(2)]
    found = output_error(Pitch(), records, R=np.diag([0.04, 1e-4]), domain="frequency")
    errors = np.array([found[name].std_error / found[name].cramer_rao for name in found.free_names])
    assert np.all(np.abs(errors - 1) < 0.3)


@pytest.mark.second
def test_errors_are_those_of_the_noise_there_is_whatever_covariance_is_given():
    R = np.diag([(2 * NOISE[name]) ** 2 for name in TRUTH.outputs])
    fit = output_error(TRUTH, campaign(3, count=8), R=R, domain="frequency")
    errors = np.array([fit[name].std_error / fit[name].cramer_rao for name in NAMES])
    assert np.all(np.abs(errors - 0.5) < 0.1)


@pytest.mark.second
def test_errors_of_coloured_noise_under_a_white_covariance_are_stated():
    R, a, z = np.diag([NOISE[name] ** 2 for name in TRUTH.outputs]), 0.9, []
    for seed in range(8):
        rng, spoilt = np.random.default_rng(seed), []
        for record in campaign(count=4):
            white = rng.standard_normal((record.N + 300, 3)) * np.sqrt((1 - a**2) * np.diag(R))
            spoilt.append(replace(record, y=record.y + lfilter([1], [1, -a], white, axis=0)[300:]))
        fit = output_error(TRUTH, spoilt, R=R, domain="frequency")
        z.append([(fit[n].value - getattr(TRUTH, n)) / fit[n].std_error for n in NAMES])
    # White noise of that variance would have (1 + a) / (1 - a) = 19 times less power at low
    # frequencies. 8 runs of 7 parameters, not independent.
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5


def sampled(seed, steps=(0.02, 0.025, 0.04, 0.05)):
    """Records of Lp = -4, Llat = 10 at several intervals, in noise of first order."""
    found, system = [], ([[-4.0, 0.0], [1.0, 0.0]], [[10.0], [0.0]], np.eye(2), np.zeros((2, 1)))
    for k, dt in enumerate(steps):
        rng, t = np.random.default_rng([seed, k, 5]), np.arange(0, 12, dt)
        u = 0.2 * np.sign(np.sin(1.5 * t)) * (t > 0.5) * (t < 11)
        e = lfilter([1], [1, -0.9], rng.standard_normal((len(t) + 400, 2)), axis=0)[400:]
        y = lsim(system, u, t)[1] + np.sqrt(1 - 0.9**2) * e * [0.03, 0.01]
        found.append(Record(t, u[:, None], y, Banking.inputs, Banking.outputs, f"at {dt} s"))
    return found


@pytest.mark.parametrize(
    "runs",
    [pytest.param(2, marks=pytest.mark.second), pytest.param(40, marks=pytest.mark.campaign)],
)
def test_records_of_different_sampling_have_errors_that_hold_and_no_doubt(runs):
    z = []
    for seed in range(runs):
        fit = output_error(Banking(), sampled(seed), domain="frequency")
        z.append([(fit["Lp"].value + 4) / fit["Lp"].std_error])
        z.append([(fit["Llat"].value - 10) / fit["Llat"].std_error])
    # 1.35 where what is weighed by spectra of four kinds counts as though these were known.
    assert np.sqrt(np.mean(np.square(z))) < (1.2 if runs > 20 else 2.5)


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:.*rests on few lines")
def test_kinds_weighed_by_spectra_of_their_own_widen_errors_and_those_of_a_given_covariance_do_not(
    monkeypatch,
):
    def variances(times, **given):
        weighed = "casid.shooting.transformed_fit.weighed_apart"
        monkeypatch.setattr(weighed, lambda *_: np.full(2, times))
        way = OutputError(domain="frequency", **given)
        return way.fit(Banking(), sampled(0)).covariance

    np.testing.assert_allclose(variances(4.0), 4 * variances(1.0))
    given = {"R": np.diag([0.03, 0.01]) ** 2}
    np.testing.assert_allclose(variances(4.0, **given), variances(1.0, **given))


@pytest.mark.campaign
def test_errors_from_one_record_in_gusts_are_not_far_too_small():
    z = []
    for seed in range(40):
        with pytest.warns(DataWarning, match="rests on few lines"):
            fit = output_error(Pitch(), gusty(100 + seed), domain="frequency")
        z.append([(fit[n].value - getattr(Pitch(), n)) / fit[n].std_error for n in fit.free_names])
    assert np.sqrt(np.mean(np.square(z))) < 1.5
