"""Samples that only repeat the one before: a slower source read at the rate of a faster logger."""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.record import Record
from casid.samples import known_inputs

SHARE = 0.02  # of the samples while a channel moves, from which on it counts as held
LONGER = 3.0  # times the usual run of equal samples: rest; or times what chance makes
SHORT = 5  # samples of such a run that are no rest in any case
ROUNDING = 1e-12  # of the largest values: a smaller step is none
MOST = 0.99  # of the samples: a larger one may be an outlier of any size
IDLE, AROUND = 0.1, 7  # of the usual step: neighbouring runs that all differ by less are rest
FINE = 0.2  # small steps over usual ones; above, a channel is counted in coarse steps
LEAPS = 30  # moves of several counts, the least that tell of a source behind coarse steps
BESIDE = 0.05  # of them, at most, have another move in the next sample; half of a full rate have
PLAIN = 0.8  # of all moves, at most, are of one size; those of switches and of ramps are
COUNTS = 100  # of a move that are told apart
REGULAR = 0.4  # of the runs, at least, last one interval of the source


def repeated(record: Record) -> BoolArray:
    """Samples that repeat the previous one, in channels whose source is slower than the log.

    Equal samples are no repetition where a channel rests (in runs three times as long as its usual
    one, and longer than five samples, or where all that moves around is a last digit).
    Below 2 % of the samples while a channel moves, they are taken for chance.

    A channel that is counted in coarse steps, as by a converter, repeats itself by chance: it is
    held where it moves by several counts, of different sizes, and rests in the sample after all of
    these moves. Its repetitions are told from equal new samples by the interval of the source. That
    takes thirty such moves and a source of half the logger's rate or less; where the noise is below
    half a count and the motion slow there are none, and such a channel counts as not held.

    Returns
    -------
    (N, nu + ny) bool array
        Inputs, then outputs.
    """
    return np.column_stack([repeats_of(x) for x in np.hstack([record.u, record.y]).T])


def source_interval(record: Record, marks: BoolArray, channel: int) -> float:
    """Interval [s] of the source behind a channel with these ``marks`` of `repeated`."""
    return interval_of(record.dt, np.hstack([record.u, record.y])[:, channel], marks[:, channel])


def without_repeats(record: Record) -> Record:
    """The record with repeated outputs missing, and inputs read between their own samples.

    Inputs do there what the record's ``hold`` says.
    """
    marks = repeated(record)
    if not marks.any():
        return record
    u = np.where(marks[:, : record.nu], np.nan, record.u)
    u, known = known_inputs(record.t, u, [record.hold] * record.nu)
    masked = replace(record, u=np.where(np.isnan(u), record.u, u)).mask(marks[:, record.nu :])
    return masked.take(known)


def quantised(x: Array) -> bool:
    """Whether a channel (N,) is counted in coarse steps, or never moves."""
    moves = np.abs(np.diff(x))
    moves = moves[moves > 0]
    return bool(len(moves) < 2 or np.quantile(moves, 0.05) > FINE * np.median(moves))


def least_step(x: Array) -> float:
    """Step that a channel (N,) is counted in, lost samples left out; 0 if it is not."""
    seen = x[np.isfinite(x)]
    moves = np.abs(np.diff(seen))
    return float(np.quantile(moves[moves > 0], 0.05)) if quantised(seen) and moves.any() else 0.0


def interval_of(dt: float, x: Array, marks: BoolArray) -> float:
    """Interval [s] of the source of a channel (N,), logged every ``dt`` seconds."""
    # A new sample that equals the last is followed by repetitions of it.
    resting = np.concatenate([[False], np.diff(x) == 0]) & ~marks & ~np.append(marks[1:], False)
    fresh = np.isfinite(x) & ~(resting | marks)
    return float(dt * (~resting).sum() / max(fresh.sum(), 1))


def repeats_of(x: Array) -> BoolArray:
    """Those of one channel (N,), as `repeated` marks them."""
    none = np.zeros(len(x), dtype=bool)
    at = np.flatnonzero(np.isfinite(x))
    steps = np.diff(x[at])
    if len(steps) < 2:
        return none
    steps[np.abs(steps) <= ROUNDING * np.quantile(np.abs(x[at]), MOST)] = 0.0
    moves = np.abs(steps[steps != 0])
    if len(moves) < 2:
        return none
    single = np.sum(moves < 1.5 * moves.min())  # steps of one count; none is half as frequent
    by_chance = (single + 2 * np.sqrt(single) + 2) / 2  # at most, as few of them tell
    if len(steps) - len(moves) < LONGER * by_chance:
        return none
    starts = np.concatenate([[0], np.flatnonzero(steps) + 1])
    lengths = np.diff(np.concatenate([starts, [len(at)]]))
    if quantised(x[at]):
        interval = _source_of_steps(moves, lengths)
        if interval > 0:
            since = np.arange(len(at)) - np.repeat(starts, lengths)
            new = np.floor(since / interval) > np.floor((since - 1) / interval)
            usual = np.repeat(lengths <= max(SHORT, LONGER * interval), lengths)
            none[at[~new & usual]] = True
        return none
    ends = np.abs(np.append(steps[starts[1:] - 1], 0.0))
    lively = scipy.ndimage.maximum_filter1d(ends, AROUND) > IDLE * np.median(moves)
    flying = lively & (lengths <= max(SHORT, LONGER * np.median(lengths)))
    equal = np.concatenate([[False], steps == 0]) & np.repeat(flying, lengths)
    if equal.sum() < max(SHARE * lengths[flying].sum(), LONGER * by_chance):
        return none
    none[at[equal]] = True
    return none


def _source_of_steps(moves: Array, lengths: NDArray[np.intp]) -> float:
    """Samples an interval of the source behind a channel counted in coarse steps; 0 if not held.

    ``moves`` (n,) are the sizes of its changes, ``lengths`` (n + 1,) the runs before, between and
    behind them.
    """
    if len(moves) < LEAPS:
        return 0.0
    counts = np.round(moves / np.quantile(moves, 0.05))
    leaps, between = counts > 1, lengths[1:-1]
    beside = np.concatenate([between == 1, [False]]) | np.concatenate([[False], between == 1])
    sizes = np.bincount(np.minimum(counts, COUNTS).astype(int))
    if (
        leaps.sum() < LEAPS
        or (beside & leaps).sum() > BESIDE * leaps.sum()
        or sizes.max() > PLAIN * len(moves)
    ):
        return 0.0
    shortest = np.quantile(between, BESIDE, method="lower")
    single = between[between <= shortest + 1]
    return float(single.mean()) if shortest > 1 and len(single) >= REGULAR * len(between) else 0.0
