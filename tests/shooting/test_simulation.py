"""Nonlinear structures simulated and predicted."""

from dataclasses import replace
from types import MappingProxyType

import casadi as ca
import numpy as np
import pytest
import scipy
from truths.felt import Felt, felt
from truths.swing import TRUTH, SmallSwing, Swing, WrittenOut, integrated, steps, swung
from truths.thrust import Saturating

from casid import (
    DataWarning,
    ModelError,
    NonlinearModel,
    Record,
    Scalar,
    filtering,
    parameter,
    simulate,
    validate,
)
from casid.prediction import prediction_plan
from casid.shooting.simulation import _ExtendedFilter, fitting_start, predict_nonlinear


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_simulation_is_scipys(hold):
    record = swung(3, duration=6.0, hold=hold)
    exact = integrated(TRUTH, record.t, record.u, hold, [0.2, 0.5])
    found = simulate(TRUTH, record, {"q": 0.2, "theta": 0.5})
    np.testing.assert_allclose(found.y, exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def test_what_is_not_late_is_felt_at_once_though_not_to_first_order_at_the_reference():
    record = felt(Felt, 0.0)
    found = simulate(Felt(), record, {"q": 0.0})
    np.testing.assert_allclose(found.y, record.y, rtol=0, atol=1e-6 * np.abs(record.y).max())
    assert validate({"true": Felt()}, [record]).fit["true"].min() > 99.99


def test_a_simulation_that_runs_away_is_told():
    with pytest.raises(ModelError, match="Swing runs away: outputs are not finite from sample"):
        simulate(replace(TRUTH, Mq=80.0), swung(3), {"theta": 0.5})
    with pytest.raises(ValueError, match="start names 'u'; the states are q, theta"):
        simulate(TRUTH, swung(3), {"u": 0.5})


def test_a_simulation_that_cannot_be_exact_says_so():
    t = 2.0 * np.arange(10)
    u = np.column_stack([np.arange(10) % 2, np.zeros(10)])
    coarse = Record(t, u, np.zeros((10, 2)), Saturating.inputs, Saturating.outputs, "coarse")
    said = r"record 'coarse' moves by [0-9e.-]+ of its span as steps are halved to 128 a sampling"
    with pytest.warns(DataWarning, match=said):
        simulate(Saturating(rate=45.0), coarse, {"w": 0.0, "n": 0.0})


@pytest.mark.second
def test_validation_takes_a_nonlinear_structure_as_such():
    # Noise alone is left of the truth; its linearisation is worse by far.
    records = [swung(seed) for seed in (1, 2)]
    found = validate({"true": TRUTH, "linear": TRUTH.at({})}, records)
    np.testing.assert_allclose(found.rms["true"], 0.02, rtol=0.1)
    assert (found.rms["linear"] > 3 * found.rms["true"]).all()
    # Outputs are weighted by their spread over all records, which loses that between the means.
    shifted = validate({"true": TRUTH}, [record.detrend("mean") for record in records])
    np.testing.assert_allclose(shifted.rms["true"], found.rms["true"], rtol=1e-4)


class Blind(Swing):
    """A pendulum whose angle nothing measures."""

    outputs = ("q",)
    units = MappingProxyType({"q": "rad/s"})


@pytest.mark.second
def test_a_long_swing_from_an_unknown_angle_is_followed():
    # From rest no step that all 20 s ask for leads to the start; the first second's does.
    model, t = Blind(Mq=-0.03, M=6.0, Mlon=8.0, tau=0.0), np.arange(0.0, 20.0, 0.05)
    u = 0.15 * np.sin(1.3 * t)[:, None]
    q = integrated(model, t, u, "foh", [0.3, 2.0])[:, :1]
    record = Record(t, u, q, ("lon",), ("q",)).with_noise({"q": 0.02}, np.random.default_rng(1))
    found = validate({"true": model}, record, horizon=np.inf)
    assert found.rms["true"] == pytest.approx(0.02, rel=0.15)
    np.testing.assert_allclose(found.initial_states["true"][0], [0.3, 2.0], atol=0.01)


@pytest.mark.second
@pytest.mark.parametrize(
    ("horizon", "closed_loop", "biases"),
    [
        (np.inf, False, True),
        (1.0, False, True),
        (1.0, True, True),
        (np.inf, False, False),
        (np.inf, False, ("q",)),
        (1.0, False, ("q",)),
    ],
)
def test_a_linear_structure_written_as_a_nonlinear_one_is_judged_alike(
    horizon, closed_loop, biases
):
    small = SmallSwing(Mq=-0.8, M=6.0, Mlon=8.0, tau=0.073)
    record = swung(5, size=0.05)
    models = {"linear": small, "written": WrittenOut().with_values_of(small)}
    record = replace(record, y=record.y + np.array([0.02, 0.01]))
    found = validate(models, record, horizon=horizon, closed_loop=closed_loop, biases=biases)
    for name in ("rms", "biases"):
        ours, theirs = (getattr(found, name)[each] for each in models)
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-5)


@pytest.mark.second
def test_only_the_past_tells_the_state_that_a_prediction_begins_with():
    record = swung(6)
    far, scale = prediction_plan([TRUTH.system()], record, 1.0), np.ones(2)
    last = record.t > record.t[far.starts[-1]]
    spoilt = replace(record, y=record.y + 0.5 * last[:, None])
    first, other = (predict_nonlinear(TRUTH, each, scale, far).y for each in (record, spoilt))
    np.testing.assert_array_equal(first, other)
    assert np.isfinite(first[record.t > record.t[far.starts[0]]]).all()


def moved(x, record, at, substeps=2):
    """States (n, 2) of the pendulum one sample after those at samples, by Runge and Kutta."""
    h = record.dt / substeps

    def f(x, t):
        q, theta = x.T
        lon = np.interp(t - TRUTH.tau, record.t, record.u[:, 0])
        moment = TRUTH.Mq * q - TRUTH.M * np.sin(theta) + TRUTH.Mlon * np.cos(theta) * lon
        return np.column_stack([moment, q])

    for s in range(substeps):
        t = record.t[at] + s * h
        k1 = f(x, t)
        k2 = f(x + h / 2 * k1, t + h / 2)
        k3 = f(x + h / 2 * k2, t + h / 2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3, t + h))
    return x


def disturbed_swing(seed, duration=6.0, size=1.2, w=0.1):
    """A record of the pendulum over more than a right angle, pushed by white noise."""
    t, rng = 0.04 * np.arange(round(duration / 0.04)), np.random.default_rng([seed, 2])
    still = Record(t, steps(seed, t, size), np.zeros((len(t), 2)), ("lon",), ("q", "theta"))
    x = [np.array([[0.0, 0.1]])]
    for k in range(len(t) - 1):
        x.append(moved(x[-1], still, [k]) + w * np.array([rng.standard_normal(), 0.0]))
    y = np.concatenate(x) + 0.02 * rng.standard_normal((len(t), 2))
    return replace(still, y=y)


@pytest.mark.second
def test_at_large_amplitude_states_are_those_of_least_squares_over_all_disturbances(monkeypatch):
    monkeypatch.setattr(filtering, "LEVELS", np.array([10.0]))  # about the truth
    record = disturbed_swing(21)
    asked = (75, 100, 140)
    follower = _ExtendedFilter(TRUTH, record, np.ones(2), 1.0)
    for k, known in zip(asked, follower.known(asked), strict=True):
        x, deviation = least_squares(record, k, np.diag(known.Q[0]), known.r)
        # What is known at a sample is not relinearised later, therefore not the same.
        assert (np.abs(follower.origin + known.x - x) < 0.05 * deviation).all()


def least_squares(record, last, q, r):
    """State at a sample and its deviation, of all states before it and biases at once."""

    def residuals(z):
        x, bias = z[:-2].reshape(-1, 2), z[-2:]
        missed = x[1:] - moved(x[:-1], record, np.arange(last))
        seen = x + bias - record.y[: last + 1]
        return np.concatenate([(seen / np.sqrt(r)).ravel(), (missed / np.sqrt(q)).ravel()])

    start = np.append(record.y[: last + 1].ravel(), [0.0, 0.0])
    found = scipy.optimize.least_squares(residuals, start, x_scale="jac", xtol=1e-10, ftol=1e-12)
    deviation = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    return found.x[-4:-2], deviation[-4:-2]


@pytest.mark.second
def test_predictions_of_a_disturbed_flight_err_less_than_a_fit_without_disturbances():
    record = disturbed_swing(31, duration=12.0)
    far = prediction_plan([TRUTH.system()], record, 1.0)
    found = predict_nonlinear(TRUTH, record, record.y.std(axis=0), far)
    ours = np.sqrt(np.nanmean((found.y - record.y) ** 2, axis=0))
    theirs = np.sqrt(np.mean(list(without_disturbances(record, far)), axis=0))
    assert (ours < 0.8 * theirs).all()


def without_disturbances(record, far):
    """Squared errors (n, 2) from each start, of a fit of three horizons before it."""
    for start, end in zip(far.starts, (*far.starts[1:], record.N - 1), strict=True):
        past = record.take(slice(start - far.past, start + 1))
        ahead = record.take(slice(start - far.past, end + 1))
        y = simulate(TRUTH, ahead, fitting_start(TRUTH, past)).y
        yield np.mean((y - ahead.y)[far.past + 1 :] ** 2, axis=0)


class Tank(NonlinearModel):
    """A tank that runs out; the equation has no value of a level below zero."""

    states, inputs, outputs = ("level",), ("pump",), ("level",)
    c: Scalar = parameter(default=1.0, lower=0.0, upper=5.0, unit="-")

    def derivatives(self, x, u):
        return [u.pump - self.c * ca.sqrt(x.level)]

    def reference(self):
        return {"level": 1.0, "pump": 1.0}


@pytest.mark.second
def test_where_the_equations_have_no_value_the_last_linearisation_stays():
    t = 0.05 * np.arange(400)
    empty = Record(t, 1 + 0.3 * np.sin(t)[:, None], np.zeros((400, 0)), ("pump",), ())
    y = simulate(Tank(), empty, {"level": 1.0}).y
    noise = 0.001 * np.random.default_rng(1).standard_normal(y.shape)
    noise[130] = -3.0  # at no start: starts are every 20 samples from 60 on
    record = Record(t, empty.u, y + noise, ("pump",), ("level",))
    far = prediction_plan([Tank().system()], record, 1.0)
    assert 130 not in far.starts
    found = predict_nonlinear(Tank(), record, np.ones(1), far)
    assert np.isfinite(found.y[61:]).all()


class Flying(NonlinearModel):
    """An angle of attack that settles the faster the faster the aircraft is."""

    states, inputs, outputs = ("V", "a"), ("el",), ("V", "a")
    k: Scalar = parameter(default=1.0, lower=0.1, upper=5.0, unit="1/m")
    E: Scalar = parameter(default=0.6, lower=0.0, upper=10.0, unit="1/m")
    usual: float = 20.0

    def derivatives(self, x, u):
        return [-1e-9 * x.V, x.V * (self.E * u.el - self.k * x.a)]

    def reference(self):
        return {"V": self.usual}


@pytest.mark.second
@pytest.mark.parametrize("horizon", [None, 1.0])
@pytest.mark.parametrize(("usual", "V"), [(20.0, 20.0), (20.0, 60.0), (1.0, 100.0)])
def test_steps_follow_what_is_flown_wherever_the_reference_is(usual, V, horizon):
    t = 0.05 * np.arange(160)
    el = 0.1 * np.sign(np.sin(1.7 * t))
    decay, a = np.exp(-0.05 * V), [0.0]
    for now in el[:-1]:  # exactly, as steps are held
        a.append(a[-1] * decay + 0.6 * now * (1 - decay))
    y = np.column_stack([np.full(160, V), a])
    record = Record(t, el[:, None], y, ("el",), ("V", "a"), "fast", hold="zoh")
    found = validate({"fast": Flying(usual=usual)}, [record], horizon=horizon)
    assert found.rms["fast"][0, 1] < 1e-3 * np.std(a)


class High(NonlinearModel):
    """A fast mode of small rates, away from the reference, beside an altitude."""

    states, inputs, outputs = ("h", "V", "q"), ("de",), ("h", "V", "q")

    m: Scalar = parameter(default=0.04, lower=0.001, upper=1.0, unit="1/m")

    def derivatives(self, x, u):
        return [x.V * x.q, 0.01 * (250.0 - x.V), self.m * x.V * (u.de - x.q)]

    def reference(self):
        return {"V": 20.0}


def test_steps_are_short_enough_for_every_output():
    t = 0.25 * np.arange(40)
    de = 1e-4 * np.sin(2 * t)
    still = Record(t, de[:, None], np.zeros((40, 3)), ("de",), ("h", "V", "q"), "high")
    found = simulate(High(), still, {"h": 1e4, "V": 250.0, "q": 0.0})
    A, B = -0.04 * 250, 0.04 * 250  # of q, whose input is straight between samples
    expected = np.zeros(40)
    for k in range(39):
        slope = (de[k + 1] - de[k]) / 0.25
        steady = de[k] - slope / B, slope  # q' = B (de - q)
        decay = np.exp(A * 0.25)
        expected[k + 1] = steady[0] + steady[1] * 0.25 + (expected[k] - steady[0]) * decay
    np.testing.assert_allclose(found.y[:, 2], expected, atol=1e-5 * np.abs(expected).max())
