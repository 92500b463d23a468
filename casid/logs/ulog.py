"""PX4 logs, read by pyulog.

Format: https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

import re
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import numpy as np

from casid.display import counted
from casid.logs.topics import Bounded, DamagedLogError, Topic, make_topic

MAGIC = b"ULog\x01\x12\x35"
FIELDS = 500_000  # that all subscriptions of a log may declare together
MICROSECOND = 1e-6


def read_ulog(data: bytes, library: ModuleType) -> tuple[Iterator[Topic], tuple[str, ...]]:
    """Topics of a PX4 log, and what is wrong with it; any error for one that is damaged."""
    _check_declared(library.ULog(Bounded(data), parse_header_only=True).message_formats, data)
    log = library.ULog(Bounded(data))
    notes = []
    if lost := [each.duration for each in log.dropouts]:
        notes.append(
            f"the logger dropped out {counted(len(lost), 'time')}, {sum(lost)} ms in all, "
            f"{max(lost)} ms the longest"
        )
    if log.file_corruption:
        notes.append("the file is damaged; what could be read is here")
    return (each for each in map(_topic, log.data_list) if each is not None), tuple(notes)


def _topic(held: Any) -> Topic | None:  # noqa: ANN401 - pyulog has no types
    many = held.multi_id > 0
    stamps = held.data.get("timestamp")
    if stamps is None:
        return None
    taken = held.data.get("timestamp_sample")
    age = 0.0 if taken is None else float(np.median(stamps - taken.astype(float)))
    return make_topic(
        f"{held.name}[{held.multi_id}]" if many else held.name,
        stamps * MICROSECOND,
        ((name, x, "") for name, x in held.data.items() if not name.startswith("timestamp")),
        age * MICROSECOND if 0 < age < 1e6 else 0.0,
    )


def _check_declared(formats: Mapping[str, Any], data: bytes) -> None:
    """Refuse formats that contain themselves, or that ask for more fields than any log has."""
    size: dict[str, int] = {}

    def fields(name: str, above: tuple[str, ...]) -> int:
        if name not in formats:
            return 1
        if name in above:
            raise DamagedLogError(f"its format {name!r} contains itself")
        if name not in size:
            inner = (
                max(n, 1) * fields(kind, (*above, name)) for kind, n, _ in formats[name].fields
            )
            size[name] = sum(inner)
        return size[name]

    declared = sum(
        fields(name, ()) * len(re.findall(re.escape(name.encode()), data)) for name in formats
    )
    if declared > FIELDS:
        raise DamagedLogError(f"its formats declare {declared} fields")
