"""Inputs between samples, delayed: against brute force, SciPy's exponential and differences."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from truths.brute_force import simulate_finely
from truths.closed_roll import TRUTH
from truths.systems import stepped_input, unstable_plant

from casid import Record
from casid.exchange.standalone import module_text
from casid.free import free_parameters
from casid.intersample import break_forcing, delayed_input, distinct, integral_slopes, integrals
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator, Point

H = 0.04
X0 = np.array([0.3, -0.02, 0.01])
DELAYS = [0.0, 0.3, 1.0, 2.25, 6.5]  # samples


def sharp_sticks(N=300):
    """Two sticks whose every edge is one sample wide."""
    return 0.1 * stepped_input(N, 2, np.random.default_rng(0), hold=7)


@pytest.mark.parametrize("direct", [True, False], ids=["direct term", "no direct term"])
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_model_estimator_and_exported_module_simulate_the_truth(hold, delay, direct):
    model = replace(TRUTH, tau=delay * H, Ylat=2.0 * direct)
    system, u = model.system(), sharp_sticks()
    t, plant = H * np.arange(len(u)), (system.A, system.B, system.C, system.D)
    truth = simulate_finely(plant, H, u, [delay, 0.0], hold, X0)
    module: dict[str, object] = {"__name__": "model"}
    exec(module_text(system, "foh", "roll"), module)
    record = Record(t, u, 0 * truth, model.inputs, model.outputs, hold=hold)
    free = free_parameters(model)
    point = Point(lam=model.vector(), bias=np.zeros((1, 3)), nodes=X0[None])
    estimator = Evaluator(free, lay_out([record], 1e9)).simulate(point).residuals
    own = system.simulate(t, u, X0, hold)
    # Rounding of 300 steps, 20 exponentials each on the side of the truth.
    for y in (own, estimator, module["simulate"](t, u, X0, hold)):
        np.testing.assert_allclose(y, truth, rtol=0, atol=1e-10 * np.abs(truth).max())


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.3, 8.0, 300.0])
def test_integrals_and_their_derivatives_are_blocks_of_scipys_exponential(size):
    rng = np.random.default_rng(1)
    A = size * (rng.standard_normal((4, 4)) - 1.5 * np.eye(4))
    A_lam, times, I = rng.standard_normal((4, 4, 2)), np.array([0.02, 0.0, 0.013]), np.eye(4)
    found = integral_slopes(A, times, A_lam)
    zero = np.zeros((12, 12))
    M = zero.copy()
    M[:4, :4], M[:4, 4:8], M[4:8, 8:] = A, I, I
    for k, a in np.ndindex(3, 2):
        dM = zero.copy()
        dM[:4, :4] = A_lam[:, :, a]
        both = scipy.linalg.expm(times[k] * np.block([[M, dM], [zero, M]]))
        for p in range(3):
            value, slope = both[:4, 4 * p : 4 * p + 4], both[:4, 12 + 4 * p : 16 + 4 * p]
            # Doubling ‖A‖ r = 10 five times loses as many bits.
            np.testing.assert_allclose(found[p, k, :, :, 0], value, rtol=0, atol=1e-14)
            np.testing.assert_allclose(found[p, k, :, :, 1 + a], slope, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(integrals(A, times), found[..., 0])


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_the_derivative_by_a_delay_is_exact_up_to_whole_samples(hold):
    # The breaks stay in their steps: within 2 to 3 samples all is analytic, ends included.
    plant, u = unstable_plant(), sharp_sticks(60)
    t, order = H * np.arange(60), 2 if hold == "foh" else 1
    within = np.array([2.5, 2.5]) * H

    def moved(delay):
        held = delayed_input(t, u, np.array([delay, 2.5]) * H, hold, within)
        P = integrals(plant.A, np.array([H]))[:, 0]
        steady = held.value[:-1] @ (P[1] @ plant.B).T + held.slope[:-1] @ (P[2] @ plant.B).T
        return steady + break_forcing(held, plant.A, plant.B, order), held, P

    for delay in (2.0, 2.3, 3.0):
        (up, _, _), (down, _, _) = moved(delay + 1e-4), moved(delay - 1e-4)
        _, held, P = moved(delay)
        lower = np.column_stack([plant.B[:, 0], 0 * plant.B[:, 1]])
        slope = -held.slope[:-1] @ (P[1] @ lower).T - break_forcing(held, plant.A, lower, order - 1)
        # A central difference over 8 µs: truncation 1e-8 of the third derivative, |A|³ ~ 1e3.
        difference = (up - down) / (2e-4 * H)
        np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-6 * np.abs(slope).max())


def test_times_that_differ_by_rounding_are_one():
    times, place = distinct(np.array([0.02, 0.02 + 1e-15, 0.5, 0.02 - 1e-15]), 1e-12)
    np.testing.assert_allclose(times, [0.02, 0.5])
    np.testing.assert_array_equal(place, [0, 0, 1, 0])
    assert all(len(part) == 0 for part in distinct(np.zeros(0), 1e-12))
