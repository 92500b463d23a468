"""Records from CSV and MATLAB files, units converted, and as CSV."""

import csv
import io
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from casid.arrays import Array
from casid.channels import factor_of, misnamed, own_units
from casid.errors import warn
from casid.limits import TABLE_BYTES, check_file
from casid.matlab import read_variables
from casid.record import Hold, Record
from casid.textfile import write_text

SHOWN = 40  # names of columns that a message lists
CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]")
DIGITS, EXACT = 10, 17  # of a value in a CSV file; those that are enough for every double
COMMENT = "#"
CLOCK = 1e-5  # of the sampling interval: what an instant in a CSV file may be off
HEADER_CHARACTERS = 2**17  # a longer first line is no header

OTHER = "time = NAME, or columns = {channel: NAME}"  # than those of the same names
LARGEST, SMALLEST = 1e20, 1e-30  # magnitudes of a channel that still measure something

Detrend: TypeAlias = Literal["first", "mean"] | Mapping[str, float] | None
Place: TypeAlias = str | tuple[str, int]  # a column or variable; a column of a MATLAB array
Column: TypeAlias = Place | Mapping[str, float]  # or a sum of columns, each times its factor
Channels: TypeAlias = Sequence[str] | Mapping[str, Column]


def read_csv(
    path: str | Path,
    *,
    inputs: Channels,
    outputs: Channels,
    time: str | float = "t",
    units: Mapping[str, str] | None = None,
    detrend: Detrend = None,
    hold: Hold = "foh",
    name: str | None = None,
) -> Record:
    """A record from a CSV file with a header line.

    Parameters
    ----------
    path : path
        Comma-separated values; an empty cell or ``nan`` is a missing sample.
    inputs, outputs : sequence of str, or mapping
        The columns to take, in that order; others are left unread. A logger to be joined with
        another may have no inputs. A mapping gives a channel another name than its column,
        ``{"lat": "LAT_STICK"}``, or makes it a sum of columns, each times its factor,
        ``{"roll": {"m1": -0.5, "m2": 0.5}}``.
    time : str or float
        The column of instants, or the sampling interval [s] where there is none.
    units : mapping
        Unit of each channel that is not in SI already, ``{"p": "deg/s"}``; see
        `casid.channels.MEASURES`. A stick in ``"%"`` becomes a fraction of its full travel.
    detrend : {"first", "mean"}, mapping or None
        See `Record.detrend`.
    hold : {"foh", "zoh"}
        What the inputs do between samples, those of a slower input too, which are filled in.
    name : str
        Name of the record; the file's stem unless given.

    Raises
    ------
    ValueError
        Not a table of numbers, rows of another length than the header, an unknown column or unit,
        and all that `Record` refuses.
    """
    path = Path(path)
    name = name or path.stem
    each = places(inputs, outputs, time, name).values()
    wanted = dict.fromkeys(str(place) for column in each for place in _summed(column))
    table = read_columns(path, list(wanted))
    at: Callable[[Place], Array] = lambda place: table[str(place)]  # noqa: E731
    return build(at, inputs, outputs, time, units, name, hold).detrend(detrend)


def read_columns(path: str | Path, names: Sequence[str], other: str = OTHER) -> dict[str, Array]:
    """Named columns of a table of numbers with a header, CSV; ValueError for anything else.

    ``other`` says how whoever reads may name other columns.
    """
    columns = csv_columns(path := Path(path))
    values = _csv_values(path, columns, [_find(name, columns, path, other) for name in names])
    if not len(values):
        raise ValueError(f"{path}: no samples below the header; record it again")
    return dict(zip(names, values.T, strict=True))


def read_mat(
    path: str | Path,
    *,
    inputs: Channels,
    outputs: Channels,
    time: str | float = "t",
    units: Mapping[str, str] | None = None,
    detrend: Detrend = None,
    hold: Hold = "foh",
    name: str | None = None,
) -> Record:
    """A record from a MATLAB file; version 7.3 needs h5py.

    Parameters
    ----------
    inputs, outputs : sequence of str, or mapping
        A channel is a vector of its own name, of another, ``{"lat": "stick"}``, or a column of an
        array, ``{"lat": ("inr", 0)}``, counted from 0.
    path, time, units, detrend, hold, name
        As in `read_csv`.
    """
    path = Path(path)
    variables = read_variables(path)
    read = partial(_mat_column, variables, path)
    return build(read, inputs, outputs, time, units, name or path.stem, hold).detrend(detrend)


def places(inputs: Channels, outputs: Channels, time: str | float, name: str) -> dict[str, Column]:
    """Where each channel stands in a file, by name, and the time if it is a column, never both."""
    if not outputs:
        raise ValueError(f"record {name!r}: name at least one input and one output to read")
    found: dict[str, Column] = {}
    for given in (inputs, outputs):
        found |= dict(given) if isinstance(given, Mapping) else {name: name for name in given}
    if isinstance(time, str):
        if time in found:
            raise ValueError(
                f"record {name!r}: channel {time!r} is the time and cannot be an input or output "
                "too; name another column as time"
            )
        return {time: time} | found
    if not 0 < time < np.inf:
        raise ValueError(
            f"record {name!r}: time={time}: expected a column, or the sampling interval [s]"
        )
    return found


def _summed(column: Column) -> Mapping[Place, float]:
    """What a channel is the sum of, with factors."""
    if not isinstance(column, Mapping):
        return {column: 1.0}
    if not column:
        raise ValueError("a channel is the sum of no columns; name at least one with its factor")
    return {place: float(factor) for place, factor in column.items()}


def build(
    read: Callable[[Place], Array],
    inputs: Channels,
    outputs: Channels,
    time: str | float,
    units: Mapping[str, str] | None,
    name: str,
    hold: Hold = "foh",
) -> Record:
    """A record in SI units of what ``read`` returns; ValueError for wrong units or values."""
    table: dict[str, Array] = {}
    for channel, column in places(inputs, outputs, time, name).items():
        parts = [factor * read(place) for place, factor in _summed(column).items()]
        table[channel] = np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
    for channel, unit in (units or {}).items():
        if channel not in table:
            raise ValueError(
                f"units name channel {channel!r}, which is not read; read are {', '.join(table)}"
            )
        table[channel] = table[channel] * factor_of(channel, unit, time=channel == time)
        if channel != time and (odd := misnamed(channel, unit)):
            warn(f"record {name!r}: {odd}: check the units, or give the channel another name")
    if len({len(column) for column in table.values()}) > 1:
        lengths = ", ".join(f"{each} {len(column)}" for each, column in table.items())
        raise ValueError(
            f"record {name!r}: channels differ in length ({lengths}); those of one record have one "
            "length"
        )
    for channel, values in table.items():
        _check_magnitude(name, channel, values)
    y = np.column_stack([table[each] for each in outputs])
    u = np.column_stack([table[each] for each in inputs]) if inputs else np.zeros((len(y), 0))
    t = table[time] if isinstance(time, str) else time * np.arange(len(y))
    own = own_units(units or {}, (*inputs, *outputs))
    return Record(t, u, y, tuple(inputs), tuple(outputs), name, hold, units=own)


def write_csv(path: str | Path, record: Record) -> None:
    """Write a record as CSV, SI units; what was subtracted as trim is added back."""
    table = {"t": record.t} | record.totals()
    lines = [csv_header(table)]
    rows, digits = np.column_stack(list(table.values())), _digits_of_time(record.t)
    for t, *row in rows:
        lines.append(",".join([f"{t:.{digits}g}", *(f"{value:.{DIGITS}g}" for value in row)]))
    write_text(path, "\n".join(lines) + "\n")


def _digits_of_time(t: Array) -> int:
    """Digits that tell instants (N,) apart to a `CLOCK` of their interval, also long after zero."""
    least = CLOCK * float(np.diff(t).min())
    return int(np.clip(np.ceil(np.log10(np.abs(t).max() / least)) + 1, DIGITS, EXACT))


def csv_header(names: Iterable[str]) -> str:
    """The first line of a CSV file of columns; ValueError for a name that is not read back."""
    for name in names:
        if name != name.strip() or not name:
            raise ValueError(
                f"channel {name!r} begins or ends with a blank, which CSV does not keep; rename it"
            )
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(names)
    return line.getvalue()


def _check_magnitude(record: str, channel: str, values: Array) -> None:
    sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
    if (largest := np.max(sizes, initial=0.0)) > LARGEST:
        raise ValueError(
            f"record {record!r}: channel {channel!r} reaches {largest:g} at sample "
            f"{int(sizes.argmax())}, which no instrument measures; mark missing samples with an "
            "empty cell or nan"
        )
    if 0 < largest < SMALLEST:
        raise ValueError(
            f"record {record!r}: channel {channel!r} never exceeds {largest:g}: it carries no "
            "signal; write zeros or leave the channel out"
        )


def csv_columns(path: Path) -> list[str]:
    """Names in the header line of a CSV file."""
    check_file(path, TABLE_BYTES, "CSV")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            line = file.readline(HEADER_CHARACTERS + 1)
        if len(line) > HEADER_CHARACTERS:
            raise csv.Error(f"its first line is longer than {HEADER_CHARACTERS} characters")  # noqa: TRY301
        header = next(csv.reader([line]), None)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(
            f"{path}: cannot read it as CSV ({error}); save it as comma-separated text in UTF-8"
        ) from error
    columns = [column.strip() for column in header or []]
    if not any(columns):
        raise ValueError(f"{path}: the file is empty; expected a header line with channel names")
    if "\0" in "".join(columns):
        raise ValueError(f"{path}: it is no text; save it as comma-separated text in UTF-8")
    check_printable(path, columns)
    return columns


def check_printable(path: Path, names: Iterable[str]) -> None:
    """Refuse names that would do something to a terminal; a tab is a matter of separators."""
    if wrong := [name for name in names if CONTROL.search(name)]:
        raise ValueError(f"{path}: the column's name {wrong[0]!r} does not print; rename it")


def _csv_values(path: Path, columns: list[str], positions: list[int]) -> Array:
    line = 0

    def rows(file: Iterable[str]) -> Iterator[str]:  # each of as many cells as the header
        nonlocal line
        for line, text in enumerate(file, 1):
            if line > 1 and text.strip():
                _check_row(text, len(columns))
                yield text

    def read(converter: Any) -> Array:  # noqa: ANN401 - NumPy's own type
        with warnings.catch_warnings(), path.open(encoding="utf-8-sig") as file:
            warnings.simplefilter("ignore", UserWarning)  # an empty table is refused below
            layout: Any = {"delimiter": ",", "usecols": positions, "ndmin": 2, "comments": None}
            return np.loadtxt(rows(file), converters=converter, **layout)

    try:
        try:
            return read(None)
        except ValueError:  # slower, but knows empty cells
            return read(lambda cell: float(cell) if cell.strip() else np.nan)
    except (ValueError, IndexError, OverflowError) as error:
        raise ValueError(
            f"{path}: not a table of numbers: line {line}: {str(error).partition(' at row')[0]}; "
            "write numbers with a decimal point below one line of names, and leave the cell of a "
            "missing sample empty"
        ) from error


def _check_row(text: str, wanted: int) -> None:
    """Refuse a line that is no row of as many cells as the header has."""
    if text.lstrip().startswith(COMMENT):
        raise ValueError(f"it begins with {COMMENT!r}, a comment: leave such lines out")
    if (cells := text.count(",") + 1) != wanted:
        raise ValueError(f"{cells} cells, the header has {wanted}")


def _find(name: str, columns: list[str], path: Path, other: str) -> int:
    if name not in columns:
        shown = ", ".join(columns[:SHOWN]) + ", ..." * (len(columns) > SHOWN)
        hint = header_hint(columns) or f"; say so with {other}"
        if columns[0].startswith(COMMENT):
            hint = f". Its first line begins with {COMMENT!r}: names stand there, without that mark"
        raise ValueError(f"{path}: no column {name!r}; it has {shown[:2000]}{hint}")
    if columns.count(name) > 1:
        raise ValueError(
            f"{path}: column {name!r} stands there {columns.count(name)} times; rename one"
        )
    return columns.index(name)


def header_hint(columns: list[str]) -> str:
    """What is wrong with a header line and how to mend it; empty if nothing is."""
    if len(columns) == 1 and (other := [mark for mark in ";\t|" if mark in columns[0]]):
        marked = f". Its cells are separated by {other[0]!r}"
        return f"{marked}; separate them by commas, and write decimals with a point"
    if all(_is_number(column) for column in columns):
        return ". It begins with numbers; write the channel names in its first line"
    return ""


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _mat_column(variables: Mapping[str, Any], path: Path, place: Place) -> Array:
    variable, column = (place, None) if isinstance(place, str) else place
    if variable not in variables:
        known = ", ".join(key for key in variables if not key.startswith("__"))
        raise ValueError(f"{path}: no variable {variable!r}; it has {known}")
    array = np.asarray(variables[variable])
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{path}: variable {variable!r} holds no real array, expected numbers")
    if column is None:
        if array.ndim > 2 or max(array.shape, default=0) != array.size:
            raise ValueError(
                f"{path}: {variable!r} has shape {array.shape}, expected a vector; name its "
                f'columns: {{"channel": ({variable!r}, 0), ...}}'
            )
        return np.asarray(array.ravel(), dtype=float)
    if array.ndim != 2 or not 0 <= column < array.shape[1]:
        raise ValueError(f"{path}: {variable!r} has shape {array.shape}, no column {column}")
    return np.asarray(array[:, column], dtype=float)
