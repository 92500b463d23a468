"""Cards flown in the nonlinear structure that they were designed for."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from casid import (
    DataWarning,
    DesignSettings,
    Limits,
    NonlinearModel,
    Record,
    Trim,
    design_inputs,
    output_error,
    parameter,
    simulate,
)
from casid.design.flight import Flight
from casid.design.problem import problem_of
from models.rigid_body import RigidBody

NOISE = {"q": 0.01, "theta": 0.01}
GAIN = 0.4  # of m by q
TRIM = 0.8  # rad


class Pendulum(NonlinearModel):
    """Softens upwards: its swing is larger than that of its linearisation."""

    states, inputs, outputs = ("q", "theta"), ("m",), ("q", "theta")
    k: float = parameter(default=2.0, lower=0.1, upper=9.0, unit="1/s^2")
    c: float = parameter(default=0.5, lower=0.0, upper=9.0, unit="1/s")

    def reference(self):
        return {"theta": TRIM, "m": 2.0 * np.sin(TRIM)}

    def derivatives(self, x, u):
        return [u.m - self.k * ca.sin(x.theta) - self.c * x.q, x.q]


def flight(model, feedback, h, N, limits, noise=NOISE):
    settings = DesignSettings(dt=h, draws=0, rest=0.0)
    problem = problem_of(model.at({}), limits, h * (N - 1), None, noise, settings)
    task = replace(problem, feedback=feedback).task(h)
    return Flight(model, None, problem.frees[0], feedback, task), task


def swung(t, r, k=2.0, trim=TRIM):
    """Deviations of θ under u = r - K q from an integrator of its own."""

    def rate(s, x):
        u = k * np.sin(trim) + np.interp(s, t, r) - GAIN * x[0]
        return [u - k * np.sin(x[1]) - 0.5 * x[0], x[0]]

    found = solve_ivp(rate, (0, t[-1]), [0.0, trim], t_eval=t, rtol=1e-9, atol=1e-12, max_step=0.02)
    return found.y[1] - trim


def test_a_flight_is_that_of_an_integrator_of_continuous_time_to_second_order():
    def error(h):
        t = h * np.arange(round(8.0 / h) + 1)
        r = 0.3 * np.sin(1.3 * t)
        made, _ = flight(Pendulum(), {"m": {"q": GAIN}}, h, len(t), Limits(sticks={"m": 0.3}))
        return np.abs(made.fly(r[:, None])[:, 2] - swung(t, r)).max()

    assert error(0.02) < 1e-3
    assert error(0.04) / error(0.02) == pytest.approx(4.0, abs=1.0)


def test_a_small_flight_with_delays_is_that_of_the_linear_loop():
    model = RigidBody(tau_lat=0.05, tau_lon=0.0, tau_col=0.11)
    feedback = {"lat": {"p": 0.1, "phi": 0.2}, "lon": {"q": 0.2, "theta": 0.3}}
    limits = Limits(sticks=dict.fromkeys(RigidBody.inputs, 0.1))
    noise = dict.fromkeys(RigidBody.outputs, 0.01)
    made, task = flight(model, feedback, 0.04, 301, limits, noise)
    r = 1e-6 * np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], (31, 4)), 10, axis=0)[:301]
    r[0] = 0.0
    linear = task.loops[0].fly(r).signals  # exact for lines between samples
    off = np.abs(made.fly(r) - linear).max(axis=0) / np.abs(linear).max(axis=0)
    assert off.max() < 0.01


@pytest.mark.second
def test_limits_hold_in_the_nonlinear_structure_where_its_linearisation_would_exceed_them():
    limits = Limits(sticks={"m": 2.0}, responses={"theta": 0.7})
    settings = DesignSettings(dt=0.05, iterations=12, draws=0, method="steps")
    made = design_inputs(
        Pendulum(), limits, 12.0, noise=NOISE, feedback={"m": {"q": GAIN}}, settings=settings
    )
    for each in made.alternatives:  # all on the same terms
        assert np.abs(swung(made.t, each.r[:, 0])).max() < 0.7 * 1.002
    assert np.abs(swung(made.t, made.r[:, 0])).max() > 0.95 * 0.7
    assert np.abs(made.y[:, 1] - swung(made.t, made.r[:, 0])).max() < 0.01
    assert made.used["theta"] > 0.95
    assert made.limits == {"m": 2.0, "theta": 0.7}
    np.testing.assert_array_equal(made.r, made.alternatives[-1].r)
    unknown = Trim(values={"theta": TRIM, "m": 2.0 * np.sin(TRIM)}, unknown=("m",))
    alone = design_inputs(
        Pendulum(), limits, 12.0, noise=NOISE, feedback={"m": {"q": GAIN}}, trim=unknown,
        settings=settings,
    )  # fmt: skip
    assert np.abs(alone.y[:, 1]).max() == pytest.approx(0.7, rel=0.01)


@pytest.mark.second
def test_limits_hold_for_all_of_an_ensemble_each_in_its_own_trim():
    limits = Limits(sticks={"m": 2.0}, responses={"theta": 0.4})
    settings = DesignSettings(dt=0.05, iterations=3, draws=0, method="steps")
    options = {"noise": NOISE, "feedback": {"m": {"q": GAIN}}, "settings": settings}
    trim = {"theta": TRIM, "m": 2.0 * np.sin(TRIM)}
    made = design_inputs(Pendulum(), limits, 12.0, trim=trim, ensemble=[Pendulum(k=1.6)], **options)
    near = minimize_scalar(
        lambda a: (a - TRIM) ** 2 + (1.6 * np.sin(a) / 2 / np.sin(TRIM) - 1) ** 2, (0.5, 1.2)
    )
    other = np.abs(swung(made.t, made.r[:, 0], 1.6, near.x)).max()
    assert other == pytest.approx(0.4, rel=0.02)
    assert made.used["theta"] < 0.95
    assert made.used_at_worst["theta"] == pytest.approx(1.0, abs=0.02)


def test_the_record_of_a_design_has_the_total_values_of_its_trim():
    limits = Limits(sticks={"m": 0.5}, responses={"theta": 0.3})
    settings = DesignSettings(dt=0.05, iterations=2, draws=0, method="steps")
    made = design_inputs(Pendulum(), limits, 12.0, noise=NOISE, settings=settings)
    flown = simulate(Pendulum(), made.record(), {"q": 0.0, "theta": TRIM})
    np.testing.assert_allclose(made.record().total().y, flown.y, atol=1e-3)


class Stuck(Pendulum):
    """Rubs, and has a stop that no motion about its trim reaches."""

    rub: float = 0.0
    stop: float = parameter(default=3.0, lower=0.0, upper=20.0, unit="1/s^2")

    def derivatives(self, x, u):
        q, theta = super().derivatives(x, u)
        return [q - self.rub * ca.sign(x.q) - self.stop * ca.fmax(x.theta - 1.5, 0.0) ** 2, theta]


def stopped(model, **options):
    settings = DesignSettings(dt=0.05, iterations=2, draws=0, method="steps", **options)
    limits = Limits(sticks={"m": 0.5}, responses={"theta": 0.3})
    return design_inputs(model, limits, 12.0, noise=NOISE, settings=settings)


@pytest.mark.second
def test_what_acts_at_another_trim_only_is_said_so_untold_unless_it_is_known():
    made = stopped(Stuck())
    assert made.untold == ("stop",)
    (said,) = made.blind
    assert said.startswith(
        "no output depends on stop here: parameters that act only away from this"
    )
    assert "| stop | 3 | inf | not told | not told |" in made.to_markdown()
    with pytest.raises(ValueError, match="depends on 'stop': leave it out, or design at another"):
        stopped(Stuck(), matter=("stop",))
    t = 0.05 * np.arange(300)
    u = 2.0 * np.sin(TRIM) + 0.9 * np.sign(np.sin(0.9 * t))[:, None]
    empty = Record(t, u, np.zeros((300, 2)), ("m",), ("q", "theta"))
    flown = simulate(Stuck(), empty).with_noise(NOISE, np.random.default_rng(0))
    assert flown.y[:, 1].max() > 1.8
    fit = output_error(Stuck(), flown)
    known = stopped(fit)
    assert known.untold == ()
    (said,) = known.blind
    assert said.startswith(
        "no output depends on stop here: only prior knowledge determines them; parameters"
    )
    place = known.names.index("stop")
    assert known.std_errors[place] <= known.before[place] < 0.1 * 3.0


def test_a_jump_that_the_trim_stands_on_and_the_flight_passes_is_told():
    with pytest.warns(DataWarning) as told:
        stopped(Stuck(rub=0.05))
    at_trim, flown = (str(each.message) for each in told)
    assert at_trim.startswith("linearised where dq/dt jumps at q = 0: the slope there belongs")
    assert flown.startswith("steps, as it is flown: dq/dt jumps at q = 0, passed")


def test_what_runs_away_is_made_smaller_until_it_does_not():
    limits = Limits(sticks={"m": 2.0}, responses={"theta": 0.7})
    made, _ = flight(Pendulum(), {}, 0.05, 201, limits)
    r = np.full((201, 1), 1.9)  # beyond what the pendulum holds
    r[0] = 0.0
    assert made.shares(r).max() > 10
    kept = made.within(r)
    assert 0.9 < made.shares(kept).max() <= 1.0
    made.shares = lambda _: np.array([np.inf])
    with pytest.raises(ValueError, match="diverges after inputs of any size"):
        made.within(r)
