"""Which records output error takes, and what R may be."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import Roll, noisy

from casid.free import free_parameters
from casid.shooting.selection import checked_covariance, select_records


def test_records_come_with_the_models_channels_in_its_order():
    record = noisy().select(("ped", "lat"), ("phi", "ay", "p"))
    (found,) = select_records(free_parameters(Roll()), record, biases=True)
    assert (found.inputs, found.outputs) == (Roll.inputs, Roll.outputs)
    np.testing.assert_array_equal(found.channel("phi"), record.channel("phi"))


def test_records_that_tell_less_than_their_own_unknowns_are_refused():
    free, record = free_parameters(Roll()), noisy()
    with pytest.raises(ValueError, match="no records: output error needs at least one"):
        select_records(free, [], biases=True)
    short = record.cut(0.0, 0.021)  # two samples
    short = replace(short, y=np.where([[1, 1, 1], [0, 1, 1]], short.y, np.nan))
    with pytest.raises(ValueError, match="has 5 measurements; its initial state and biases alone"):
        select_records(free, [record, short], biases=True)
    with pytest.raises(ValueError, match="have 18 measurements for 10 unknowns"):
        select_records(free, record.cut(0.0, 0.11), biases=False)


@pytest.mark.parametrize(
    ("R", "why"),
    [("round", '"diagonal", "full" or'), (np.eye(2), r"expected \(ny, ny\) = \(3, 3\)"),
     (np.diag([1, 1, -1]), "not symmetric positive definite"),
     (np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]), "not symmetric positive definite")],
)  # fmt: skip
def test_what_is_no_covariance_is_refused(R, why):
    with pytest.raises(ValueError, match=why):
        checked_covariance(R, 3)


def test_a_covariance_is_taken_and_none_is_the_diagonal_one():
    assert checked_covariance(None, 3) == "diagonal"
    assert checked_covariance("full", 3) == "full"
    np.testing.assert_array_equal(checked_covariance([[2, 0], [0, 3]], 2), np.diag([2.0, 3.0]))
