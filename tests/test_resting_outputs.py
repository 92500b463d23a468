"""Rest of outputs under moving inputs, and what is missing instead."""

import numpy as np
import pytest

from casid import Record, excitation
from casid.resting_outputs import unanswered

RNG = np.random.default_rng(4)
T = 0.02 * np.arange(1000)
U = np.sin(2 * T)[:, None]
Y = np.column_stack([np.sin(2 * T - 0.3), np.cos(2 * T)]) + 0.01 * RNG.standard_normal((1000, 2))
LATE = T > 9.99  # the second half


def flown(y, u=U):
    return Record(T, u, y, ("stick",), ("p", "phi"), "flight")


def test_inputs_that_move_while_all_outputs_rest_are_told_from_edge_to_edge():
    ((name, start, end),) = unanswered(flown(np.where(LATE[:, None], 1.0, Y)))
    assert name == "flight"
    assert (start, end) == pytest.approx((10.0, 19.98))
    assert unanswered(flown(np.where(LATE[:, None], [1.0, np.nan], Y)))  # all that is measured


def test_one_output_that_moves_or_inputs_that_rest_tell_nothing():
    assert unanswered(flown(np.where(LATE[:, None] & [True, False], 1.0, Y))) == []
    still = LATE[:, None]
    assert unanswered(flown(np.where(still, 1.0, Y), np.where(still, 0.0, U))) == []


@pytest.mark.parametrize(
    "lost", [LATE, T >= 0, LATE & (np.arange(1000) % 100 > 2), np.arange(1000) % 100 > 0]
)
def test_outputs_that_are_missing_do_not_rest(lost):
    assert unanswered(flown(np.where(lost[:, None], np.nan, Y))) == []


def test_outputs_that_are_sampled_more_slowly_rest_where_they_stay():
    slow = np.where((np.arange(1000) % 5 > 0)[:, None], np.nan, np.where(LATE[:, None], 1.0, Y))
    ((_, start, end),) = unanswered(flown(slow))
    assert (start, end) == pytest.approx((10.0, 19.98))


def test_a_record_without_measured_outputs_changes_no_share_from_outside():
    alone = excitation(flown(Y))
    both = excitation([flown(Y), flown(np.full_like(Y, np.nan), RNG.standard_normal((1000, 1)))])
    assert both.unanswered == ()
    np.testing.assert_allclose(both.lower, alone.lower)
