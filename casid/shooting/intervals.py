"""Records cut into shooting intervals, laid out for evaluation of all intervals at once."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray
from casid.intersample import ROUNDING, distinct
from casid.record import Record


@dataclass(frozen=True, eq=False)
class Layout:
    """Intervals of all records, the longest first, over the concatenated samples.

    Parameters
    ----------
    records : tuple of Record
        With the model's channels, in the model's order.
    y : (N, ny) array
        All outputs; missing samples are 0.
    pattern : (N,) integer array
        Which channels each sample has: row of ``patterns``.
    patterns : (n_patterns, ny) bool array
        True where a channel was measured; row 0 is the complete sample.
    step : (N,) integer array
        Class of the step from each sample to the next; a record's last sample repeats its last.
    classes : (n,) array
        Length of each class of steps [s].
    record : (J,) integer array
        Record of each interval.
    start, count : (J,) integer array
        First sample, number of samples.
    node : (J,) integer array
        Chronological number of each interval.
    last : (J,) bool array
        Whether the interval ends its record.
    """

    records: tuple[Record, ...]
    y: Array
    pattern: np.ndarray
    patterns: BoolArray
    step: np.ndarray
    classes: Array
    record: np.ndarray
    start: np.ndarray
    count: np.ndarray
    node: np.ndarray
    last: BoolArray

    @property
    def observations(self) -> int:
        """Number of scalar measurements."""
        return int(self.patterns[self.pattern].sum())


def lay_out(records: Sequence[Record], interval: float) -> Layout:
    """Cut every record into intervals of about the given length [s], of equal sample counts."""
    first = np.concatenate([[0], np.cumsum([record.N for record in records])])
    parts = []
    for r, record in enumerate(records):
        pieces = int(np.clip(round(record.duration / interval), 1, record.N // 2))
        edges = np.linspace(0, record.N, pieces + 1).round().astype(int)
        for a, b in itertools.pairwise(edges):
            parts.append((r, first[r] + a, b - a, b == record.N))
    table = np.array(parts, dtype=int)
    order = np.argsort(-table[:, 2], kind="stable")
    y = np.concatenate([record.y for record in records])
    patterns, pattern = _patterns(np.isfinite(y))
    classes, step = distinct(np.concatenate([_steps(record) for record in records]))
    table = table[order]
    return Layout(
        records=tuple(records),
        y=np.where(np.isfinite(y), y, 0.0),
        pattern=pattern,
        patterns=patterns,
        step=step,
        classes=classes,
        record=table[:, 0],
        start=table[:, 1],
        count=table[:, 2],
        node=order,
        last=table[:, 3].astype(bool),
    )


def _patterns(seen: BoolArray) -> tuple[BoolArray, np.ndarray]:
    """Distinct rows, the complete one first, and the row of every sample."""
    complete = np.ones((1, seen.shape[1]), dtype=bool)
    rows, which = np.unique(np.concatenate([complete, seen]), axis=0, return_inverse=True)
    which = which.ravel()
    order = np.argsort(np.arange(len(rows)) != which[0], kind="stable")
    return rows[order], np.argsort(order)[which[1:]]


def _steps(record: Record) -> Array:
    """Length of the step from each sample to the next [s]; the last sample repeats its last."""
    h = np.diff(record.t)
    same = np.ptp(h) <= ROUNDING * h.max()
    return np.full(record.N, h.mean()) if same else np.append(h, h[-1])
