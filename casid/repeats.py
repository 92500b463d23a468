"""What estimators tell of outputs that repeat the samples of a slower source.

Held from one sample of the source to the next, they are late by half the difference of both
intervals on average, and count several times as measurements.
"""

import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

from casid.display import listed
from casid.errors import DataWarning, warn
from casid.record import Record
from casid.repetition import interval_of, repeats_of

ALIKE = 1.05  # times the interval of a source, from which on another is slower
SOURCE = "of a source slower than the logger"


def held_outputs(record: Record, outputs: Collection[str] | None = None) -> dict[str, float]:
    """Interval [s] of the source of those ``outputs``, all unless given, that repeat samples."""
    pairs = zip(record.outputs, record.y.T, strict=True)
    own = ((name, x) for name, x in pairs if outputs is None or name in outputs)
    marks = ((name, x, repeats_of(x)) for name, x in own)
    return {name: interval_of(record.dt, x, held) for name, x, held in marks if held.any()}


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
