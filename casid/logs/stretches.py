"""Where in a flight the inputs move enough to identify something."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from casid.arrays import Array, BoolArray
from casid.channels import RATES
from casid.excitations import ANSWER, Excitation, excitation_if_any
from casid.logs.commands import MOVES
from casid.record import Record
from casid.samples import runs

WINDOW = 2.0  # s that are judged at once
ACTIVE = 0.25  # of the movement over the whole log
WILD = 0.005  # of the samples, at either end
SHORTEST, LONGEST = 6.0, 30.0  # s of a stretch
HEAVES = ("az", "w")  # what a collective moves, rates at rest
STANDS_OUT = 4.0  # times the movement of a quiet quarter of the log: a stick is flown,
HALF = 0.5  # where it moves as much of its average over the log, too
ANSWERED, TOLD = 2, 3  # windows in a row of a stick that is flown: judged; told if left out
QUARTER = 0.25


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
    quarter as much as on average over the log, each channel by its own measure. A collective that
    is flown moves no rate: windows are active, too, where it stands out from the quiet parts of the
    log and makes most of az or w (`excitation`).
    """
    bends = [[_bends(record, kind) for kind in ("u", "y")] for record in records]
    moving = [np.ones(len(u), dtype=bool) for u, _ in bends]
    for kind in (0, 1) if records else ():
        size = np.sqrt(np.mean(np.vstack([each[kind] for each in bends]) ** 2, axis=0))
        for active, each in zip(moving, bends, strict=True):
            share = each[kind] / np.where(size > 0, size, 1.0)
            active[:] &= np.sqrt(np.mean(share**2, axis=1)) >= ACTIVE
    flown = _flown([u for u, _ in bends])
    for active, record, sticks in zip(moving, records, flown, strict=True):
        for stick, own in zip(record.inputs, sticks.T, strict=True):
            for a, b in runs(own & ~active) if MOVES.get(stick) in HEAVES else ():
                if b - a >= ANSWERED and _heaves(record, stick, _span(record, a, b)):
                    active[a:b] = True
    spans = [
        (record, span)
        for record, active in zip(records, moving, strict=True)
        for span in _spans(active, record)
    ]
    return [
        make_stretch(record.cut(*span), f"{record.name.split()[0]}_{k}")
        for k, (record, span) in enumerate(spans, 1)
    ]


def left_out(records: Sequence[Record], found: Sequence[Stretch]) -> tuple[str, ...]:
    """Where sticks are flown for 6 s or longer that stand in no stretch, a sentence each stick."""
    spans: dict[str, list[str]] = {}
    sticks = _flown([_bends(record, "u") for record in records])
    for record, flown in zip(records, sticks, strict=True):
        n = _samples(record)
        middle = record.t[: len(flown) * n : n] + WINDOW / 2
        ends = [each.record.t[[0, -1]] for each in found]
        taken = np.any([(middle > a) & (middle < b) for a, b in ends], axis=0)
        for stick, own in zip(record.inputs, flown.T, strict=True):
            for a, b in runs(own & ~taken):
                if b - a >= TOLD:
                    start, end = _span(record, a, b, beside=0)
                    spans.setdefault(stick, []).append(f"{start:.4g}-{end:.4g}")
    logged = [name for name in HEAVES if records and name in records[0].outputs]
    said = []
    for stick, at in spans.items():
        why = "and the rates do not answer"
        if MOVES.get(stick) in HEAVES and logged:
            why = f"the rates rest and it makes less than half of {' or '.join(logged)}"
        elif MOVES.get(stick) in HEAVES:
            why = f"the rates rest and the log has no {' or '.join(HEAVES)} that could answer"
        said.append(
            f"{stick} is moved at {' and '.join(at)} s, {why}: in no stretch; the whole flight to "
            "cut from is in import_log(...).records"
        )
    return tuple(said)


def _flown(bends: Sequence[Array]) -> list[BoolArray]:
    """In which windows (windows, nu) each stick stands out, of bends of every record."""
    if not bends:
        return []
    every = np.vstack(list(bends))
    least = np.maximum(
        HALF * np.sqrt(np.mean(every**2, axis=0)), STANDS_OUT * np.quantile(every, QUARTER, axis=0)
    )
    return [(own >= least) & (own > 0) for own in bends]


def _heaves(record: Record, stick: str, span: tuple[float, float]) -> bool:
    """Whether a stick makes most of az or w in a span."""
    cut = record.cut(*span)
    for name in HEAVES:
        if name in record.outputs:
            found = excitation_if_any(cut.select((stick,), (name,)))
            if found is not None and found.answer.max(initial=0.0) >= ANSWER:
                return True
    return False


def make_stretch(record: Record, name: str) -> Stretch:
    """A stretch of a cut that is there already."""
    moved = np.asarray(record.u.std(axis=0))
    return Stretch(
        record=replace(record, name=name), moved=moved, excitation=excitation_if_any(record)
    )


def _bends(record: Record, kind: Literal["u", "y"]) -> Array:
    """Root mean squares of inputs or rates about straight lines in every window, (windows, n)."""
    n = _samples(record)
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
    spans = []
    for a, b in runs(wide):
        start, end = _span(record, a, b, beside=0)
        pieces = max(1, int(np.ceil((end - start) / LONGEST)))
        at = np.linspace(start, end, pieces + 1)
        spans += [(x, y) for x, y in pairwise(at) if y - x >= SHORTEST]
    return spans


def _samples(record: Record) -> int:
    """Of a window."""
    return min(max(8, round(WINDOW / record.dt)), record.N)


def _span(record: Record, a: int, b: int, beside: int = 1) -> tuple[float, float]:
    """Instants from and to of windows a to b, with so many on either side [s]."""
    n = _samples(record)
    ends = max(a - beside, 0) * n, min((b + beside) * n, record.N - 1)
    return float(record.t[ends[0]]), float(record.t[ends[1]])
