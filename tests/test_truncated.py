"""What bounds leave open, against truncated distributions, draws, and flights at a bound."""

import numpy as np
import pytest
import scipy.stats

from casid.truncated import OnBounds, beside_bounds, second_moments


@pytest.mark.parametrize(
    ("mean", "size", "room"),
    [(0, 1, np.inf), (-3, 1, np.inf), (-12, 2, np.inf), (0.5, 3, 1.0), (2, 1, np.inf), (1, 1, 2)],
)
def test_moments_of_one_are_those_of_a_truncated_normal(mean, size, room):
    found = second_moments(np.array([mean]), np.array([[size**2]]), np.array([room]))
    law = scipy.stats.truncnorm(-mean / size, (room - mean) / size, mean, size)
    assert found.item() == pytest.approx(law.var() + law.mean() ** 2, rel=0.02)


def test_moments_of_several_are_those_of_draws_that_stay_within():
    rng, C = np.random.default_rng(1), np.array([[1, 0.9, -0.3], [0.9, 1, 0], [-0.3, 0, 2]])
    mean, room = np.array([-1.0, 0.3, -0.5]), np.array([np.inf, 1.5, np.inf])
    d = rng.multivariate_normal(mean, C, size=1_000_000)
    d = d[((d > 0) & (d < room)).all(axis=1)]
    np.testing.assert_allclose(second_moments(mean, C, room), d.T @ d / len(d), rtol=0.04)


def test_a_bound_far_beyond_which_the_data_press_leaves_nothing():
    found = second_moments(np.array([-50.0]), np.ones((1, 1)), np.array([np.inf]))
    assert 0 <= found.item() < 1e-2
    assert second_moments(np.zeros(1), np.array([[1e20]]), np.ones(1)).item() == pytest.approx(
        1 / 3, rel=1e-3
    )  # anywhere in its room


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_errors_about_an_estimate_on_a_bound_are_those_of_what_is_known(side):
    # Least squares with one parameter on its bound: the posterior of a flat prior within it.
    rng = np.random.default_rng(2)
    X = rng.standard_normal((40, 3)) @ [[1, 0.9, 0.2], [0, 0.5, 0.1], [0, 0, 1]]
    F, best = X.T @ X, np.array([-0.1 * side, 2.0, -1.0])  # without the bound at 0
    held = np.array([0.0, *np.linalg.solve(F[1:, 1:], (F @ best)[1:])])
    slope = (F @ (held - best))[:1]
    known = np.zeros((3, 3))
    known[1:, 1:] = np.linalg.inv(F[1:, 1:])
    bounded = OnBounds(np.eye(3)[:1], slope, np.array([side]), np.array([np.inf]))
    found = known + beside_bounds(np.linalg.inv(F), bounded)
    drawn = rng.multivariate_normal(best, np.linalg.inv(F), size=1_000_000)
    off = drawn[side * drawn[:, 0] > 0] - held
    np.testing.assert_allclose(found, off.T @ off / len(off), rtol=0.03, atol=1e-4)


def test_what_nothing_is_known_of_adds_nothing():
    K = np.diag([np.inf, 1.0, 0.0])
    bounded = OnBounds(np.eye(3)[[0, 2]], np.ones(2), np.ones(2), np.full(2, np.inf))
    assert not beside_bounds(K, bounded).any()
    one = OnBounds(np.eye(3)[1:2], np.zeros(1), np.ones(1), np.array([2.0]))
    np.testing.assert_allclose(one.information, np.diag([0, 3, 0]))


def test_bounds_of_both_sides_are_open_inwards():
    rng = np.random.default_rng(5)
    X = rng.standard_normal((40, 3)) @ [[1, 0.9, 0.2], [0, 0.5, 0.6], [0, 0, 1]]
    F, best = X.T @ X, np.array([-0.05, 0.1, -1.0])  # without 0 below the first, above the second
    held = np.array([0.0, 0.0, (F @ best)[2] / F[2, 2]])
    slope = (F @ (held - best))[:2]
    known = np.diag([0.0, 0.0, 1 / F[2, 2]])
    bounded = OnBounds(np.eye(3)[:2], slope, np.array([1.0, -1.0]), np.full(2, np.inf))
    found = known + beside_bounds(np.linalg.inv(F), bounded)
    drawn = rng.multivariate_normal(best, np.linalg.inv(F), size=1_000_000)
    off = drawn[(drawn[:, 0] > 0) & (drawn[:, 1] < 0)] - held
    np.testing.assert_allclose(found, off.T @ off / len(off), rtol=0.05, atol=1e-4)
