"""Several manoeuvres: their stretches without gaps, channels they share, sizes of these."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import TypeAlias, TypeVar

import numpy as np
import scipy

from casid.arrays import Array
from casid.display import instant, listed
from casid.errors import warn
from casid.record import FEWEST, Hold, Record
from casid.samples import jumps, known_mean
from casid.values import digest

ATTITUDES = {"p": "phi", "q": "theta"}  # what every rate turns
SPACING = 0.5  # s: over which turns are compared
COUNTS, NEAR = {"ms": 1e3, "us": 1e6}, 0.2  # a second in units of time, how near a ratio is to it
MANOEUVRE = 0.9  # cosine of the sizes of inputs in two flights of one manoeuvre
ALIKE, FACTOR = 0.8, 15.0  # correlation of these, and ratio that only another unit explains

T = TypeVar("T")
Records: TypeAlias = Record | Sequence[Record]


def several(items: T | Iterable[T]) -> tuple[T, ...]:
    """One value or several alike, as a tuple: what arguments ``records`` and ``target`` take.

    ValueError: a generator, which would be empty for whoever looks next.
    """
    if isinstance(items, Iterator):
        raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
            f"records or responses come from a {type(items).__name__}, which gives them only once; "
            "pass a list, list(...)"
        )
    return tuple(items) if isinstance(items, Iterable) else (items,)


def stretches(records: Records) -> tuple[Record, ...]:
    """Records without gaps in time; every estimator takes its records through here.

    A record with gaps counts as its `Record.stretches`, each with an initial state of its own. A
    `DataWarning` says so, and that two records hold the same samples, whatever their names, or that
    a rate and its attitude are hardly in units alike. ValueError: a record with nothing but gaps.
    """
    pieces = tuple(piece for record in several(records) for piece in _pieces(record))
    seen: dict[str, list[str]] = {}
    for piece in pieces:
        seen.setdefault(digest(piece.u, piece.y), []).append(repr(piece.name))
    for names in seen.values():
        if (n := len(names)) > 1:
            warn(
                f"records {', '.join(names[:-1])} and {names[-1]} hold the same samples: one "
                f"flight counts {'twice' if n == 2 else f'{n} times'}, and errors come out too "
                f"small by up to √{n}; leave one in"
            )
    for said in units_told(pieces):
        warn(said)
    return pieces


def units_told(records: Records) -> list[str]:
    """A sentence on every rate that turns as far as its attitude only in other units."""
    found = []
    for rate, angle in ATTITUDES.items():
        odd = ((record, _unlike(record, rate, angle)) for record in several(records))
        name, ratio = next(((each.name, ratio) for each, ratio in odd if ratio), ("", 0.0))
        if not ratio:
            continue
        if count := next((u for u, n in COUNTS.items() if abs(ratio / n - 1) < NEAR), ""):
            found.append(
                f"record {name!r}: {rate!r} turns {ratio:.3g} times as far as {angle!r} does: is "
                f"time in {count}, and read as s? State its unit ({count}), or convert it"
            )
            continue
        ways = {rate: ("deg/s", "rad/s"), angle: ("deg", "rad")}
        large, small = (rate, angle) if ratio > 1 else (angle, rate)
        found.append(
            f"record {name!r}: {rate!r} turns {ratio:.3g} times as far as {angle!r} does; is "
            f"{large!r} in {ways[large][0]}, or {small!r} declared {ways[small][0]} and in "
            f"{ways[small][1]}? Rates are rad/s and angles rad here, units named to read_csv or "
            "read_mat are converted"
        )
    return found


def steps_told(records: Records, inputs: Collection[str]) -> list[str]:
    """A sentence on those ``inputs`` that move in steps and are read as straight lines, if any do.

    An input does if it has two jumps or more in some record that mostly go back and forth; those of
    a slower source's repeated samples, or of counts, go on and on.
    """
    found = [
        (name, record.dt)
        for record in several(records)
        for name in record.inputs
        if name in inputs and record.hold == "foh" and _steps(record.channel(name))
    ]
    if not found:
        return []
    names = list(dict.fromkeys(name for name, _ in found))
    half = f"half a sample, {500 * max(dt for _, dt in found):.3g} ms, too long"
    return [
        f"{listed(names)} move{'s' * (len(names) == 1)} in steps, read as straight lines between "
        "samples (hold foh): if a computer or a simulation held every value until the next, delays "
        f'come out up to {half}; read them with hold = "zoh" (read_csv, [channels] of a study). '
        "A jump within one sample does not tell which is right: compare the costs of both fits"
    ]


def twins_told(records: Records) -> list[str]:
    """One line for every two channels that are one signal in all records, names in one order."""
    records = several(records)
    names = (*records[0].inputs, *records[0].outputs)
    x = np.vstack([np.hstack([record.u, record.y]) for record in records])
    return [
        f"{names[i]} and {names[j]} are the same samples: one column read twice?"
        for i in range(len(names))
        for j in range(i)
        if np.ptp(np.nan_to_num(x[:, i])) > 0 and np.array_equal(x[:, i], x[:, j], equal_nan=True)
    ]


def _steps(x: Array) -> bool:
    """Whether a channel (N,) moves in steps of its own."""
    found = jumps(x)
    return len(found) > 1 and bool(found[1:] @ found[:-1] < 0)


def _unlike(record: Record, rate: str, angle: str) -> float | None:
    """How many times as far a rate turns as its attitude does, if no flight explains that."""
    if rate not in record.outputs or angle not in record.outputs:
        return None
    turned, rates = record.channel(angle), record.channel(rate)
    k, known = np.flatnonzero(np.isfinite(turned)), np.isfinite(rates)
    if len(k) < 2 or not known.any():
        return None
    k = k[:: max(1, round(SPACING / float(np.median(np.diff(record.t[k])))))]
    if len(k) < FEWEST:
        return None
    rates = np.interp(record.t, record.t[known], rates[known])
    own = np.diff(turned[k])
    other = np.diff(scipy.integrate.cumulative_trapezoid(rates, record.t, initial=0)[k])
    sizes = np.std(own), np.std(other)
    if min(sizes) == 0 or np.corrcoef(own, other)[0, 1] < ALIKE:
        return None
    ratio = float(sizes[1] / sizes[0])
    return None if 1 / FACTOR < ratio < FACTOR else ratio


def _pieces(record: Record) -> tuple[Record, ...]:
    pieces = record.stretches()
    if len(pieces) == 1 and pieces[0] is record:
        return pieces
    gaps = record.gaps()
    wide = np.diff(record.t)[gaps]
    lost = record.N - sum(piece.N for piece in pieces)
    said = (
        f"record {record.name!r} has {len(gaps)} gap{'s' * (len(gaps) > 1)} in time, the longest "
        f"of {wide.max():.3g} s after {instant(record.t[gaps[np.argmax(wide)]])} s"
    )
    if not pieces:
        raise ValueError(f"{said}, and no stretch of {FEWEST} samples between them; leave it out")
    warn(
        f"{said}: taken as {len(pieces)} stretches, each with an initial state of its own"
        + f"; {lost} samples in shorter ones are left out" * bool(lost)
    )
    return pieces


def same_channels(records: Records) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Inputs and outputs that all records share, in name and order; ValueError if they do not."""
    if not (records := several(records)):
        raise ValueError("no records given; at least one is needed")
    first = records[0]
    for record in records[1:]:
        if (record.inputs, record.outputs) != (first.inputs, first.outputs):
            raise ValueError(
                f"record {record.name!r} has channels {record.inputs} -> {record.outputs}, record "
                f"{first.name!r} has {first.inputs} -> {first.outputs}; use Record.select"
            )
    return first.inputs, first.outputs


def input_levels(sizes: Array) -> tuple[Array, Array]:
    """How large all inputs of every record are together (n,), of sizes (n, nu), each by its most.

    And the cosines of two records' inputs (n, n): above `MANOEUVRE` they fly the same one.
    """
    share = sizes / np.maximum(sizes.max(axis=0), 1e-300)
    level = np.linalg.norm(share, axis=1)
    return level, share @ share.T / np.maximum(np.outer(level, level), 1e-300)


def same_interval(one: Record, other: Record) -> bool:
    """Whether both are sampled equally often, to what a `Record` calls equidistant."""
    return abs(one.dt - other.dt) <= 1e-3 * other.dt


def moves(record: Record, name: str) -> bool:
    """Whether a channel's samples differ by more than rounding."""
    values = record.channel(name)
    values = values[np.isfinite(values)]
    size = np.max(np.abs(values + record.trim.get(name, 0.0)), initial=0.0)
    return bool(values.size and np.ptp(values) > 1e-12 * size)


def still(records: Sequence[Record], names: Iterable[str]) -> list[str]:
    """Channels that move in none of the records."""
    return [name for name in names if not any(moves(record, name) for record in records)]


def check_moved(records: Sequence[Record]) -> None:
    """ValueError where an input never moves in any of the records."""
    for name in still(records, records[0].inputs):
        raise ValueError(
            f"input {name!r} never moves in any record: nothing tells what it does; leave it out, "
            "or add a record in which it is moved"
        )


def check_alive(records: Sequence[Record]) -> None:
    """ValueError where an output has no sample, or never moves, in any of the records."""
    for name in still(records, records[0].outputs):
        if not any(np.isfinite(record.channel(name)).any() for record in records):
            raise ValueError(
                f"output {name!r} is missing in every sample of every record; leave it out of the "
                "structure, or add a record that has it"
            )
        raise ValueError(
            f"output {name!r} never moves in any record: a dead channel, fitted exactly, ruins all "
            "else; leave it out of the structure, or add a record in which it moves"
        )


def standard_deviations(records: Sequence[Record]) -> tuple[Array, Array]:
    """Standard deviation of every input (nu,) and output (ny,) over all records, mean removed."""
    # A channel that never moves (but for rounding) or has no sample has 1: dividing is harmless.
    u, y = (np.vstack([getattr(record, letter) for record in records]) for letter in "uy")
    return _spread(u), _spread(y)


def datum(record: Record) -> Array:
    """What deviations of each output count from, (ny,): its mean, or zero once its trim is out."""
    return np.where([name in record.trim for name in record.outputs], 0.0, known_mean(record.y))


def _spread(values: Array) -> Array:
    mean = known_mean(values)
    spread = np.sqrt(known_mean((values - mean) ** 2))
    return np.where(spread > 1e-12 * np.abs(mean), spread, 1.0)


def common_units(records: Sequence[Record]) -> dict[str, str]:
    """Units that channels of records have other than by name; the first record that states one."""
    return {name: unit for each in reversed(records) for name, unit in each.units.items()}


def common_hold(records: Sequence[Record]) -> Hold | None:
    """What inputs do between the samples of all records; None where these differ."""
    holds = {record.hold for record in records}
    return holds.pop() if len(holds) == 1 else None
