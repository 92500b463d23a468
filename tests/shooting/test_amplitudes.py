"""Records by the size of their inputs."""

import numpy as np
import pytest

from casid import Record
from casid.shooting.amplitudes import end, sides

T = np.arange(0, 5, 0.1)


def flown(sizes):
    u = [np.outer(np.sin(T), size) for size in sizes]
    names = [f"stick {k}" for k in range(len(sizes[0]))]
    return [Record(T, x, x[:, :1], names, ["p"], f"r{k}") for k, x in enumerate(u)]


@pytest.mark.parametrize(
    ("sizes", "smaller", "larger"),
    [
        ([[1], [-1], [2], [-2]], (0, 1), (2, 3)),
        ([[2], [1], [2], [1.03]], (1, 3), (0, 2)),
        ([[1], [2], [3.9], [4]], (0, 1), (2, 3)),  # where most of the spread is
        ([[1], [1], [1], [2]], (0, 1, 2), (3,)),
        ([[1, 0], [0, 3], [2, 0], [0, 1]], (0, 3), (1, 2)),  # each axis by itself
        ([[1, 0], [0, 3], [2, 0]], (0,), (2,)),  # alone on its axis
        ([[0], [1], [2]], (1,), (2,)),  # flown with nothing
    ],
)
def test_records_are_parted_among_those_that_move_inputs_alike(sizes, smaller, larger):
    assert sides(flown(sizes)) == (smaller, larger)


@pytest.mark.parametrize("sizes", [[[1], [1.1], [1]], [[1]], [[1, 0], [0, 2]], [[0], [0]]])
def test_records_of_one_size_are_not(sizes):
    assert sides(flown(sizes)) is None


def test_one_may_have_the_largest_or_smallest_inputs():
    records = flown([[1], [2], [1.5]])
    assert [end(records, i) for i in range(3)] == ["smallest", "largest", ""]
    assert end(flown([[1], [1.1]]), 1) == ""
