"""Equations without delays, for integrators of other libraries."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from truths.climbing import AIRCRAFT

from casid import (
    DataWarning,
    NonlinearModel,
    Record,
    Scalar,
    equations_of,
    parameter,
    simulate,
    without_delay,
)

pytestmark = pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")

DEVIATE = np.array([0.02, 0.55])


def test_a_structure_is_integrated_by_scipy_as_by_casid():
    model = replace(AIRCRAFT, tau=0.0)
    found = equations_of(model)
    t = 0.05 * np.arange(60)
    record = Record(t, np.tile(DEVIATE, (60, 1)), np.zeros((60, 0)), model.inputs, ())
    start = dict(zip(model.states, found.x0.tolist(), strict=True))
    tight = {"rtol": 1e-11, "atol": 1e-12, "t_eval": t}
    known = scipy.integrate.solve_ivp(
        found.derivatives, (0, t[-1]), found.x0, args=(DEVIATE,), **tight
    )
    y = np.array([found.measurements(0.0, x, DEVIATE) for x in known.y.T])
    np.testing.assert_allclose(y, simulate(model, record, start).y, atol=2e-6 * np.abs(y).max())


def settled(found, u):
    """States of the delay under a constant input."""
    x0 = found.x0[:3]
    base = found.derivatives(0.0, np.r_[x0, np.zeros(3)], u)[3:]
    columns = [found.derivatives(0.0, np.r_[x0, e], u)[3:] - base for e in np.eye(3)]
    return np.linalg.solve(np.array(columns).T, -base)


def test_delays_stand_before_the_inputs_and_rest_at_the_reference_condition():
    found = equations_of(AIRCRAFT, 3)
    assert found.states == ("V", "q", "theta", "lon_1", "lon_2", "lon_3")
    at_rest = found.derivatives(0.0, found.x0, found.u0)
    plain = equations_of(replace(AIRCRAFT, tau=0.0))
    np.testing.assert_allclose(at_rest[:3], plain.derivatives(0.0, plain.x0, plain.u0))
    np.testing.assert_allclose(at_rest[3:], 0, atol=1e-9)
    with pytest.raises(ValueError, match="pass pade=3"):
        equations_of(AIRCRAFT)
    passed = np.r_[found.x0[:3], settled(found, DEVIATE)]  # long after, the delay is over
    late = found.derivatives(0.0, passed, lambda _: DEVIATE)
    np.testing.assert_allclose(late[:3], plain.derivatives(0.0, plain.x0, DEVIATE), rtol=1e-9)


def test_a_linear_systems_equations_are_its_matrices(system):
    late = replace(system, delay=[0.05, 0.0])
    found, plain = equations_of(late, 2), without_delay(late, 2)
    rng = np.random.default_rng(0)
    x, u = rng.standard_normal(plain.nx), rng.standard_normal(2)
    np.testing.assert_allclose(found.derivatives(0.0, x, u), plain.A @ x + plain.B @ u)
    np.testing.assert_allclose(found.measurements(0.0, x, u), plain.C @ x + plain.D @ u)
    y = found.measurements(3.0, x, lambda t: t * u)
    np.testing.assert_allclose(y, plain.C @ x + plain.D @ (3.0 * u))
    with pytest.raises(ValueError, match="discrete"):
        equations_of(replace(system, dt=0.1))


class Speed(NonlinearModel):
    states, inputs, outputs = ("V",), ("thrust",), ("V",)
    k: Scalar = parameter(default=0.02, lower=0.0, upper=1.0, unit="1/m")
    tau: Scalar = parameter(default=0.0, lower=0.0, upper=1.0, unit="s")

    def derivatives(self, x, u):
        return [u.thrust - self.k * x.V**2]

    def reference(self):
        return {"V": 10.0, "thrust": 2.0}

    def delays(self):
        return {"thrust": self.tau}


def test_a_structure_of_one_state_has_equations():
    found = equations_of(Speed())
    np.testing.assert_allclose(found.derivatives(0.0, np.array([5.0]), np.array([2.0])), [1.5])
    np.testing.assert_allclose(found.measurements(0.0, np.array([5.0]), np.array([2.0])), [5.0])


def test_a_structure_whose_outputs_feel_a_late_input_at_once_is_told():
    with pytest.warns(DataWarning, match="direct terms of delayed inputs, lon in az: a Padé"):
        equations_of(AIRCRAFT, 3)


@pytest.mark.filterwarnings("error")
def test_a_structure_whose_states_alone_feel_a_late_input_is_not_told():
    assert equations_of(Speed(tau=0.3), 2).states == ("V", "thrust_1", "thrust_2")


def test_a_delay_rests_at_an_input_that_is_not_zero():
    found = equations_of(Speed(tau=0.3), 2)
    assert len(found.x0) == 3
    np.testing.assert_allclose(found.derivatives(0.0, found.x0, found.u0), 0, atol=1e-9)
