"""ArduPilot's dataflash logs, as written and as text; formats of messages as pymavlink has them.

Every message is A3 95, a type and a body of fixed length; messages of type 128 say the length,
field types and names of the others, FMTU, UNIT and MULT units and multipliers. The index is
casid's own: that of pymavlink ends the process on a damaged log.

As text every message is a line, ``ATT, 81000412, 1.25, -0.4``, and types of fields have been scaled
as their letters say; a log begins with lines FMT, whose last field has commas of its own.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.channels import in_si, spelt
from casid.display import counted
from casid.logs.topics import Topic, make_topic

MAGIC = b"\xa3\x95\x80"
TEXT_MAGIC = b"FMT,"
HEAD, FORMAT = MAGIC[:2], MAGIC[2]
CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}  # s
INSTANCE = ord("#")  # unit of the field that numbers several sensors of a kind
# Of messages in logs without FMTU: https://ardupilot.org/copter/docs/logmessages.html
_ANGLES = dict.fromkeys(("Roll", "Pitch", "Yaw"), "deg")
_IMU = dict.fromkeys(("GyrX", "GyrY", "GyrZ"), "rad/s")
_IMU |= dict.fromkeys(("AccX", "AccY", "AccZ"), "m/s/s")
DOCUMENTED: Mapping[str, Mapping[str, str]] = {
    "ATT": _ANGLES | dict.fromkeys(("DesRoll", "DesPitch", "DesYaw"), "deg"),
    "IMU": _IMU | {"I": "#"},
    "IMU2": _IMU,
    "NKF1": _ANGLES | dict.fromkeys(("VN", "VE", "VD"), "m/s"),
    "RATE": dict.fromkeys(("R", "P", "Y", "RDes", "PDes", "YDes"), "deg/s"),
    "XKF1": _ANGLES | dict.fromkeys(("VN", "VE", "VD"), "m/s") | {"C": "#"},
}


@dataclass(frozen=True, kw_only=True)
class Format:
    """How the messages of one type are laid out: struct code, factor, unit of every field."""

    name: str
    codes: tuple[str, ...]
    fields: tuple[str, ...]
    factors: tuple[float | None, ...]  # that of the type of field, or the log's; None where neither
    units: tuple[str, ...]
    stated: bool = False  # whether units are the log's own

    @property
    def size(self) -> int:
        """Length of a message [bytes]."""
        return 3 + struct.calcsize("<" + "".join(self.codes))

    @property
    def layout(self) -> np.dtype[Any]:
        """Of a message's body."""
        kinds = ("S" + code[:-1] if code.endswith("s") else "<" + code for code in self.codes)
        return np.dtype([(f"f{k}", kind) for k, kind in enumerate(kinds)])


def read_dataflash(data: bytes, library: ModuleType) -> tuple[Iterator[Topic], tuple[str, ...]]:
    """Topics of an ArduPilot log, and what is wrong with it."""
    formats, places, skipped = _index(data, library.FORMAT_TO_STRUCT)
    tables = {
        kind: np.frombuffer(
            b"".join(data[k + 3 : k + each.size] for k in places[kind]), dtype=each.layout
        )
        for kind, each in formats.items()
        if places.get(kind)
    }
    notes = (f"{skipped} bytes between messages are damaged and left out",) if skipped else ()
    return _read(formats, tables, notes)


def read_text(data: bytes, library: ModuleType) -> tuple[Iterator[Topic], tuple[str, ...]]:
    """The same of a log that was converted to text."""
    formats: dict[str, Format] = {}
    kinds: dict[str, int] = {}
    lines: dict[str, list[list[str]]] = {}
    skipped = 0
    whole = data[: data.rfind(b"\n") + 1]  # the end of a line that was cut off may be half a number
    for line in filter(None, map(str.strip, whole.decode("utf-8", "replace").splitlines())):
        name, *values = (each.strip() for each in line.split(","))
        if name == "FMT" and len(values) > 4 and values[0].isdecimal():
            words = [*values[2:4], ",".join(values[4:])]
            if (found := _format(words, library.FORMAT_TO_STRUCT)) and found.name not in formats:
                formats[found.name] = replace(found, factors=(1.0,) * len(found.fields))
                kinds[found.name], lines[found.name] = int(values[0]), []
        elif name in formats and len(values) >= len(formats[name].fields):
            lines[name].append(values)  # a last field of text may have commas of its own
        else:
            skipped += 1
    tables = {kinds[name]: _table(formats[name], rows) for name, rows in lines.items() if rows}
    notes = (f"{counted(skipped, 'line')} damaged and left out",) if skipped else ()
    return _read({kinds[name]: each for name, each in formats.items()}, tables, notes)


def _read(
    formats: Mapping[int, Format], tables: Mapping[int, Any], notes: tuple[str, ...]
) -> tuple[Iterator[Topic], tuple[str, ...]]:
    """Topics of the messages of every type; ``notes`` and what is said of their units."""
    known = _with_units(formats, tables)
    used = (known[kind] for kind in tables)
    if taken := sorted(each.name for each in used if each.name in DOCUMENTED and not each.stated):
        names = ", ".join(taken)
        notes += (f"the log has no units of {names}: taken as ArduPilot's documentation has them",)
    return (topic for kind, rows in tables.items() for topic in _topics(known[kind], rows)), notes


def _table(form: Format, lines: Sequence[Sequence[str]]) -> Any:  # noqa: ANN401 - structured
    """Messages of one type as a structured array: numbers, NaN where none, or bytes."""
    columns = list(zip(*lines, strict=False))[: len(form.fields)]
    kinds = ["S64" if code.endswith("s") else "<f8" for code in form.codes]
    table = np.empty(len(lines), dtype=[(f"f{k}", kind) for k, kind in enumerate(kinds)])
    for k, (kind, column) in enumerate(zip(kinds, columns, strict=True)):
        numeric = kind != "S64"
        table[f"f{k}"] = [_number(x) if numeric else x.encode() for x in column]
    return table


def _number(text: str) -> float:
    """A field of a text log, units' letters included; NaN for what is no number."""
    try:
        return float(text)
    except ValueError:
        return float(ord(text)) if len(text) == 1 else np.nan


def _index(
    data: bytes, types: Mapping[str, Any]
) -> tuple[dict[int, Format], dict[int, list[int]], int]:
    """Formats and places of messages by type, and how many bytes belong to none."""
    formats: dict[int, Format] = {}
    places: dict[int, list[int]] = {}
    sizes = {FORMAT: 89}
    at = skipped = 0
    while 0 <= at < len(data) - 3:
        kind = data[at + 2]
        size = sizes.get(kind, 0)
        if data[at : at + 2] != HEAD or not size or at + size > len(data):
            after = data.find(HEAD, at + 1)
            after = len(data) if after < 0 else after
            at, skipped = after, skipped + after - at
            continue
        if kind == FORMAT:
            number, length, *rest = struct.unpack("<BB4s16s64s", data[at + 3 : at + size])
            found = _format(list(map(_text, rest)), types)
            if found is not None and found.size == length and number != FORMAT:
                formats[number], sizes[number] = found, length
                places[number] = []
        else:
            places[kind].append(at)
        at += size
    return formats, places, skipped


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("utf-8", "replace").strip()


def _format(words: Sequence[str], types: Mapping[str, Any]) -> Format | None:
    name, letters, fields = words
    names = tuple(fields.split(",")) if fields else ()
    if not name or len(names) != len(letters) or any(letter not in types for letter in letters):
        return None
    codes, factors, _ = zip(*(types[letter] for letter in letters), strict=True)
    return Format(
        name=name,
        codes=codes,
        fields=names,
        factors=factors,
        units=tuple(DOCUMENTED.get(name, {}).get(each, "") for each in names),
    )


def _with_units(formats: Mapping[int, Format], tables: Mapping[int, Any]) -> dict[int, Format]:
    """Formats with the units and multipliers that the log itself gives."""
    named = {each.name: tables[kind] for kind, each in formats.items() if kind in tables}
    units = {row[1]: _text(row[2]) for row in named.get("UNIT", ())}
    factors = {row[1]: float(row[2]) for row in named.get("MULT", ())}
    found = dict(formats)
    for _, kind, unit_marks, factor_marks in named.get("FMTU", ()):
        if kind not in formats:
            continue
        each, blank = formats[kind], [ord("-")] * len(formats[kind].fields)
        names = ["#" if mark == INSTANCE else units.get(mark, "") for mark in [*unit_marks, *blank]]
        scales = [factors.get(mark, 0.0) or 1.0 for mark in [*factor_marks, *blank]]
        found[int(kind)] = replace(
            each,
            units=tuple(names[: len(blank)]),
            stated=True,
            factors=tuple(x or y for x, y in zip(each.factors, scales, strict=False)),
        )
    return found


def _topics(form: Format, rows: Any) -> Iterator[Topic]:  # noqa: ANN401 - a structured array
    """The topics of one type of message: one an instance, none of messages without a time."""
    clock = next((k for k, name in enumerate(form.fields) if name in CLOCKS), None)
    if clock is None:
        return
    number = form.units.index("#") if "#" in form.units else None
    which: Array = np.zeros(len(rows)) if number is None else rows[f"f{number}"]
    # What nobody states is told, what a user states is read for what stood there.
    stated = {
        name: spelt(unit)
        for name, unit in zip(form.fields, form.units, strict=True)
        if in_si(unit) is not None or not (form.stated or form.name in DOCUMENTED)
    }
    for value in np.unique(which) if which.dtype.kind in "iuf" else ():
        own = rows[which == value]
        columns = (
            (name, own[f"f{k}"] * (form.factors[k] or 1.0), stated.get(name, ""))
            for k, name in enumerate(form.fields)
            if k not in (clock, number) and own[f"f{k}"].dtype.kind in "iuf"
        )
        name = form.name if number is None else f"{form.name}[{value:g}]"
        stamps = own[f"f{clock}"] * CLOCKS[form.fields[clock]]
        if (topic := make_topic(name, stamps, columns)) is not None:
            yield replace(topic, units=stated)
