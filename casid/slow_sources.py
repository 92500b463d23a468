"""What estimators tell of outputs that repeat the samples of a slower source.

Held from one sample of the source to the next, they are late by half the difference of both
intervals on average, and count several times as measurements.
"""

import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from casid.display import listed
from casid.errors import DataWarning, warn
from casid.record import Record
from casid.repeated_samples import interval_of, repeats_of

ALIKE = 1.05  # times the interval of a source, from which on another is slower
SOURCE = "of a source slower than the logger"


class Source(NamedTuple):
    """Where samples of an output come from."""

    interval: float  # s, between its samples
    logged: float  # s, between those that are logged

    @property
    def late(self) -> float:
        """By how much repeated samples are late in the mean [s]."""
        return (self.interval - self.logged) / 2


def held_outputs(record: Record, outputs: Collection[str] | None = None) -> dict[str, Source]:
    """Sources of those ``outputs``, all unless given, that repeat samples."""
    found = {}
    for name, x in zip(record.outputs, record.y.T, strict=True):
        held = repeats_of(x) if outputs is None or name in outputs else np.zeros(0, dtype=bool)
        if held.any():
            logged = record.dt * len(x) / np.isfinite(x).sum()  # others are missing already
            source = Source(interval_of(record.dt, x, held), float(logged))
            if source.interval > ALIKE * source.logged:
                found[name] = source
    return found


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
    sources = [source for _, held in found for source in held.values()]
    intervals = [source.interval for source in sources]
    rates = f"{1 / max(intervals):.3g}"
    if max(intervals) > ALIKE * min(intervals):
        rates += f" to {1 / min(intervals):.3g}"
    logged = f"{1 / min(source.logged for source in sources):.3g}"
    late = max(source.late for source in sources)
    return (
        f"{listed(names, 10)} repeat{'s' * (len(names) == 1)} samples {SOURCE}{some}: {rates} "
        f"Hz, logged at {logged} Hz. Treated as measurements, they make delays up to "
        f"{1e3 * late:.3g} ms too long and standard errors too small: treat the repeated ones as "
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
