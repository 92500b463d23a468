"""Channels that stand still while the aircraft moves, blocks of samples twice, sticks that dart.

A stuck sensor repeats its last value, a logger that lost one may repeat a whole block. Neither is
called so unless it must be: a channel that is counted in coarse steps may rest on one of them, a
slower source is held, and what all other channels expect to rest may rest. Nothing tells what an
input should have done: one is called stuck only where it never rests else, moves before and after,
and is noisy or jumps when it moves again. Where all channels stop at once the logger did. A stick
that leaves a smooth way and is back after a few samples was hardly moved so.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from casid.arrays import Array, BoolArray
from casid.autoregression import filled
from casid.display import instant
from casid.record import Record
from casid.repeated_samples import ROUNDING, quantised
from casid.samples import runs

SHORT, LONGER = 10, 4.0  # samples of a run that is looked at, and times the usual one
MOVED = 0.1  # of a channel's deviation: what the others expect of it meanwhile
BRIEF, SEVERAL = 6, 3  # repeated samples of outputs, at least, that stop and move on together
WORD = 8  # samples whose equality is counted
RARE = 1e-3  # blocks that chance repeats in a record
NOISY = 0.2  # noise over usual steps, from which on a channel never repeats a sample by itself
JUMP = 4.0  # times the steps that follow
AGAIN = 0.02  # share of repeated samples of a channel that rests now and then
DART = 0.2  # of an input's range that it darts at least
BRIEFLY, AROUND = 0.08, 4  # s and samples, at most
LEAPS = 10.0  # times what the input moves from sample to sample before and after
PERIODIC = 0.25  # share of a channel's samples that occur again: it is periodic


@dataclass(frozen=True, kw_only=True)
class Frozen:
    """A stretch of one channel, of some that stop together, or of all, that was not measured."""

    channel: str
    start: float  # s
    duration: float  # s
    source: float | None = None  # start [s] of the block that it repeats; None where it is stuck
    dart: bool = False  # an input that leaves its way and returns
    zero: bool = False  # channels of one source that are all zero
    lost: Literal["output", "input", "rows"] = "output"

    def told(self) -> str:
        """What it is, and what to do."""
        when = f"from {instant(self.start)} s for {self.duration:.3g} s"
        stands = "stand" if " " in self.channel else "stands"
        what = f"{self.channel} {stands} still {when} while all else moves"
        if self.zero:
            what = f"{self.channel} are zero {when}, all at once: their source was lost"
        if self.source is not None:
            what = f"{self.channel} repeats {when} exactly what it was at {instant(self.source)} s"
        if self.lost == "output":
            return f"{what}: it was not measured; mark these samples as missing (Record.mask)"
        if self.lost == "rows":
            what = f"all channels stand still {when}: the logger stalled"
        if self.dart:
            what = f"{self.channel} jumps away {when} and returns"
            return f"{what}: unless it was moved so, leave these rows out (Record.take)"
        if self.source is not None:
            return f"{what}: unless it was moved so twice, leave these rows out (Record.cut)"
        return f"{what}; no one knows the inputs there: leave these rows out (Record.cut)"


def frozen(record: Record) -> tuple[Frozen, ...]:
    """Stretches of channels that are stuck or copied, and of all at once if the logger stalls."""
    stalls = tuple(_stalled(record))
    stalls += tuple(
        each for each in _lost_source(record) if not any(_within(each, s) for s in stalls)
    )
    single = (*_stuck(record), *_stuck_inputs(record), *_darts(record), *_copied(record))
    return (*stalls, *(each for each in single if not any(_within(each, s) for s in stalls)))


def _within(each: Frozen, stall: Frozen) -> bool:
    """Whether a stretch is no more than what a stall of the logger makes of its channel."""
    apart = abs(each.start - stall.start) + abs(each.duration - stall.duration)
    return apart < 0.1 * stall.duration


def _stalled(record: Record) -> Iterator[Frozen]:
    z = np.hstack([record.u, record.y])
    same = (z[1:] == z[:-1]) | (np.isnan(z[1:]) & np.isnan(z[:-1]))
    still = np.concatenate([[False], same.all(axis=1) & np.isfinite(record.y[1:]).any(axis=1)])
    fresh = np.diff(np.flatnonzero(np.concatenate([~still, [True]])))
    least = max(SHORT, LONGER * float(np.median(fresh)))
    for first, last in runs(still):
        rest = np.array_equal(z[first], z[0], equal_nan=True)
        if last - first >= least and not rest:
            seen = [x for x in record.y.T if np.isfinite(x).all()]
            if any(_breaks(x, still, first, last) for x in seen):
                start, end = record.t[[first - 1, last - 1]].tolist()
                yield Frozen(channel="all", start=start, duration=end - start, lost="rows")


def _lost_source(record: Record) -> Iterator[Frozen]:
    """Outputs that stop at one sample and move on at another: those of one source that was lost.

    As many do not rest together by chance, whatever they rest on, and however briefly.
    """
    together: dict[tuple[int, int], list[int]] = {}
    for i, x in enumerate(record.y.T):
        still = np.concatenate([[False], np.diff(x) == 0])
        for first, last in runs(still):
            if last - first >= BRIEF and _breaks(x, still, first, last):
                together.setdefault((int(first), int(last)), []).append(i)
    for (first, last), own in together.items():
        moves = len(own) < record.ny or np.ptp(record.u[first - 1 : last], axis=0).any()
        if len(own) >= SEVERAL and moves:  # else the logger did
            start, end = record.t[[first - 1, last - 1]].tolist()
            yield Frozen(
                channel=" ".join(record.outputs[i] for i in own),
                start=start,
                duration=end - start,
                zero=not any(record.totals()[record.outputs[i]][first] for i in own),
            )


def _stuck_inputs(record: Record) -> Iterator[Frozen]:
    for name, x in zip(record.inputs, record.u.T, strict=True):
        marks = _resting(x)
        for first, last in runs(marks):
            if _breaks(x, marks, first, last):
                start, end = record.t[[first - 1, last - 1]].tolist()
                yield Frozen(channel=name, start=start, duration=end - start, lost="input")


def _darts(record: Record) -> Iterator[Frozen]:
    """Where an input is off its running median, which follows what lasts, for a few samples.

    One that moves about like that, as what a quick controller commands, may do so, and so may one
    that is counted, by a few counts.
    """
    reach = int(np.clip(round(BRIEFLY / record.dt), 1, AROUND))
    for name, x in zip(record.inputs, record.u.T, strict=True):
        off = np.abs(x - scipy.ndimage.median_filter(x, 2 * reach + 1, mode="nearest"))
        away = off > DART * np.ptp(x)
        count = _count(x, away)
        for first, last in runs(away):
            beside = [x[max(first - SHORT, 0) : first], x[last : last + SHORT]]
            moves = (float(np.abs(np.diff(part)).max(initial=0.0)) for part in beside)
            quiet = max(count / 2, *moves)  # what moves by less than half a count is not seen
            end = min(last, record.N - 1)
            if off[first:last].min() > LEAPS * quiet and 0 < first < end:
                start, over = record.t[[first, end]].tolist()
                yield Frozen(
                    channel=name, start=start, duration=over - start, lost="input", dart=True
                )


def _count(x: Array, away: BoolArray) -> float:
    """Smallest move of a channel (N,) but into and out of darts: a count, or next to nothing."""
    moves = np.abs(np.diff(x))[~(away[1:] | away[:-1])]
    moves = moves[moves > ROUNDING * np.abs(x).max()]
    return float(moves.min()) if len(moves) else 0.0


def _breaks(x: Array, still: BoolArray, first: int, last: int) -> bool:
    """Whether a run of equal samples of a channel (N,) is none of its own.

    The channel moves before and after and rests nowhere else but in trim and in runs like this
    (``still``), and is noisy or jumps at the end of the run.
    """
    steps = np.diff(x)
    before, after = steps[max(first - 1 - SHORT, 0) : first - 1], steps[last : last + SHORT]
    others = x[~still & np.isfinite(x)]
    if min(len(before), len(after)) < SHORT or not (before.all() and after.all()):
        return False
    if np.mean((np.diff(others) == 0) & (others[1:] != x[0])) > AGAIN:
        return False
    return _noisy(others) or bool(abs(steps[last - 1]) > JUMP * np.nanmax(np.abs(after)))


def _noisy(x: Array) -> bool:
    """Whether a channel (N,) is too noisy to repeat samples, from its third differences."""
    third, first = np.median(np.abs(np.diff(x, 3))), np.median(np.abs(np.diff(x)))
    return bool(third > NOISY * np.sqrt(10) * first)  # of white noise alone √10 of them


def _stuck(record: Record) -> Iterator[Frozen]:
    marks = np.column_stack([_resting(x) for x in record.y.T])
    for i in np.flatnonzero(marks.any(axis=0)):
        own = np.zeros_like(marks)
        own[:, i] = marks[:, i]
        x = record.y[:, i]
        expected = filled(record.mask(own))[0].y[:, i]
        for first, last in runs(marks[:, i]):
            away = np.sqrt(np.mean((expected[first:last] - x[first - 1]) ** 2))
            if away > MOVED * np.nanstd(x):
                start, end = record.t[[first - 1, last - 1]].tolist()
                yield Frozen(channel=record.outputs[i], start=start, duration=end - start)


def _resting(x: Array) -> BoolArray:
    """Samples (N,) that repeat the one before for much longer than is usual, inside the range."""
    marks = np.zeros(len(x), dtype=bool)
    at = np.flatnonzero(np.isfinite(x))
    if len(at) < SHORT or quantised(x[at]):
        return marks
    starts = np.concatenate([[0], np.flatnonzero(np.diff(x[at])) + 1, [len(at)]])
    lengths = np.diff(starts)
    long = lengths > max(SHORT, LONGER * float(np.median(lengths)))
    # Trim comes first. At its extremes a channel is saturated, which is told as such.
    rest = np.isin(x[at[starts[:-1]]], [x[at[0]], x[at].min(), x[at].max()])
    for k in np.flatnonzero(long & ~rest):
        marks[at[starts[k] + 1] : at[starts[k + 1] - 1] + 1] = True
    return marks


def _copied(record: Record) -> Iterator[Frozen]:
    for i, name in enumerate((*record.inputs, *record.outputs)):
        x = record.channel(name)
        at = np.flatnonzero(np.isfinite(x))
        # What is given by a generator may be given again, noise may not.
        if len(at) < 4 * WORD or (i < record.nu and not _noisy(x)):
            continue
        t = record.t[at]
        lost: Literal["input", "output"] = "input" if i < record.nu else "output"
        for first, length, lag in _blocks(x[at]):
            start, end = t[[first, first + length - 1]].tolist()
            source = float(t[first - lag])
            yield Frozen(channel=name, start=start, duration=end - start, source=source, lost=lost)


def _blocks(x: Array) -> list[tuple[int, int, int]]:
    """First sample, length and distance of blocks that repeat an earlier one of a channel."""
    # Words of noise hold values that occur once: only the others need be compared.
    ascending = np.sort(x)
    values = ascending[1:][ascending[1:] == ascending[:-1]]
    twice = np.flatnonzero(sliding_window_view(np.isin(x, values), WORD).all(axis=1))
    if not len(twice):
        return []
    words = sliding_window_view(x + 0.0, WORD)
    n, still = len(words), np.ptp(words[twice], axis=1) == 0
    moving = twice[~still]
    if not len(moving):
        return []
    _, which, count = np.unique(words[moving], axis=0, return_inverse=True, return_counts=True)
    chance = (np.sum(count * (count - 1.0)) + still.sum() ** 2 + 1) / n**2
    if chance >= 1:
        return []
    # Blocks of so many samples would be equal by chance once in a thousand records.
    least = max(2 * WORD, WORD * np.log(n**2 / RARE) / -np.log(chance))
    order = np.lexsort((moving, which.ravel()))
    lag = np.zeros(n, dtype=int)
    again = np.diff(which.ravel()[order], prepend=-1) == 0
    lag[moving[order]] = np.where(again, np.diff(moving[order], prepend=0), 0)
    if np.mean(lag > 0) > PERIODIC:
        return []
    found = []
    for first, last in runs(lag > 0):
        edges = [first, *(first + 1 + np.flatnonzero(np.diff(lag[first:last]))), last]
        for a, b in pairwise(edges):
            if (length := b - a + WORD - 1) >= least and lag[a] >= length:
                found.append((int(a), int(length), int(lag[a])))
    return found
