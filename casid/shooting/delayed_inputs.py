"""Delayed inputs of all records and their breaks, which move along while none passes a sample.

With a delay between the same two whole numbers of samples breaks fall into the same steps, with the
same jumps; only how long before the next sample moves, with the delay. They are laid out once, at
the end of that stretch, if all records are sampled alike; otherwise anew for all delays.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from casid.arrays import Array, BoolArray
from casid.intersample import ROUNDING, DelayedInput, delayed_input
from casid.record import Record
from casid.shooting.stepping import Breaks, collect_breaks
from casid.shooting.unknowns import FilterMatrices

LATE = 1e-6  # of a sampling interval: the delay that stands for 0 if it may grow


@dataclass(frozen=True, eq=False)
class Held:
    """Inputs u(t - τ) of every record, and their breaks where these need not be gathered anew."""

    inputs: list[DelayedInput]
    breaks: Breaks | None = None

    def columns(self, records: Sequence[Record], A: Array) -> Breaks:
        """The breaks in columns, over steps whose states move by A (nx, nx)."""
        if self.breaks is not None:
            return self.breaks
        return collect_breaks(self.inputs, [record.hold for record in records], A)

    def later(self, by: Array) -> "Held":
        """Delayed by so much more (nu,), no break having passed a sample."""
        moved = [
            held._replace(value=held.value - held.slope * by, rest=held.rest - by[held.channel])
            for held in self.inputs
        ]
        breaks = self.breaks
        if breaks is not None:
            breaks = replace(breaks, rest=breaks.rest - by[breaks.channel])
        return Held(moved, breaks)


class Delayed:
    """The delayed inputs of records at whatever matrices; the last ones are kept.

    ``direct`` (nu,) are those that outputs may feel at once.
    """

    def __init__(self, records: Sequence[Record], direct: BoolArray) -> None:
        self._records, self._direct = records, direct
        self._within = np.full(records[0].nu, np.nan)
        self._step = common_step(records)
        self._last: tuple[bytes, Held] | None = None
        self._stretch: tuple[bytes, Held] | None = None

    def within(self, delays: Array | None) -> Self:
        """The same, samples passed as for these delays (nu,) instead of τ; NaN follows τ."""
        other = copy.copy(self)
        other._within = np.full_like(self._within, np.nan) if delays is None else delays
        other._last = None
        return other

    def at(self, m: FilterMatrices) -> Held:
        """Of the delays of these matrices."""
        key = m.tau.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._moved(m)
        return self._last[1]

    def _moved(self, m: FilterMatrices) -> Held:
        """From the end of the delays' stretch, where there is one."""
        order = [self._order(m, record) for record in self._records]
        end = None if self._step is None else stretch(self._step, order)
        if end is None:
            return Held(self._held(m.tau, order))
        key = end.tobytes()
        if self._stretch is None or self._stretch[0] != key:
            held = Held(self._held(end, order))
            self._stretch = key, replace(held, breaks=held.columns(self._records, m.A))
        return self._stretch[1].later(m.tau - end)

    def _held(self, tau: Array, order: list[Array]) -> list[DelayedInput]:
        return [
            delayed_input(record.t, record.u, tau, record.hold, within)
            for record, within in zip(self._records, order, strict=True)
        ]

    def _order(self, m: FilterMatrices, record: Record) -> Array:
        """Delays (nu,) by which breaks and samples are ordered.

        A delay on its bound 0 counts as one to come, but where outputs jump.
        """
        late = m.tau_lam.any(axis=1)
        if record.hold == "zoh":
            late &= ~self._direct
        own = np.where(late, np.maximum(m.tau, LATE * record.dt), m.tau)
        # Stretches are those between whole samples, which an unevenly sampled record has none of.
        return np.where(np.isnan(self._within) | (not record.equidistant), own, self._within)


def common_step(records: Sequence[Record]) -> float | None:
    """The sampling interval of all records [s]; None if they are not sampled evenly and alike."""
    steps = [(record.t[-1] - record.t[0]) / (record.N - 1) for record in records]
    for record, h in zip(records, steps, strict=True):
        off = np.abs(record.t - record.t[0] - steps[0] * np.arange(record.N)).max()
        if off > ROUNDING * h / 4:
            return None
    return float(steps[0])


def stretch(h: float, order: Sequence[Array]) -> Array | None:
    """The whole samples of delay (nu,) [s] up to which no break passes a sample; None before 0."""
    if any((each < 0).any() for each in order):
        return None
    ends = h * np.ceil(np.array(order) / h - ROUNDING)
    return ends[0] if (ends == ends[0]).all() else None
