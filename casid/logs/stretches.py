"""Where in a flight the inputs move enough to identify something."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from casid.arrays import Array, BoolArray
from casid.channels import RATES
from casid.excitations import Excitation, excitation_if_any
from casid.record import Record
from casid.samples import runs

WINDOW = 2.0  # s that are judged at once
ACTIVE = 0.25  # of the movement over the whole log
WILD = 0.005  # of the samples, at either end
SHORTEST, LONGEST = 6.0, 30.0  # s of a stretch


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch:
    """A candidate for identification: a cut of a record and what moves it.

    Parameters
    ----------
    record : Record
        The cut, in total values.
    moved : (nu,) array
        Standard deviation of every input.
    excitation : Excitation or None
        How much of the inputs comes from outside; None where it is too short to tell.
    """

    record: Record
    moved: Array
    excitation: Excitation | None


def find_stretches(records: Sequence[Record]) -> list[Stretch]:
    """Cuts of 6 to 30 s in which inputs move and outputs answer, with a quiet edge; in time order.

    Windows of 2 s are active where inputs and rates both move, about straight lines, at least a
    quarter as much as on average over the log, each channel by its own measure.
    """
    bends = [[_bends(record, kind) for kind in ("u", "y")] for record in records]
    moving = [np.ones(len(u), dtype=bool) for u, _ in bends]
    for kind in (0, 1) if records else ():
        size = np.sqrt(np.mean(np.vstack([each[kind] for each in bends]) ** 2, axis=0))
        for active, each in zip(moving, bends, strict=True):
            share = each[kind] / np.where(size > 0, size, 1.0)
            active[:] &= np.sqrt(np.mean(share**2, axis=1)) >= ACTIVE
    spans = [
        (record, span)
        for record, active in zip(records, moving, strict=True)
        for span in _spans(active, record)
    ]
    return [
        make_stretch(record.cut(*span), f"{record.name.split()[0]}_{k}")
        for k, (record, span) in enumerate(spans, 1)
    ]


def make_stretch(record: Record, name: str) -> Stretch:
    """A stretch of a cut that is there already."""
    moved = np.asarray(record.u.std(axis=0))
    return Stretch(
        record=replace(record, name=name), moved=moved, excitation=excitation_if_any(record)
    )


def _bends(record: Record, kind: Literal["u", "y"]) -> Array:
    """Root mean squares of inputs or rates about straight lines in every window, (windows, n)."""
    n = min(max(8, round(WINDOW / record.dt)), record.N)
    rates = [name for name in record.outputs if name in RATES] or record.outputs
    names = record.inputs if kind == "u" else rates
    x = np.nan_to_num(np.column_stack([_within(record.channel(name)) for name in names]))
    k = np.linspace(-1, 1, n)[:, None]
    found = []
    for a in range(0, record.N - n + 1, n):
        window = x[a : a + n]
        left = window - window.mean(axis=0) - k * (k * window).sum(axis=0) / (k**2).sum()
        found.append(np.sqrt(np.mean(left**2, axis=0)))
    return np.array(found)


def _within(x: Array) -> Array:
    """A channel (N,) whose wild samples go no further than twice what nearly all others span.

    One of them would else be the measure of all that moved.
    """
    if not np.isfinite(x).any():
        return x
    low, high = np.nanquantile(x, [WILD, 1 - WILD])
    return np.clip(x, low - (high - low), high + (high - low))


def _spans(active: BoolArray, record: Record) -> list[tuple[float, float]]:
    """Instants from and to of runs of active windows with one window on either side, chopped."""
    wide = np.convolve(active, np.ones(3), mode="full")[1:-1] > 0
    n = min(max(8, round(WINDOW / record.dt)), record.N)
    spans = []
    for a, b in runs(wide):
        start, end = float(record.t[a * n]), float(record.t[min(b * n, record.N - 1)])
        pieces = max(1, int(np.ceil((end - start) / LONGEST)))
        at = np.linspace(start, end, pieces + 1)
        spans += [(x, y) for x, y in pairwise(at) if y - x >= SHORTEST]
    return spans
