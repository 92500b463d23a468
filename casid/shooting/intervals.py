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
    """Intervals of all records, the longest first, over the concatenated samples."""

    records: tuple[Record, ...]  # with the model's channels, in its order
    y: Array  # (N, ny) all outputs; missing samples are 0
    pattern: np.ndarray  # (N,) which channels each sample has: row of patterns
    patterns: BoolArray  # (n_patterns, ny) where a channel was measured; row 0: everywhere
    step: np.ndarray  # (N,) class of the step to the next sample; the last repeats its own
    classes: Array  # (n,) length of each class of steps [s]
    record: np.ndarray  # (J,) record of each interval
    start: np.ndarray  # (J,) first sample
    count: np.ndarray  # (J,) number of samples
    node: np.ndarray  # (J,) chronological number of each interval
    last: BoolArray  # (J,) whether the interval ends its record
    interval: float  # about their length [s]

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
    steps = np.concatenate([_steps(record) for record in records])
    classes, step = distinct(steps, ROUNDING * steps.max())
    table = table[order]
    return Layout(
        records=tuple(records), y=np.where(np.isfinite(y), y, 0.0), pattern=pattern,
        patterns=patterns, step=step, classes=classes, record=table[:, 0], start=table[:, 1],
        count=table[:, 2], node=order, last=table[:, 3].astype(bool), interval=interval,
    )  # fmt: skip


def _patterns(seen: BoolArray) -> tuple[BoolArray, np.ndarray]:
    """Distinct rows, the complete one first, and the row of every sample."""
    complete = np.ones((1, seen.shape[1]), dtype=bool)
    every = np.concatenate([complete, seen])
    bits = np.packbits(every, axis=1)  # sorted in a fiftieth of the time
    _, first, which = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    order = np.argsort(np.arange(len(first)) != which[0], kind="stable")
    return every[first[order]], np.argsort(order)[which[1:]]


def _steps(record: Record) -> Array:
    """Length of the step from each sample to the next [s]; the last sample repeats its last."""
    h = np.diff(record.t)
    same = np.ptp(h) <= ROUNDING * h.max()
    return np.full(record.N, h.mean()) if same else np.append(h, h[-1])
