"""What a log holds: topics, each of columns that were sampled together."""

import io
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array
from casid.channels import in_si
from casid.display import Cells, Tabled, counted, listed
from casid.instants import behind

BEYOND = 1e20  # of any unit: no sensor gives as much, nor do stamps of 64 bits
NEAR = 25  # samples on either side of where stamps go back, by which a clock began anew
STEPPED = 3.0  # usual intervals by which a clock stepped back for good, however short that is
FEW = 20  # places where stamps go back: of more the clock is no better known on either side
NEARLY = 0.05  # of the usual interval: a stamp so soon after another is the same
LASTS = 0.9  # of the longest part between such places: the first that lasts as long is kept
GAP = 5.0  # usual intervals without a sample that make a gap
FREELY = 64 * 2**20  # bytes that a reader may read of the smallest log, and
OFTEN = 8  # times the size of a larger one


@dataclass(frozen=True, eq=False, kw_only=True)
class Topic:
    """Columns of a log that were sampled together, in SI where the log says their units.

    Parameters
    ----------
    name : str
        As the log has it, with the number of the instance: ``"IMU[1]"``.
    t : (N,) array
        Time stamps on the log's clock [s], increasing; `taken` is when samples were taken.
    columns : mapping of (N,) arrays
        Values; what is no number, or beyond all sensors as in a damaged log, is NaN.
    age : float
        How long before its stamp a sample was taken [s], where the log says it; else 0.
    units : mapping of str
        Of columns, as written in a log whose format leaves them to its writer; "" if not stated.
    left_out : int
        Samples whose stamps went back, or were no numbers.
    repeats : int
        Samples left out whose stamps are those of the samples before them.
    went_back : tuple of (float, float)
        Stamps at which the clock went back for good, and by how much [s].
    """

    name: str
    t: Array
    columns: Mapping[str, Array]
    age: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)
    left_out: int = 0
    repeats: int = 0
    went_back: tuple[tuple[float, float], ...] = ()

    @property
    def taken(self) -> Array:
        """When the samples were taken, (N,) [s]: their stamps less their age."""
        return self.t - self.age

    @property
    def interval(self) -> float:
        """Median interval between samples [s]; NaN of a single sample."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else np.nan

    def gaps(self) -> list[tuple[float, float]]:
        """Where no sample came for five usual intervals or longer: from when, for how long [s]."""
        steps = np.diff(self.t)
        wide = np.flatnonzero(steps > GAP * self.interval)
        return [(float(self.t[k]), float(steps[k])) for k in wide]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Log(Tabled):
    """All that could be read of a log.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        Its format.
    topics : mapping
        By name.
    notes : tuple of str
        What is wrong with it: losses, damage, what was not read.
    """

    path: Path
    kind: str
    topics: Mapping[str, Topic]
    notes: tuple[str, ...] = field(default=())

    def headline(self) -> str:
        """File, format and how many topics it has."""
        return f"{self.path.name}, {self.kind}: {counted(len(self.topics), 'topic')}"

    def cells(self) -> Cells:
        """Heading, and one row a topic."""
        rows = []
        for topic in self.topics.values():
            rate = f"{1 / topic.interval:.4g}" if topic.interval > 0 else ""
            names = listed(list(topic.columns))
            rows.append([topic.name, str(len(topic.t)), rate, str(len(topic.gaps())), names])
        return ("topic", "samples", "rate [Hz]", "gaps", "columns"), rows

    def find(self, place: str) -> tuple[Topic, Array] | None:
        """Topic and values of a column, ``"vehicle_attitude.q[0]"``; None if it is not there."""
        for topic in self.topics.values():
            name = place.removeprefix(f"{topic.name}.")
            if name != place and name in topic.columns:
                return topic, topic.columns[name]
        return None


def make_topic(
    name: str, t: Array, columns: Iterable[tuple[str, Array, str]], age: float = 0.0
) -> Topic | None:
    """A topic of columns (name, values, unit) in SI at increasing instants; None without any.

    Samples whose stamps go back or repeat, as those of a damaged log, are left out: as few as
    possible.
    """
    t = np.asarray(t, dtype=float)
    if not len(t):
        return None
    rows = increasing(t)
    values = {}
    for column, x, unit in columns:
        if x.dtype.kind in "fiub" and len(x) == len(t):
            read = np.asarray(x[rows], dtype=float)
            read = np.where(np.abs(read) < BEYOND, read, np.nan)
            values[printable(column)] = read * (in_si(unit) or 1.0)
    name = printable(name)
    repeats = int(np.isin(t[1:][np.diff(t) == 0], t[rows]).sum())
    left_out = len(t) - len(rows) - repeats
    own = t[_numbers(t)]
    back = tuple((float(own[k - 1]), _lag(own, k)) for k in _anew(own))
    lost: dict[str, Any] = {"left_out": left_out, "repeats": repeats, "went_back": back}
    found = Topic(name=name, t=t[rows], columns=values, age=age, **lost)
    return found if values else None


def printable(text: str) -> str:
    """Text of a file without what would do something to a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _numbers(t: Array) -> NDArray[np.intp]:
    """The samples whose stamps are numbers."""
    return np.flatnonzero(np.abs(t) < BEYOND)


def _usual(t: Array) -> float:
    """Median interval of stamps that go ahead [s]; infinite where none does."""
    steps = np.diff(t)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf


def _lag(t: Array, k: int) -> float:
    """By how much stamps are behind from k on [s]."""
    return float(t[k - 1] - t[k]) + _usual(t)


def _anew(t: Array) -> list[int]:
    """Places at which the clock of stamps began anew, or stepped back and stayed there."""
    # A stamp that is wrong is not later than most before it and earlier than most after.
    back, usual = np.flatnonzero(np.diff(t) < 0) + 1, _usual(t)
    return [
        k
        for k in back.tolist()
        if NEAR <= k <= len(t) - NEAR
        and (
            np.median(t[k - NEAR : k]) > np.median(t[k : k + NEAR])
            or (len(back) <= FEW and behind(t, k - 1, usual) > STEPPED * usual)
        )
    ]


def _of_one_clock(t: Array, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """The samples between two places where the clock began anew, the first of the longest."""
    parts = np.split(rows, _anew(t[rows]))
    lasting = np.array([np.ptp(np.percentile(t[part], (1, 99))) for part in parts])
    return parts[int(np.argmax(lasting >= LASTS * lasting.max()))]


def increasing(t: Array) -> NDArray[np.intp]:
    """The longest choice of samples (indices), of one clock, whose stamps are numbers and increase.

    Of what two clocks stamped alike nobody knows which came first.
    """
    rows = _numbers(t)
    if (np.diff(t[rows]) > 0).all():
        return rows
    rows = _of_one_clock(t, rows)
    ends: list[float] = []  # the smallest last stamp of a choice of each length
    at: list[int] = []
    before: list[int] = []
    for k in rows.tolist():
        n = bisect_left(ends, t[k])
        before.append(at[n - 1] if n else -1)
        ends[n : n + 1], at[n : n + 1] = [t[k]], [len(before) - 1]
    chosen, k = [], at[-1] if at else -1
    while k >= 0:
        chosen.append(k)
        k = before[k]
    found = np.asarray(rows[chosen[::-1]])
    steps = np.diff(t[found], prepend=-np.inf)
    return found[steps > NEARLY * _usual(t[found])] if len(found) > 1 else found


class DamagedLogError(Exception):
    """A reader goes in circles; never leaves casid."""


class Bounded(io.BytesIO):
    """Bytes of a log that end the patience with a reader that reads them again and again."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._left = FREELY + OFTEN * len(data)

    def read(self, size: int | None = -1, /) -> bytes:
        """Read; `DamagedLogError` when far more was read than there is."""
        found = super().read(size)
        self._left -= len(found) + 64
        if self._left < 0:
            raise DamagedLogError("its messages lead in circles")
        return found
