"""Accuracy figures against their definitions."""

import numpy as np
import pytest

from casid.baseline.accuracy import accuracy, accuracy_row


def test_parameters_that_data_cannot_tell_apart_have_infinite_error():
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    std, insensitive, _ = accuracy(jacobian, np.zeros(3, dtype=bool))
    assert np.isinf(std[:2]).all()
    assert std[2] == pytest.approx(1 / np.sqrt(2 * 9))
    assert insensitive == pytest.approx(1 / np.sqrt([10, 10, 18]))


def test_a_tie_between_parameters_takes_its_direction_out_of_the_covariance():
    rng = np.random.default_rng(1)
    jacobian = rng.standard_normal((20, 3))
    tie = np.array([[1.0, -2.0, 0.0]])  # the first is twice the second
    _, _, covariance = accuracy(jacobian, np.zeros(3, dtype=bool), tie)
    Z = np.array([[2.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    H = 2 * jacobian.T @ jacobian
    np.testing.assert_allclose(covariance, Z @ np.linalg.inv(Z.T @ H @ Z) @ Z.T, rtol=1e-10)


def test_parameters_on_a_bound_count_as_known():
    jacobian = np.array([[1.0, 1.0], [1.0, -0.5], [0.0, 2.0]])
    std, _, _ = accuracy(jacobian, np.array([False, True]))
    assert std[0] == pytest.approx(1 / np.sqrt(2 * 2))
    assert np.isnan(std[1])


def test_rows_name_the_guidelines_they_miss():
    row = accuracy_row("Lp", -2.0, 0.3, 0.1, 0.2)
    assert row.cramer_rao_percent == pytest.approx(30.0)  # 2 · 0.3 of 2.0
    assert row.insensitivity_percent == pytest.approx(5.0)
    assert row.misses == ("CR",)
    assert accuracy_row("Lp", 0.0, 0.3, 0.1, 0.2).misses == ("CR", "I")


def test_what_acts_only_through_a_tie_takes_the_tie_and_nothing_from_the_others():
    rng = np.random.default_rng(2)
    jacobian = np.hstack([rng.standard_normal((20, 2)), np.zeros((20, 2))])
    free = accuracy(jacobian[:, :2], np.zeros(2, dtype=bool))[2]
    tie = np.array(
        [[2.0, 1.0, -4e5, 0.0]]
    )  # the third is half of the first and so on, the fourth free
    std, _, covariance = accuracy(jacobian, np.zeros(4, dtype=bool), tie)
    np.testing.assert_allclose(covariance[:2, :2], free, rtol=1e-9)
    a = np.array([2.0, 1.0]) / 4e5
    assert std[2] == pytest.approx(np.sqrt(a @ free @ a), rel=1e-9)
    assert np.isinf(std[3])


def test_ties_that_leave_nothing_free_leave_no_error():
    std, _, _ = accuracy(np.ones((3, 1)), np.zeros(1, dtype=bool), np.array([[1.0]]))
    assert std == [0.0]
    held = accuracy(np.zeros((3, 1)), np.zeros(1, dtype=bool), np.array([[2.0]]))
    assert held[0] == [0.0]
