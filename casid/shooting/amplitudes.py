"""Records by the size of their inputs, among those that move them alike."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from casid.arrays import Array
from casid.record import Record
from casid.records import MANOEUVRE, input_levels

RATIO, SAME = 1.2, 1.05  # of two amplitudes that differ, of those that do not


class Sides(NamedTuple):
    """Records of the smaller and of the larger inputs, by their numbers."""

    smaller: tuple[int, ...]
    larger: tuple[int, ...]


def sides(flown: Sequence[Record]) -> Sides | None:
    """Records parted by the size of their inputs, those alike by themselves; None of one size.

    Where parts differ most in the mean logarithm of size, squared, by how many each has.
    """
    level, cosine = _levels(flown)
    left, smaller, larger = list(range(len(flown))), [], []
    while left:
        mine = sorted((k for k in left if cosine[left[0], k] > MANOEUVRE), key=lambda k: level[k])
        left = [k for k in left if k not in mine and k != left[0]]
        if at := _parted(np.array([level[k] for k in mine])):
            smaller += mine[:at]
            larger += mine[at:]
    return Sides((*sorted(smaller),), (*sorted(larger),)) if smaller else None


def end(flown: Sequence[Record], i: int) -> str:
    """Whether a record has the largest or the smallest inputs of those that move them alike."""
    level, cosine = _levels(flown)
    alike = level[cosine[i] > MANOEUVRE]
    if not len(alike) or alike.max() < RATIO * alike.min():
        return ""
    if level[i] * SAME >= alike.max():
        return "largest"
    return "smallest" if level[i] <= SAME * alike.min() else ""


def _levels(flown: Sequence[Record]) -> tuple[Array, Array]:
    """Sizes of all records (n,), and how alike the inputs of two are (n, n)."""
    return input_levels(np.array([np.ptp(record.u, axis=0) for record in flown]))


def _parted(level: Array) -> int:
    """How many of sizes (n,) that rise are the smaller; 0 if they do not differ."""
    size, n = np.log(level), len(level)
    apart = np.array([size[k:].mean() - size[:k].mean() for k in range(1, n)])
    gap = np.diff(size) > np.log(SAME)
    told = np.where(gap & (apart > np.log(RATIO)), apart**2, 0.0)
    told = told * np.arange(1, n) * np.arange(n - 1, 0, -1)  # by how many are on both sides
    return int(np.argmax(told)) + 1 if told.max(initial=0.0) > 0 else 0
