"""Delays as states."""

import math
from dataclasses import replace

import numpy as np
import pytest

from casid import without_delay
from casid.errors import DataWarning
from casid.exchange.delays import approximated

pytestmark = pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")

OMEGA = np.geomspace(0.1, 20, 15)


def test_a_pade_approximation_is_all_pass_and_right_in_phase_within_its_band(system):
    late = replace(system, delay=[0.05, 0.1])
    plain = without_delay(late, pade=3)
    assert (plain.nx, plain.inputs, plain.outputs) == (9, late.inputs, late.outputs)
    for order in (0, 11):
        with pytest.raises(ValueError, match="order of 1 to 10"):
            without_delay(late, pade=order)
    low = OMEGA[OMEGA < 15]
    # The error of the (3, 3) approximation is (ω τ)^7 / 1e5: 2e-4 at ω τ = 1.5.
    np.testing.assert_allclose(plain.response(low), late.response(low), rtol=5e-4, atol=1e-4)


@pytest.mark.parametrize("tau", [0.001, 0.05, 2.0])
@pytest.mark.parametrize("order", [1, 2, 5, 10])
def test_states_of_a_pade_approximation_are_balanced(system, tau, order):
    late = replace(system, delay=[tau, 0.0])
    plain = without_delay(late, order)
    A, B = plain.A[3:, 3:], plain.B[3:, :1]
    np.testing.assert_allclose(A + A.T, -B @ B.T, rtol=1e-9, atol=1e-9 * np.abs(A).max())
    # exp(x) = N(x)/N(-x), N's coefficients (2n - k)! n! / ((2n)! k! (n - k)!).
    n, f = order, math.factorial
    rising = [f(2 * n - k) * f(n) / (f(2 * n) * f(k) * f(n - k)) for k in range(n, -1, -1)]
    x = 1j * np.array([0.0, 0.3, 2.0, 9.0])
    pade = np.polyval(rising, -x) / np.polyval(rising, x)
    wanted = system.response(x.imag / tau)[:, :, 0] * pade[:, None]
    np.testing.assert_allclose(plain.response(x.imag / tau)[:, :, 0], wanted, rtol=1e-9)


def test_delays_of_a_discrete_model_become_states_exactly(system):
    late = replace(system, dt=0.02, delay=[0.06, 0.0])
    plain = without_delay(late)
    assert plain.nx == 6
    np.testing.assert_allclose(plain.response(OMEGA), late.response(OMEGA), rtol=1e-12)
    with pytest.raises(ValueError, match="no multiple"):
        without_delay(replace(late, delay=[0.05, 0.0]))


def test_states_of_delays_have_names_of_their_own(system):
    late = replace(system, delay=[0.05, 0.0], states=("lat_1", "b", "lat_1_"))
    plain = without_delay(late, pade=2)
    assert len(set(plain.states)) == plain.nx == 5
    assert plain.states[:3] == late.states


@pytest.mark.parametrize("order", [1, 3, 10])
def test_outputs_that_feel_steps_of_a_delayed_input_at_once_are_told(system, order):
    late = replace(system, D=[[0.0, 0.0], [0.7, 0.3]], delay=[0.05, 0.0])
    with pytest.warns(DataWarning, match="direct terms of delayed inputs, lat in r: a Padé"):
        plain = without_delay(late, order)
    # At the instant of a step, zero before it, the delayed input is still zero.
    t, u = 0.001 * np.arange(100), np.zeros((100, 2))
    u[1:, 0] = 1.0
    found, exact = (each.simulate(t, u, hold="zoh")[1] for each in (plain, late))
    np.testing.assert_allclose(np.abs(found - exact), [0.0, 0.7], atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_direct_terms_of_inputs_that_are_not_late_are_not_told(system):
    without_delay(replace(system, D=[[0.5, 0.0], [0.7, 0.0]], delay=[0.0, 0.05]), 3)
    without_delay(replace(system, dt=0.05, delay=[0.05, 0.0]))


@pytest.mark.parametrize("order", [1, 3, 5])
def test_up_to_what_frequency_delays_are_right_is_told_with_their_states(system, order):
    late = replace(system, delay=[0.05, 0.1], D=0 * system.D)
    plain = without_delay(late, order)
    (said,) = approximated(late, plain.states, order)
    reach = float(said.partition("right up to some ")[2].split()[0])

    def off(omega):
        true, found = (each.response(np.array([omega]))[0, :, 1] for each in (late, plain))
        return np.linalg.norm(found - true) / np.linalg.norm(true)

    assert off(reach) < 0.1
    assert off(2 * reach) > 0.3
    last = plain.states[-1]
    assert said.endswith(f"{last} that of {late.inputs[1]}, 0.1 s")
