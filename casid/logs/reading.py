"""A log of any format, told by its first bytes."""

import contextlib
import io
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TypeAlias

import numpy as np

from casid.checks import optional
from casid.display import counted, instant, listed
from casid.limits import MIB, check_file
from casid.logs import dataflash, tdms, ulog
from casid.logs.topics import Log, Topic, printable

BYTES = 1024 * MIB
Reader: TypeAlias = Callable[[bytes, ModuleType], tuple[Iterator[Topic], tuple[str, ...]]]
READERS: dict[bytes, tuple[str, str, Reader]] = {  # by the first bytes: format, package, reader
    ulog.MAGIC: ("PX4 ULog", "pyulog", ulog.read_ulog),
    dataflash.MAGIC: ("ArduPilot dataflash", "pymavlink.DFReader", dataflash.read_dataflash),
    dataflash.TEXT_MAGIC: ("ArduPilot dataflash", "pymavlink.DFReader", dataflash.read_text),
    tdms.MAGIC: ("TDMS", "nptdms", tdms.read_tdms),
}
LEFT_OUT = {  # why samples of a topic are
    "left_out": (
        "clock went back",
        "if there are many, the logger began anew, and its longest part is kept; split the log "
        "there to read the others",
    ),
    "repeats": (
        "time stamps repeat those of others",
        "one sample of each instant is kept; if there are many, stamps are too coarse or two "
        "sensors write one topic",
    ),
}


def read_log(path: str | Path) -> Log:
    """What is in a log: PX4 ULog, ArduPilot dataflash (.bin, .log) or TDMS.

    Needs ``pip install 'casid[logs]'``.

    Parameters
    ----------
    path : path
        The file; its first bytes say what it is.

    Raises
    ------
    ValueError
        None of the three, damaged beyond reading, no topic in it, a package missing.
    """
    path = Path(path)
    check_file(path, BYTES, "a log")
    data = path.read_bytes()
    found = next((READERS[magic] for magic in READERS if data.startswith(magic)), None)
    if found is None:
        raise ValueError(
            f"{path}: it is no log of PX4 (ULog), ArduPilot (dataflash .bin, .log) or LabVIEW "
            f"(TDMS): it begins with {data[:8]!r}; other tables are read as .csv, .mat or .parquet"
        )
    kind, package, read = found
    library = optional(package, f"{path}: a {kind} log", extra="logs")
    topics, notes = _topics(path, kind, partial(read, data, library))
    if not topics:
        why = "; ".join(notes) or f"is the {kind} log cut off?"
        raise ValueError(f"{path}: no topic with samples could be read; {why}")
    notes += _went_back([each for each in topics.values() if each.went_back])
    for what, remedy in LEFT_OUT.items():
        # What has one stamp in all is no signal: a table that the log describes itself with.
        gone = {name: getattr(each, what) for name, each in topics.items() if len(each.t) > 1}
        if (count := sum(gone.values())) > 0:
            most = max(gone, key=lambda name: gone[name])
            whole = len(topics[most].t) + topics[most].left_out + topics[most].repeats
            notes += (
                f"{counted(count, 'sample')} left out whose {remedy[0]}, most of {most} "
                f"({gone[most]} of {whole}): {remedy[1]}",
            )
    return Log(path=path, kind=kind, topics=topics, notes=notes)


def _went_back(topics: Sequence[Topic]) -> tuple[str, ...]:
    """Where the clocks of topics went back for good, and which of their parts is kept."""
    if not topics:
        return ()
    topic = max(topics, key=lambda each: each.left_out)
    at, lag = topic.went_back[0]
    more = f" and at {counted(len(topic.went_back) - 1, 'place')} more"
    others = f"; so did those of {listed([each.name for each in topics if each is not topic])}"
    return (
        f"the clock of {topic.name} went back by {lag:.3g} s at {instant(at)} s"
        f"{more * (len(topic.went_back) > 1)}: what follows is displaced against other topics by "
        f"so much; kept is {instant(float(topic.t[0]))} to {instant(float(topic.t[-1]))} s"
        f"{others * (len(topics) > 1)}",
    )


def _topics(
    path: Path, kind: str, read: Callable[[], tuple[Iterator[Topic], tuple[str, ...]]]
) -> tuple[dict[str, Topic], tuple[str, ...]]:
    try:
        # Readers print of damage, and damaged numbers overflow.
        with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            found, notes = read()
            return {topic.name: topic for topic in found}, notes
    except Exception as error:
        said = printable(f"{type(error).__name__}: {error}")
        raise ValueError(
            f"{path}: cannot read it as a {kind} log ({said[:200]}); copy it anew"
        ) from error
