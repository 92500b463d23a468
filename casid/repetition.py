"""Samples that only repeat the one before: a slower source read at the rate of a faster logger."""

import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.display import listed
from casid.errors import DataWarning, warn
from casid.record import Record
from casid.samples import known_inputs

SHARE = 0.02  # of the samples while a channel moves, from which on it counts as held
LONGER = 3.0  # times the usual run of equal samples: rest; or times what chance makes
SHORT = 5  # samples of such a run that are no rest in any case
ROUNDING = 1e-12  # of the largest value: a smaller step is none
IDLE, AROUND = 0.1, 7  # of the usual step: neighbouring runs that all differ by less are rest
FINE = 0.2  # small steps over usual ones; above, a channel is counted in coarse steps
ALIKE = 1.05  # times the interval of a source, from which on another is slower
SOURCE = "of a source slower than the logger"


def repeated(record: Record) -> BoolArray:
    """Samples that repeat the one before in a channel held between those of a slower source.

    Equal samples are no repetition where a channel rests (in runs three times as long as its usual
    one, and longer than five samples, or where all that moves around is a last digit), nor of one
    that is counted in steps, as a converter does.
    Below 2 % of the samples while a channel moves, they are taken for chance.

    Returns
    -------
    (N, nu + ny) bool array
        Inputs, then outputs.
    """
    return np.column_stack([_repeated(x) for x in np.hstack([record.u, record.y]).T])


def source_interval(record: Record, marks: BoolArray, channel: int) -> float:
    """Interval [s] of the source behind a channel with these ``marks`` of `repeated`."""
    return _interval(record.dt, np.hstack([record.u, record.y])[:, channel], marks[:, channel])


def held_outputs(record: Record, outputs: Collection[str] | None = None) -> dict[str, float]:
    """Interval [s] of the source of those ``outputs``, all unless given, that repeat samples."""
    pairs = zip(record.outputs, record.y.T, strict=True)
    own = ((name, x) for name, x in pairs if outputs is None or name in outputs)
    marks = ((name, x, _repeated(x)) for name, x in own)
    return {name: _interval(record.dt, x, held) for name, x, held in marks if held.any()}


def repeats_told(records: Sequence[Record], outputs: Collection[str] | None = None) -> str:
    """A sentence on those ``outputs``, all unless given, that repeat samples; "" if none do."""
    every = list({id(record): record for record in records}.values())
    looked = [(record, held_outputs(record, outputs)) for record in every]
    found = [(record, held) for record, held in looked if held]
    if not found:
        return ""
    names = list(dict.fromkeys(name for _, held in found for name in held))
    where = list(dict.fromkeys(repr(record.name) for record, _ in found))
    some = f" in record{'s' * (len(where) > 1)} {listed(where)}" * (len(found) < len(every))
    intervals = [interval for _, held in found for interval in held.values()]
    rates = f"{1 / max(intervals):.3g}"
    if max(intervals) > ALIKE * min(intervals):
        rates += f" to {1 / min(intervals):.3g}"
    logged = f"{1 / min(record.dt for record, _ in found):.3g}"
    late = max(max(held.values()) - record.dt for record, held in found) / 2
    return (
        f"{listed(names, 10)} repeat{'s' * (len(names) == 1)} samples {SOURCE}{some}: {rates} Hz, "
        f"logged at {logged} Hz. Taken for measurements, they make delays up to "
        f"{1e3 * late:.3g} ms too long and standard errors too small: take the repeated ones for "
        'missing (without_repeats; repeats = "mask" in [channels] of a study)'
    )


def tell_repeats(records: Sequence[Record], outputs: Collection[str] | None = None) -> None:
    """Warn of those ``outputs``, all unless given, that repeat samples."""
    if said := repeats_told(records, outputs):
        warn(said)


@contextmanager
def repeats_known() -> Iterator[None]:
    """Within, estimators do not warn of repeated samples: who runs them has told of all."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", f".* samples {SOURCE}", DataWarning)
        yield


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


def _interval(dt: float, x: Array, marks: BoolArray) -> float:
    """Interval [s] of the source of a channel (N,), logged every ``dt`` seconds."""
    resting = np.concatenate([[False], np.diff(x) == 0]) & ~marks
    fresh = np.isfinite(x) & ~(resting | marks)
    return float(dt * (~resting).sum() / max(fresh.sum(), 1))


def _repeated(x: Array) -> BoolArray:
    none = np.zeros(len(x), dtype=bool)
    at = np.flatnonzero(np.isfinite(x))
    steps = np.diff(x[at])
    steps[np.abs(steps) <= ROUNDING * np.abs(x[at]).max(initial=0.0)] = 0.0
    moves = np.abs(steps[steps != 0])
    if len(moves) < 2:
        return none
    single = np.sum(moves < 1.5 * moves.min())  # steps of one count; none is half as frequent
    by_chance = (single + 2 * np.sqrt(single) + 2) / 2  # at most, as few of them tell
    if len(steps) - len(moves) < LONGER * by_chance or quantised(x[at]):
        return none
    starts = np.concatenate([[0], np.flatnonzero(steps) + 1])
    lengths = np.diff(np.concatenate([starts, [len(at)]]))
    ends = np.abs(np.append(steps[starts[1:] - 1], 0.0))
    lively = scipy.ndimage.maximum_filter1d(ends, AROUND) > IDLE * np.median(moves)
    flying = lively & (lengths <= max(SHORT, LONGER * np.median(lengths)))
    equal = np.concatenate([[False], steps == 0]) & np.repeat(flying, lengths)
    if equal.sum() < max(SHARE * lengths[flying].sum(), LONGER * by_chance):
        return none
    none[at[equal]] = True
    return none
