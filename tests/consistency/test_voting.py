"""Which of several clocks are one, on delays and covariances by hand."""

import numpy as np
import pytest

from casid.consistency.voting import apart, mean, shared, significant

NAMES = [("p",), ("q",), ("r",), ("ax",), ("u", "v", "w"), ("phi", "theta", "psi")]
VOTES = [*map(len, NAMES)]


def test_the_clock_that_most_share_is_right_and_what_is_vague_goes_with_the_nearest():
    C = np.diag([1e-3, 1e-3, 1e-3, 12e-3, 1e-3, 0.0]) ** 2
    assert shared(np.zeros(6), C, NAMES, VOTES) == [[0, 1, 2, 3, 4, 5]]
    assert shared(np.array([0.0, 0.04, 0.0, 0.012, 0.0, 0.0]), C, NAMES, VOTES) == [
        [0, 2, 3, 4, 5],
        [1],
    ]
    navigation = shared(np.array([-0.04, -0.04, -0.041, -0.05, 0.0, 0.0]), C, NAMES, VOTES)
    assert navigation == [[4, 5], [0, 1, 2, 3]]  # six channels against four


def test_votes_decide_and_not_the_number_of_clocks():
    late, C = np.array([0.05, 0.05, 0.05, 0.0, 0.0, 0.0]), 1e-6 * np.eye(6)
    assert shared(late, C, NAMES, [1, 1, 1, 1, 1, 1.5])[0] == [3, 4, 5]
    assert shared(late, C, NAMES, [1, 1, 1, 0.1, 1, 0.5])[0] == [0, 1, 2]


def test_a_clock_is_apart_by_the_difference_of_means_and_its_error():
    by, error = apart(np.array([0.06, 0.0, 0.0, 0.0]), 1e-6 * np.eye(4), [0], [1, 2, 3])
    assert by == pytest.approx(0.06)
    assert error == pytest.approx(1e-3 * np.sqrt(1 + 1 / 3))


def test_a_mean_is_weighted_by_errors_and_a_small_delay_is_none():
    late, error = mean([(0.1, 0.01), (0.4, 0.02)])
    assert (late, error) == pytest.approx((0.16, 1 / np.sqrt(12500)))
    assert significant(-0.02, 0.0049)
    assert not significant(0.02, 0.006)
    assert not significant(0.009, 1e-5)
