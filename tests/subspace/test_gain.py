"""Innovation gains against closed forms."""

import numpy as np
import pytest
from truths.systems import unstable_plant

from casid import StateSpace
from casid.subspace.gain import carried_gain, riccati_gain


def test_a_stable_predictor_keeps_its_gain_and_the_other_gets_its_mirror_image():
    # dx/dt = a x, y = x + e, noise k e: the Riccati equation has the solutions P = 0, of the gain
    # k itself, and P = 2 (a - k) R, of the gain 2 a - k, whose predictor's pole is mirrored.
    A, C, R = np.array([[-0.5]]), np.array([[1.0]]), np.array([[2.0]])
    for k in (0.3, -2.0):
        expected = k if -0.5 - k < 0 else 2 * -0.5 - k
        found = riccati_gain(A, C, np.array([[k]]), R)
        # Regularised by 1e-9 of R and of k² R.
        np.testing.assert_allclose(found, [[expected]], rtol=1e-6)


def test_a_growing_mode_that_no_output_shows_is_refused():
    A, C = np.diag([0.5, -1.0]), np.array([[0.0, 1.0]])
    with pytest.raises(ValueError, match="no stable predictor of order 2 exists"):
        riccati_gain(A, C, np.zeros((2, 1)), np.eye(1))


def test_a_gain_is_carried_into_other_coordinates_and_units_of_the_states():
    system, R = unstable_plant(), np.diag([1.0, 2.0, 0.5])
    rng = np.random.default_rng(3)
    K = riccati_gain(system.A, system.C, rng.standard_normal((5, 3)), R)
    T = rng.standard_normal((5, 5)) + 2 * np.eye(5)
    inverse = np.linalg.inv(T)
    other = StateSpace(inverse @ system.A @ T, inverse @ system.B, system.C @ T, system.D)
    np.testing.assert_allclose(carried_gain(system, K, other, R), inverse @ K, rtol=1e-5)


def test_a_gain_scales_with_the_units_of_outputs_and_of_time():
    system, R = unstable_plant(), np.diag([1.0, 2.0, 0.5])
    K = np.random.default_rng(3).standard_normal((5, 3))
    found = riccati_gain(system.A, system.C, K, R)
    units, time = np.array([1e-5, 1.0, 1e5]), 1e3
    scaled = system.A / time, units[:, None] * system.C, K / units / time
    again = riccati_gain(*scaled, R * np.outer(units, units))
    np.testing.assert_allclose(again * units * time, found, rtol=1e-7)


def test_rounding_does_not_decide_which_of_two_real_modes_became_which():
    # From -1.2 and -0.5 to -0.47 and -0.32, which are as far from these in either order.
    rng, R = np.random.default_rng(5), np.eye(3)
    C, K = rng.standard_normal((3, 2)), 0.1 * rng.standard_normal((2, 3))
    B, D = np.ones((2, 1)), np.zeros((3, 1))
    system, A = StateSpace(np.diag([-1.2, -0.5]), B, C, D), np.diag([-0.47, -0.32])
    found = carried_gain(system, K, StateSpace(A, B, C, D), R)
    for _ in range(8):
        T = rng.standard_normal((2, 2))
        other = StateSpace(np.linalg.solve(T, A @ T), B, C @ T, D)
        np.testing.assert_allclose(T @ carried_gain(system, K, other, R), found, atol=1e-6)
