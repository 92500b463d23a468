"""TDMS files of LabVIEW, read by npTDMS.

Format: https://www.ni.com/en/support/documentation/supplemental/07/tdms-file-format-internal-structure.html
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.logs.topics import Bounded, Topic, make_topic, printable

MAGIC = b"TDSm"
TIMES = {"t", "time", "time [s]", "time_s", "timestamp", "timestamps", "seconds"}  # of columns
STEP, START, BEGUN = "wf_increment", "wf_start_offset", "wf_start_time"  # of a waveform
UNIT = ("unit_string", "NI_UnitDescription")


def read_tdms(data: bytes, library: ModuleType) -> tuple[Iterator[Topic], tuple[str, ...]]:
    """Topics of a TDMS file, one a group and clock, and what has no time."""
    library.log.log_manager.set_level(logging.ERROR)  # what is cut off is told below
    topics: list[Topic] = []
    notes = []
    with library.TdmsFile.open(Bounded(data)) as file:
        if file.file_status.incomplete_final_segment:
            notes.append("the file ends before its last segment does; what could be read is here")
        for group in file.groups():
            channels = [each for each in group.channels() if _numeric(each, len(data))]
            found, without = _group(group.name, channels)
            topics += found
            if without:
                notes.append(f"group {group.name!r}: no time is known of {', '.join(without)}")
    return iter(topics), tuple(notes)


def _numeric(channel: Any, size: int) -> bool:  # noqa: ANN401 - npTDMS has no types
    kind = np.dtype(channel.dtype)
    return kind.kind in "fiubM" and 0 < len(channel) * max(kind.itemsize, 1) <= 2 * size


def _group(name: str, channels: Sequence[Any]) -> tuple[list[Topic], list[str]]:
    """Topics of a group's channels, which may be sampled at several rates; those without time."""
    clocks: dict[tuple[Any, ...], tuple[Array, list[Any]]] = {}
    stamped = {len(each): each for each in channels if each.name.strip().lower() in TIMES}
    begun = [each.properties[BEGUN] for each in channels if BEGUN in each.properties]
    without = []
    for each in channels:
        step = each.properties.get(STEP)
        if isinstance(step, float) and 0 < step < np.inf:
            late = float(each.properties.get(START) or 0.0)
            if BEGUN in each.properties:
                late += float((each.properties[BEGUN] - min(begun)) / np.timedelta64(1, "s"))
            key: tuple[Any, ...] = (len(each), step, late)
            clocks.setdefault(key, (late + step * np.arange(len(each)), []))[1].append(each)
        elif len(each) in stamped:
            if each is not stamped[len(each)]:
                key = (len(each),)
                clocks.setdefault(key, (_seconds(stamped[len(each)]), []))[1].append(each)
        else:
            without.append(each.name)
    topics = []
    for k, (t, members) in enumerate(clocks.values()):
        columns = ((each.name, each[:], _unit(each)) for each in members)
        topic = make_topic(name if k == 0 else f"{name} ({k + 1})", t, columns)
        units = {printable(each.name): printable(_unit(each)) for each in members}
        topics += [replace(topic, units=units)] if topic is not None else []
    return topics, without


def _seconds(channel: Any) -> Array:  # noqa: ANN401
    values = channel[:]
    if values.dtype.kind == "M":
        return np.asarray((values - values.min()) / np.timedelta64(1, "s"), dtype=float)
    return np.asarray(values, dtype=float)


def _unit(channel: Any) -> str:  # noqa: ANN401
    said = [channel.properties[key] for key in UNIT if key in channel.properties]
    return str(said[0]).strip() if said else ""
