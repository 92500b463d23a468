"""Kiefer's means against their definitions and finite differences."""

import numpy as np
import pytest

from casid.design.criterion import Goal, as_long, covariance

rng = np.random.default_rng(0)
X = rng.standard_normal((20, 4)) * [1.0, 10.0, 0.1, 1.0]
F = X.T @ X
S = np.array([0.3, 0.02, 4.0])
ROWS = np.array([0, 1, 2])
NONE = np.zeros((4, 4))


def scaled():
    return np.linalg.inv(F)[:3, :3] / np.outer(S, S)


def test_covariance_is_the_inverse_and_large_where_nothing_is_felt():
    np.testing.assert_allclose(covariance(F), np.linalg.inv(F), rtol=1e-9)
    assert covariance(np.zeros((1, 1)))[0, 0] > 1e100


def test_determinant_trace_and_largest_eigenvalue():
    values = np.linalg.eigvalsh(scaled())
    assert Goal("D", ROWS, S, NONE)(F)[0] == pytest.approx(0.5 * np.log(values).mean())
    assert Goal("A", ROWS, S, NONE)(F)[0] == pytest.approx(0.5 * np.log(values.mean()))
    mean = np.mean(values**8) ** (1 / 8)
    assert Goal("E", ROWS, S, NONE)(F)[0] == pytest.approx(0.5 * np.log(mean))
    own = np.mean(np.diag(scaled()) ** 2) ** (1 / 2)
    assert Goal("MV", ROWS, S, NONE)(F)[0] == pytest.approx(0.5 * np.log(own))


@pytest.mark.parametrize("criterion", ["D", "A", "E", "MV"])
def test_slopes_are_differences_and_known_information_counts(criterion):
    goal = Goal(criterion, ROWS, S, 0.3 * F)
    way = rng.standard_normal((4, 4))
    way = 1e-5 * (way + way.T)
    difference = goal(F + way)[0] - goal(F - way)[0]
    assert 2 * np.sum(goal(F)[1] * way) == pytest.approx(difference, rel=1e-6)
    assert goal(F)[0] == pytest.approx(Goal(criterion, ROWS, S, NONE)(1.3 * F)[0])


def test_three_times_the_flight_is_as_good_as_errors_smaller_by_its_root():
    F, nothing = np.diag([4.0, 9.0]), np.zeros((2, 2))
    errors = np.array([0.5, 1 / 3]) / np.sqrt(3)
    assert as_long(F, nothing, errors, np.arange(2)) == pytest.approx(3.0, rel=2e-3)
    known = np.diag([8.0, 18.0])  # as much as two flights: a third one makes three in all
    assert as_long(F, known, errors, np.arange(2)) == pytest.approx(1.0, rel=2e-3)
