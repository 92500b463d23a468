"""Channels where a log keeps them: a column of a topic and its values."""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.channels import in_si
from casid.logs.topics import Log, Topic

LARGEST = 1e6  # in SI, or whatever an input is in: no channel of an aircraft reaches it
MEASURED = 0.5  # of a column's samples, without which it is none
UNIT = re.compile(r"\s*[\[(]([^\])]+)[\])]\s*$")  # behind a name: "Roll [deg]"


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """Where a channel comes from, and its values in SI, NaN where no instrument measures them.

    ``unit`` is what the log, or the user, states of the column; None where its format fixes it.
    """

    place: str
    topic: Topic
    values: Array
    unit: str | None = None


def source_of(log: Log, place: str) -> Source | None:
    """The column of a place, a sign before it turned; None where it is not, or measures nothing."""
    found = log.find(place.removeprefix("-"))
    if found is None or len(found[0].t) < 4:
        return None
    topic, values = found[0], np.where(np.abs(found[1]) < LARGEST, found[1], np.nan)
    if np.isfinite(values).mean() < MEASURED:
        return None
    column = place.removeprefix("-").removeprefix(f"{topic.name}.")
    unit = topic.units.get(column)
    if unit == "" and (unit := with_unit(column)[1]):  # where the log's writer states no other
        values = (in_si(unit) or 1.0) * values
    return Source(
        place=place, topic=topic, values=-values if place[0] == "-" else values, unit=unit
    )


def moves(source: Source) -> bool:
    """Whether it does not rest."""
    known = source.values[np.isfinite(source.values)]
    return bool(len(known) and np.ptp(known) > 0)


def moving(log: Log, wanted: Callable[[Topic, str], bool]) -> list[Source]:
    """Columns that move of those wanted, in any topic."""
    places = (
        f"{topic.name}.{column}"
        for topic in log.topics.values()
        for column in topic.columns
        if wanted(topic, column)
    )
    found = (source_of(log, place) for place in places)
    return [each for each in found if each is not None and moves(each)]


def with_unit(column: str) -> tuple[str, str]:
    """A column's name and the unit behind it, ``"Roll [deg]"`` Roll and deg; "" without one."""
    found = UNIT.search(column)
    known = found is not None and not found[1].isdecimal() and in_si(found[1]) is not None
    return (column[: found.start()], found[1].strip()) if found and known else (column, "")


def bare(column: str) -> str:
    """A column's name in lower case, without a unit behind it."""
    return with_unit(column)[0].strip().lower()
