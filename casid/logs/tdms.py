"""TDMS files of LabVIEW, read by npTDMS.

Format: https://www.ni.com/en/support/documentation/supplemental/07/tdms-file-format-internal-structure.html
"""

import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.channels import MEASURES
from casid.display import listed
from casid.logs.topics import Bounded, Topic, make_topic, printable

MAGIC = b"TDSm"
TIMES = {  # names of columns of instants, a unit behind them left out
    *("t", "time", "times", "timestamp", "timestamps", "time stamp", "time stamps", "zeit"),
    *("elapsed time", "time elapsed", "elapsed", "relative time", "rel time", "test time"),
    *("time axis", "time vector", "seconds", "milliseconds", "microseconds", "nanoseconds"),
}
DATES = {"date", "datetime", "date time"}  # the same of columns that hold dates
BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]")  # a name, its unit in them
SPELT = {  # units of time, as they are written beside those that casid knows
    "": 1.0,
    **dict.fromkeys(("sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("usec", "µsec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
}
SECONDS = MEASURES["s"] | SPELT
STEP, START, BEGUN = "wf_increment", "wf_start_offset", "wf_start_time"  # of a waveform
UNSET = np.datetime64("1904-01-02")  # LabVIEW's zero, as of clocks that nobody has set
SECOND = np.timedelta64(1, "s")
UNIT = ("unit_string", "NI_UnitDescription")
REMEDY = (
    ": waveforms have it in their properties (wf_increment), other groups in a column of instants "
    "as long as theirs, called Time [s], Time [ms] or the like"
)


def read_tdms(data: bytes, library: ModuleType) -> tuple[Iterator[Topic], tuple[str, ...]]:
    """Topics of a TDMS file, one a group and clock, and what has no time."""
    library.log.log_manager.set_level(logging.ERROR)  # what is cut off is told below
    topics: list[Topic] = []
    notes = []
    with library.TdmsFile.open(Bounded(data)) as file:
        if file.file_status.incomplete_final_segment:
            notes.append("the file ends before its last segment does; what could be read is here")
        groups = {
            group.name: [each for each in group.channels() if _numeric(each, len(data))]
            for group in file.groups()
        }
        starts = {name: _starts(channels) for name, channels in groups.items() if channels}
        epoch = min((start for own in starts.values() for start in own), default=None)
        if epoch is not None and (open_ := [name for name, own in starts.items() if not own]):
            notes.append(
                f"{', '.join(map(repr, open_))} count from an unknown instant, the other groups "
                "from a date: assumed to begin together, look at the delays"
            )
        for name, channels in groups.items():
            found, without = _group(name, channels, epoch)
            topics += found
            if without:
                named = listed([printable(each) for each in without])
                notes.append(f"group {name!r}: no time is known for {named}{REMEDY}")
            notes += [
                f"group {name!r}: {printable(each.name)} is in {printable(_counted(each))!r}, no "
                "unit of time that is known: taken as seconds"
                for each in _clocks(channels).values()
                if np.dtype(each.dtype).kind != "M" and _counted(each) not in SECONDS
            ]
    return iter(topics), tuple(notes)


def _numeric(channel: Any, size: int) -> bool:  # noqa: ANN401 - npTDMS has no types
    kind = np.dtype(channel.dtype)
    return kind.kind in "fiubM" and 0 < len(channel) * max(kind.itemsize, 1) <= 2 * size


def _start(channel: Any) -> np.datetime64 | None:  # noqa: ANN401
    """The date from which a waveform counts, if it has one."""
    told = channel.properties.get(BEGUN)
    known = isinstance(told, np.datetime64) and not np.isnat(told) and told > UNSET
    return told if known else None


def _starts(channels: Sequence[Any]) -> list[np.datetime64]:
    """Dates from which a group's waveforms and columns of dates count."""
    dates = [each[:] for each in channels if np.dtype(each.dtype).kind == "M"]
    told = [_start(each) for each in channels]
    told += [each[~np.isnat(each)].min() for each in dates if not np.isnat(each).all()]
    return [each for each in told if each is not None]


def _group(
    name: str, channels: Sequence[Any], epoch: np.datetime64 | None
) -> tuple[list[Topic], list[str]]:
    """Topics of a group's channels, which may be sampled at several rates; those without time.

    What has a date counts from the epoch, the first of the whole file.
    """
    clocks: dict[tuple[Any, ...], tuple[Array, list[Any]]] = {}
    stamped, without = _clocks(channels), []
    for each in channels:
        step = each.properties.get(STEP)
        if isinstance(step, float) and 0 < step < np.inf:
            late = float(each.properties.get(START) or 0.0)
            if (start := _start(each)) is not None:
                late += float((start - epoch) / SECOND)
            key: tuple[Any, ...] = (len(each), step, late)
            clocks.setdefault(key, (late + step * np.arange(len(each)), []))[1].append(each)
        elif len(each) in stamped:
            if each is not stamped[len(each)]:
                key = (len(each),)
                clocks.setdefault(key, (_seconds(stamped[len(each)], epoch), []))[1].append(each)
        else:
            without.append(each.name)
    topics = []
    for k, (t, members) in enumerate(clocks.values()):
        columns = ((each.name, each[:], _unit(each)) for each in members)
        topic = make_topic(name if k == 0 else f"{name} ({k + 1})", t, columns)
        units = {printable(each.name): printable(_unit(each)) for each in members}
        topics += [replace(topic, units=units)] if topic is not None else []
    return topics, without


def _clocks(channels: Sequence[Any]) -> dict[int, Any]:
    """Columns of instants, by their length: of several the one of the plainest name."""
    named = [(_split(each.name)[0], each) for each in channels]
    dated = {id(each) for each in channels if np.dtype(each.dtype).kind == "M"}
    known = [(len(n), x) for n, x in named if n in TIMES or (n in DATES and id(x) in dated)]
    return {len(each): each for _, each in sorted(known, key=lambda row: -row[0])}


def _split(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit, in lower case: "Time (ms)", "time_ms"."""
    plain = " ".join(name.lower().replace("_", " ").replace("μ", "µ").split())
    if found := BRACKETS.fullmatch(plain):
        return found[1], found[2]
    before, _, last = plain.rpartition(" ")
    return (before, last) if before and last in SECONDS else (plain, "")


def _counted(channel: Any) -> str:  # noqa: ANN401
    """The unit in which a column counts time, as it is stated or as its name says."""
    name, unit = _split(channel.name)
    return _unit(channel).lower() or unit or (name if name in SECONDS else "")


def _seconds(channel: Any, epoch: np.datetime64 | None) -> Array:  # noqa: ANN401
    """A column of instants [s], of numbers in the unit that it names."""
    values = channel[:]
    if values.dtype.kind == "M":
        return np.asarray((values - epoch) / SECOND, dtype=float)
    return np.asarray(values, dtype=float) * SECONDS.get(_counted(channel), 1.0)


def _unit(channel: Any) -> str:  # noqa: ANN401
    said = [channel.properties[key] for key in UNIT if key in channel.properties]
    return str(said[0]).strip() if said else ""
