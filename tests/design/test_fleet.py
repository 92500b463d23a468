"""Plausible aircraft of a nonlinear structure, each from a trim of its own."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from casid import DesignSettings, Limits, NonlinearModel, Scalar, design_inputs, parameter
from casid.design.fleet import FAR, Balances, Fleet, Watch
from casid.design.optimise import Task

G, LIFT, MOMENT, C = 9.80665, 0.05, 0.02, 0.25
NOISE = {"V": 0.1, "alpha": 0.005, "q": 0.01, "theta": 0.005}
SHARES = np.array([6.0, 0.2, 1.0, 0.7])


class Car(NonlinearModel):
    """A speed, and an attitude that a stick has to hold."""

    states, inputs, outputs = ("V", "q", "theta"), ("e",), ("V", "q", "theta")
    P: Scalar = parameter(default=4.0, lower=-9.0, upper=99.0, unit="m/s^2")
    a: Scalar = parameter(default=-1.0, lower=-9.0, upper=9.0, unit="1/s^2")
    m0: Scalar = parameter(default=0.0, lower=-9.0, upper=9.0, unit="1/s^2")
    climbs: float = 1.0

    def reference(self):
        return {"V": 20.0}

    def derivatives(self, x, u):
        push = self.P - 0.01 * x.V**2 - self.climbs * G * ca.sin(x.theta)
        return [push, 2.0 * u.e + self.a * x.theta + self.m0 - 0.1 * x.q, x.q]


def asked(*values, **options):
    return [Car(**each, **options) for each in values]


def fleet(models, feedback=None):
    loop = SimpleNamespace(h=0.05, N=201, nu=1)
    limits = np.array([0.1, np.inf, np.inf, np.inf, 0.3, np.inf, np.inf, np.inf])
    task = Task(loops=(loop,), goals=(), limits=limits)
    return Fleet(models, np.array([20.0, 0.0, 0.0, 0.0]), feedback or {}, task, 2)


def test_a_trim_is_the_balance_at_the_same_airspeed_or_at_any_where_there_is_none():
    z = np.array([20.0, 0.0, 0.0, 0.0])
    lam = Car(P=5.0, a=-1.2, m0=0.3).vector()
    theta = np.arcsin(1.0 / G)
    found = Balances(Car(), z).nearest(lam)
    np.testing.assert_allclose(found, [20, 0, theta, (1.2 * theta - 0.3) / 2], atol=1e-6)
    level = Balances(Car(climbs=0.0), z)
    assert level.nearest(lam)[0] == pytest.approx(np.sqrt(500.0))
    assert level.nearest(Car(P=-1.0).vector()) is None
    np.testing.assert_array_equal(level.nearest(Car().vector()), z)
    # λ² + 0.1 λ - a
    assert level.growth(z, Car(a=0.3).vector()) == pytest.approx(-0.05 + np.sqrt(0.0025 + 0.3))


def test_aircraft_without_a_trim_and_those_that_are_not_held_are_counted_and_left_out():
    values = ({}, {"P": -1.0}, {"a": 1.2}, {"P": 5.0}, {"a": 0.002})
    alone = fleet(asked(*values, climbs=0.0))
    assert (alone.count, alone.untrimmed, alone.unheld) == (3, 1, 1)  # 0.002: e^0.17
    held = fleet(asked(*values, climbs=0.0), {"e": {"theta": 0.8, "q": 0.2}})
    assert (held.count, held.untrimmed, held.unheld) == (4, 1, 0)
    weak = fleet(asked(*values, climbs=0.0), {"e": {"theta": 0.1}})  # 0.2 1/s² against 1.2
    assert (weak.count, weak.untrimmed, weak.unheld) == (3, 1, 1)
    fast = fleet(asked({"a": 4.0}, climbs=0.0), {"e": {"theta": 4.0, "q": 1.0}})  # e^19 in 10 s
    assert (fast.count, fast.unheld) == (0, 1)


def test_what_nine_in_ten_stay_below_is_the_same_if_only_those_that_decide_are_flown():
    some = fleet(asked(*({"a": -x} for x in np.linspace(0.2, 3.0, 20))))
    r = 0.05 * np.sin(0.05 * np.arange(201))[:, None]
    watch, count = Watch(some, r), []
    first = watch.all(1.0)
    assert first == pytest.approx(np.quantile(some.peaks(r).max(axis=1), 0.9))
    fly = some.peaks
    some.peaks = lambda r, among=None: count.append(among.sum()) or fly(r, among)
    assert watch.some(0.7) == pytest.approx(np.quantile(fly(0.7 * r).max(axis=1), 0.9))
    assert 0 < sum(count) < 15
    some.peaks = fly
    used = fly(r)
    keeps = used.max(axis=1) <= first
    assert keeps.sum() == 18
    np.testing.assert_array_equal(some.used(r), used[keeps].max(axis=0))
    assert fly(1e9 * r).max() == FAR


class Glider(NonlinearModel):
    states, inputs = ("V", "alpha", "q", "theta"), ("elevator",)
    outputs = states
    CL0: Scalar = parameter(default=0.2, lower=0.0, upper=1.0, unit="-")
    CLalpha: Scalar = parameter(default=4.0, lower=1.0, upper=8.0, unit="1/rad")
    CD0: Scalar = parameter(default=0.03, lower=0.0, upper=0.3, unit="-")
    CDk: Scalar = parameter(default=0.06, lower=0.0, upper=0.5, unit="-")
    Cm0: Scalar = parameter(default=0.02, lower=-0.2, upper=0.2, unit="-")
    Cmalpha: Scalar = parameter(default=-0.5, lower=-3.0, upper=0.0, unit="1/rad")
    Cmq: Scalar = parameter(default=-8.0, lower=-40.0, upper=0.0, unit="1/rad")
    Cmelevator: Scalar = parameter(default=-0.8, lower=-3.0, upper=0.0, unit="1/rad")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.2, unit="s")

    def derivatives(self, x, u):
        names = self.parameter_names()
        values = {name: getattr(self, name) for name in names}
        return rate((x.V, x.alpha, x.q, x.theta), u.elevator, values, ca)

    def reference(self):
        return {"V": 18.0}

    def delays(self):
        return {"elevator": self.tau}


def rate(x, elevator, p, lib):
    V, alpha, q, theta = x
    CL = p["CL0"] + p["CLalpha"] * alpha
    Cm = p["Cm0"] + p["Cmalpha"] * alpha + p["Cmelevator"] * elevator + p["Cmq"] * q * C / (2 * V)
    return [
        -LIFT * V**2 * (p["CD0"] + p["CDk"] * CL**2) - G * lib.sin(theta - alpha),
        q - LIFT * V * CL + G * lib.cos(theta - alpha) / V,
        MOMENT * V**2 * Cm,
        q,
    ]


def trimmed(p, V=18.0):
    """By steady gliding: drag and lift are the weight's parts, found by a fixed point."""
    climb = 0.0 * p["CL0"]
    for _ in range(100):
        CL = G * np.cos(climb) / (LIFT * V**2)
        climb = -np.arcsin(LIFT * V**2 * (p["CD0"] + p["CDk"] * CL**2) / G)
    alpha = (CL - p["CL0"]) / p["CLalpha"]
    elevator = -(p["Cm0"] + p["Cmalpha"] * alpha) / p["Cmelevator"]
    return np.array([V + 0 * alpha, alpha, 0 * alpha, alpha + climb]), elevator


def flown(p, t, r):
    """Largest deviations (4, M) after a card of sticks r, by steps of a quarter sample."""
    (x0, e0), h = trimmed(p), (t[1] - t[0]) / 4
    x, most = x0.copy(), 0 * x0

    def f(x, s):
        return np.array(rate(x, e0 + np.interp(s - p["tau"], t, r), p, np))

    for s in h * np.arange(round(t[-1] / h)):
        k1 = f(x, s)
        k2 = f(x + h / 2 * k1, s + h / 2)
        k3 = f(x + h / 2 * k2, s + h / 2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3, s + h))
        most = np.maximum(most, np.abs(x - x0))
    return most


@pytest.mark.slow
def test_nine_in_ten_aircraft_of_other_draws_keep_the_limits_in_nonlinear_flight():
    usual = {name: getattr(Glider(), name) for name in Glider().parameter_names()}
    x0, e0 = trimmed({name: np.float64(value) for name, value in usual.items()})
    trim = dict(zip(("V", "alpha", "q", "theta", "elevator"), (*x0.tolist(), e0), strict=True))
    names = Glider.states
    limits = Limits(
        sticks={"elevator": 0.2},
        rates={"elevator": 1.0},
        responses=dict(zip(names, SHARES.tolist(), strict=True)),
    )
    settings = DesignSettings(dt=0.05, iterations=9, method="steps")
    made = design_inputs(Glider(), limits, 14.0, noise=NOISE, trim=trim, settings=settings)
    rng = np.random.default_rng(3)
    drawn = {n: v * np.exp(0.2 * rng.standard_normal(600)) for n, v in usual.items()}
    assert made.unheld == made.untrimmed == 0
    # Judged by their linearisations alone .30 and .25 of those after 3-2-1-1 and steps are beyond.
    for each in made.alternatives:  # all on the same terms
        beyond = (flown(drawn, made.t, each.r[:, 0]) / SHARES[:, None]).max(axis=0) > 1
        # of 96 and of 600 draws: a standard deviation of 0.033
        assert 0.0 < beyond.mean() < 0.1 + 3 * 0.033
    assert 0.98 < max(made.used_at_worst.values()) <= 1.001
    assert max(made.used.values()) < 0.9
    assert "in the nonlinear structure, each from a trim of its own. One" in made.margin()
