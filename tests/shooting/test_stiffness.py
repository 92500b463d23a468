"""How fast a structure is, against eigenvalues in closed form."""

import casadi as ca
import numpy as np
import pytest

from casid import (
    ConvergenceError,
    ModelError,
    NonlinearModel,
    Record,
    Scalar,
    output_error,
    parameter,
    simulate,
)
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.stiffness import MOST, fastest_flown, first_steps


class Follower(NonlinearModel):
    """x follows sin z by a lag, z an input, faster in strong flow."""

    states, inputs, outputs = ("x", "z"), ("u",), ("x", "z")

    a: Scalar = parameter(default=-300.0, lower=-5e4, upper=0.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.a * (1 + x.z**2) * (x.x - ca.sin(x.z)), u.u - x.z]


T = np.arange(0, 20, 0.05)
U = np.where((T > 1) & (T < 4), 1.0, np.where((T > 6) & (T < 9), -1.0, 0.0))


def evaluator(model, z):
    y = np.column_stack([np.sin(z), z])
    record = Record(T, U[:, None], y, Follower.inputs, Follower.outputs, "lag")
    return NonlinearEvaluator(free_parameters(model), lay_out([record], 1e9))


def test_the_fastest_mode_is_that_of_the_equations_where_it_flew():
    found = evaluator(Follower(), np.full(len(T), 2.0))
    assert fastest_flown(found, found.model.vector()) == (pytest.approx(1500.0), "x")
    assert first_steps(found, found.model.vector()) == MOST  # 75 would follow it
    assert first_steps(found, np.array([-10.0])) == 3  # 50 rad/s in 0.05 s


def test_a_fast_growth_is_no_lag_to_be_left_out():
    found = evaluator(Follower(), np.zeros(len(T)))
    assert first_steps(found, np.array([4e4])) == MOST


def test_a_single_wild_sample_does_not_count():
    z = np.zeros(len(T))
    z[100] = 1e3
    assert fastest_flown(evaluator(Follower(), z), np.array([-300.0]))[0] == pytest.approx(300.0)


def test_a_mode_that_no_steps_follow_is_named():
    with pytest.raises(
        ModelError, match=r"stiff at the start: its mode at -4e\+04 1/s, mostly of x"
    ):
        evaluator(Follower(a=-4e4), np.zeros(len(T)))


class Lag(NonlinearModel):
    """x follows sin z by a lag far shorter than a sampling interval."""

    states, inputs, outputs = ("x", "z"), ("u",), ("x", "z")

    a: Scalar = parameter(default=-300.0, lower=-5e4, upper=0.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.a * (x.x - ca.sin(x.z)), u.u - x.z]


def noisy(seed, truth=-500.0):
    """Records of a lag of 2 ms at 20 Hz, by exact steps a hundred times as short."""
    fine = np.arange(0, 20, 5e-4)
    v, z, x = np.interp(fine, T, U), 0.0, 0.0
    clean = np.empty((len(fine), 2))
    decay, slow = np.exp(truth * 5e-4), np.exp(-5e-4)
    for k, value in enumerate(v):
        clean[k] = x, z
        middle = value + (z - value) * np.exp(-2.5e-4)
        x, z = np.sin(middle) + (x - np.sin(middle)) * decay, value + (z - value) * slow
    y = clean[::100] + 0.02 * np.random.default_rng(seed).standard_normal((len(T), 2))
    return Record(T, U[:, None], y, Lag.inputs, Lag.outputs, f"lag {seed}")


# By an own likelihood (Radau, initial states free) a from -500 to -20000 costs 0.06 at most for the
# second of these; where the first ends, at the limit of Runge-Kutta's method, 0.05.
@pytest.mark.campaign
def test_where_the_method_diverges_an_estimate_is_no_estimate():
    with pytest.raises(ConvergenceError, match=r"more than the data do.*mostly of x") as raised:
        output_error(Lag(), noisy(0), biases=False)
    assert not raised.value.best.success


@pytest.mark.campaign
def test_where_the_method_diverges_is_no_information_about_a_lag():
    fit = output_error(Lag(), noisy(2), biases=False)
    assert fit["a"].std_error > -fit["a"].value
    assert fit.notes.integration.widened < 0.02


def test_no_slope_at_the_reference_stops_no_simulation_from_elsewhere():
    class Tank(NonlinearModel):
        states, inputs, outputs = ("h",), ("q",), ("h",)
        a: Scalar = parameter(default=0.5, lower=0.1, upper=3.0, unit="-")

        def derivatives(self, x, u):
            return [u.q - self.a * ca.sqrt(x.h)]

    t = 0.05 * np.arange(200)
    none = np.zeros((200, 1))
    found = simulate(Tank(), Record(t, none, none, ("q",), ("h",), "emptied"), {"h": 9.0})
    np.testing.assert_allclose(found.y[:, 0], (3 - 0.25 * t) ** 2, atol=1e-6)
