"""The loop against the package's simulation, finite differences and output error itself."""

import numpy as np
import pytest

from casid import Model, Record, output_error, parameter
from casid.design.loop import Crowd, Loop
from casid.free import free_parameters


class Roll(Model):
    states = ("p", "phi")
    inputs = ("lat",)
    outputs = ("p", "phi", "ap")

    Lp: float = parameter(default=-2.0, lower=-9.0, upper=5.0, unit="1/s")
    Llat: float = parameter(default=8.0, lower=0.0, upper=20.0, unit="rad/s^2")
    tau: float = parameter(default=0.1, lower=0.0, upper=0.3, unit="s")

    def A(self):
        return [[self.Lp, 0], [1, 0]]

    def B(self):
        return [[self.Llat], [0]]

    def C(self):
        return [[1, 0], [0, 1], [self.Lp, 0]]

    def D(self):
        return [[0], [0], [self.Llat]]

    def delays(self):
        return {"lat": self.tau}


R = np.diag([0.01, 0.02, 0.05]) ** 2


def loop_of(model, feedback=None, N=120, h=0.05):
    return Loop(free_parameters(model), feedback or {}, R, h=h, N=N)


def steps(N, seed=0):
    r = np.repeat(np.random.default_rng(seed).uniform(-1, 1, N // 10), 10)
    r[:10] = 0.0
    return r[:, None]


@pytest.mark.parametrize("tau", [0.1, 0.0, 0.13, 0.02])  # two samples, none, between samples
def test_open_loop_outputs_are_those_of_the_simulation(tau):
    model, r, t = Roll(tau=tau), steps(120), 0.05 * np.arange(120)
    flown = loop_of(model).fly(r)
    np.testing.assert_allclose(flown.u, r, atol=1e-12)
    np.testing.assert_allclose(flown.y, model.system().simulate(t, r), atol=1e-10)


@pytest.mark.parametrize("tau", [0.1, 0.0, 0.13, 0.02])
def test_feedback_acts_on_what_the_simulation_makes_of_the_sticks(tau):
    model, r, t = Roll(Lp=1.0, tau=tau), steps(120), 0.05 * np.arange(120)
    flown = loop_of(model, {"lat": {"p": 0.4, "phi": 0.3}}).fly(r)
    y = model.system().simulate(t, flown.u)
    np.testing.assert_allclose(flown.u, r - 0.4 * y[:, :1] - 0.3 * y[:, 1:2], atol=1e-9)


@pytest.mark.parametrize("tau", [0.1, 0.0, 0.13])
def test_sensitivities_are_differences_of_outputs_for_the_sticks_that_were_flown(tau):
    model, r = Roll(tau=tau), steps(120)
    loop = loop_of(model, {"lat": {"p": 0.1}})
    u, t = loop.fly(r).u, 0.05 * np.arange(120)
    columns = []
    for name, value in zip(model.parameter_names(), model.vector(), strict=True):
        ends = []
        for move in (1e-6, 0.0):  # to one side: at whole samples outputs have a kink in the delay
            moved = Roll(**{**vars(model), name: value + move})
            ends.append(moved.system().simulate(t, u))
        columns.append((ends[0] - ends[1]) / 1e-6)
    J = np.stack(columns, axis=-1) / np.sqrt(np.diag(R))[:, None]
    flat = J.reshape(-1, 3)
    unknown = loop._unknown
    flat = flat - unknown @ (unknown.T @ flat)
    found = loop.sensitivities(loop.fly(r).z)
    np.testing.assert_allclose(found, flat, atol=1e-4 * np.abs(flat).max())


def test_slope_of_the_information_by_the_input_is_a_difference():
    loop, r = loop_of(Roll(tau=0.13), {"lat": {"p": 0.1, "phi": 0.2}}, N=60), steps(60)
    M = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.0], [0.1, 0.0, 0.3]])

    def value(r):
        J = loop.sensitivities(loop.fly(r).z)
        return float(np.trace(M @ J.T @ J))

    flown = loop.fly(r)
    dz = loop.information_slope(loop.sensitivities(flown.z), M)
    slope = loop.pulled_back(np.zeros_like(flown.signals), dz)
    way = np.random.default_rng(1).standard_normal(r.shape)
    difference = (value(r + 1e-4 * way) - value(r - 1e-4 * way)) / 2e-4
    assert float((slope * way).sum()) == pytest.approx(difference, rel=1e-6)


@pytest.mark.slow
def test_standard_errors_are_the_bound_that_output_error_states():
    model, t = Roll(tau=0.12), 0.05 * np.arange(120)
    loop = loop_of(model)
    flown = loop.fly(steps(120))
    noise = np.sqrt(np.diag(R)) * np.random.default_rng(3).standard_normal(flown.y.shape)
    record = Record(t, flown.u, flown.y + noise, model.inputs, model.outputs)
    fit = output_error(model, record, R=R)
    J = loop.sensitivities(flown.z)
    expected = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    stated = [fit[name].cramer_rao for name in model.parameter_names()]
    np.testing.assert_allclose(stated, expected, rtol=0.05)


def test_sticks_that_were_flown_have_the_response_of_the_loop_that_flew_them():
    loop = loop_of(Roll(tau=0.13), {"lat": {"p": 0.1}})
    flown = loop.fly(steps(120))
    np.testing.assert_allclose(loop.held(flown.u), flown.z, atol=1e-10)


def test_unstable_aircraft_need_their_feedback_and_short_manoeuvres():
    example = r"such as feedback=\{'lat': \{'p': 0.1\}\}"
    with pytest.raises(ValueError, match=rf"nothing holds it over 5.95 s, .* {example}$"):
        loop_of(Roll(Lp=1.0))
    with pytest.raises(ValueError, match=rf"nothing holds it .* {example}, and fly 3.7 s at most$"):
        loop_of(Roll(Lp=4.0))  # 3.75 s, which would be too long rounded up
    with pytest.raises(ValueError, match=r"manoeuvres of 3 s at most"):
        loop_of(Roll(Lp=5.0), {"lat": {"p": 1.0}})
    with pytest.raises(ValueError, match="sign of its control derivative"):
        loop_of(Roll(), {"lat": {"p": -2.0}})
    with pytest.raises(ValueError, match="feedback names 'q'"):
        loop_of(Roll(), {"lat": {"q": 0.1}})


def test_an_unstable_aircraft_is_told_the_gain_that_damps_its_mode():
    class Both(Model):
        states, inputs, outputs = ("p", "q"), ("lat", "lon"), ("p", "aq", "q")
        Mq: float = parameter(default=1.0, unit="1/s")

        def A(self):
            return [[-1.0, 0], [0, self.Mq]]

        def B(self):
            return [[3.0, 0], [0.1, -2.0]]

        def C(self):
            return [[1, 0], [0, 9.0], [0, 1]]

    free = free_parameters(Both())
    with pytest.raises(ValueError, match=r"such as feedback=\{'lon': \{'q': -0\.1\}\}$"):
        Loop(free, {}, np.eye(3), h=0.05, N=120)
    assert Loop(free, {"lon": {"q": -1.0}}, np.eye(3), h=0.05, N=120).N == 120


def crowd_of_two():
    """Loops, limits of (lat, its rate, p, phi, ap, and both states), and the crowd."""
    held = {"lat": {"p": 0.4, "phi": 0.3}}
    loops = [loop_of(Roll(Lp=Lp, tau=0.13), held) for Lp in (-1.0, 1.0)]
    limits = np.array([0.5, 2.0, np.inf, 0.3, 1.0, 0.7, np.inf])
    return loops, limits, Crowd(iter(loops), limits)


def test_a_crowd_answers_with_the_shares_of_its_loops_in_single_precision():
    (loops, limits, crowd), r = crowd_of_two(), steps(120)
    for loop, shares, peaks in zip(loops, crowd.fly(r), crowd.peaks(r), strict=True):
        flown = loop.fly(r).signals
        rates = np.diff(flown[:, :1], axis=0, prepend=0.0) / 0.05
        every = np.concatenate([flown[:, :1], rates, flown[:, 1:]], axis=1) / limits
        kept = every[:, np.isfinite(limits)]
        np.testing.assert_allclose(shares, kept, atol=3e-6 * np.abs(kept).max())
        np.testing.assert_allclose(peaks, np.abs(every).max(axis=0), rtol=3e-6, atol=3e-6)


def test_what_a_crowd_pulls_back_is_the_adjoint_of_its_flight():
    _, _, crowd = crowd_of_two()
    rng, r = np.random.default_rng(0), steps(120, seed=1)
    flown = crowd.fly(r)
    slope = rng.standard_normal(flown.shape)
    assert np.sum(crowd.pulled_back(slope) * r) == pytest.approx(np.sum(slope * flown), rel=1e-4)
    first = np.einsum("kcu,u->kc", crowd.impulses(1), [1.0])
    alone = crowd.fly(np.eye(120)[:, :1])[1]
    np.testing.assert_allclose(first, alone, atol=1e-5 * np.abs(alone).max())
