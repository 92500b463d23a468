"""Files of other tools, told apart by their suffix: tables of samples, responses, fitted models."""

import importlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import scipy

from casid import files
from casid.arrays import Array
from casid.channels import UNITS, factor_of
from casid.checks import optional
from casid.display import counted, listed
from casid.errors import warn
from casid.exchange.objects import from_dataframe, in_seconds, to_dataframe
from casid.fit import AnyFit
from casid.folder import replacing
from casid.frequency.response import FrequencyResponse
from casid.limits import TABLE_BYTES, check_file, check_size
from casid.matlab import read_variables, write_hdf
from casid.record import Hold, Record
from casid.textfile import write_text

MatVersion: TypeAlias = Literal["5", "7.3"]  # of MATLAB files
TABLES = (".csv", ".mat", ".parquet")
NAMED = ("states", "inputs", "outputs")
VARIABLE = re.compile(r"[A-Za-z]\w{0,62}", flags=re.ASCII)  # what MATLAB takes for a name


def read_record(
    path: str | Path,
    *,
    inputs: files.Channels,
    outputs: files.Channels,
    time: str | float = "t",
    units: Mapping[str, str] | None = None,
    detrend: files.Detrend = None,
    hold: Hold = "foh",
    name: str | None = None,
) -> Record:
    """A record from a CSV, MAT (version 5 to 7.3) or Parquet file.

    Parameters
    ----------
    path, inputs, outputs, time, units, detrend, hold, name
        As in `read_csv` and `read_mat`.
    """
    kinds: Any = {".csv": files.read_csv, ".mat": files.read_mat, ".parquet": read_parquet}
    read: Callable[..., Record] = kinds[_suffix(path, TABLES)]
    table: dict[str, Any] = {"inputs": inputs, "outputs": outputs, "time": time, "units": units}
    return read(path, **table, detrend=detrend, hold=hold, name=name)


def read_parquet(
    path: str | Path,
    *,
    inputs: files.Channels | None = None,
    outputs: files.Channels | None = None,
    time: str | float = "t",
    units: Mapping[str, str] | None = None,
    detrend: files.Detrend = None,
    hold: Hold | None = None,
    name: str | None = None,
) -> Record:
    """A record from a Parquet file; needs pandas and pyarrow.

    Parameters
    ----------
    path : path
        One row a sample.
    inputs, outputs, time, units, detrend, hold, name
        As in `from_dataframe`; the name is the file's stem unless given.

    Raises
    ------
    ValueError
        pandas or pyarrow is missing, no Parquet file, and all that `from_dataframe` refuses.
    """
    path = Path(path)
    table: dict[str, Any] = {"inputs": inputs, "outputs": outputs, "time": time, "units": units}
    return from_dataframe(
        _parquet(path), **table, detrend=detrend, hold=hold, name=name or path.stem
    )


def write_parquet(path: str | Path, record: Record) -> None:
    """Write a record as Parquet, which `read_parquet` reads back as it was; see `to_dataframe`."""
    optional("pyarrow", "Parquet")
    frame = to_dataframe(record)
    with replacing(path) as temporary:
        frame.to_parquet(temporary, engine="pyarrow")


def write_mat(path: str | Path, record: Record, *, version: MatVersion = "5") -> None:
    """Write a record as a MATLAB file: a vector a channel and ``t``, SI units.

    What was subtracted as trim is added back, as `write_csv` does. Version "7.3" needs h5py.
    """
    _save_table(path, {"t": record.t} | record.totals(), version)


def read_table(path: str | Path) -> dict[str, Array]:
    """All columns of a CSV or Parquet file, all vectors of one length of a MATLAB file.

    Dates of a Parquet file count from the first, in seconds.

    Raises
    ------
    ValueError
        Another suffix, columns that hold no numbers, no column at all.
    """
    path = Path(path)
    suffix = _suffix(path, TABLES)
    if suffix == ".csv":
        columns = files.csv_columns(path)
        if hint := files.header_hint(columns):
            raise ValueError(f"{path}: its first line is {', '.join(columns)[:200]}{hint}")
        return files.read_columns(path, columns)
    if suffix == ".parquet":
        frame = _parquet(path)
        frame = frame.reset_index() if frame.index.name else frame
        table = {
            str(name): _numbers(in_seconds(frame[name]), path, str(name)) for name in frame.columns
        }
    else:
        table = _vectors(path)
    files.check_printable(path, table)
    return table


def write_table(path: str | Path, table: Mapping[str, Array], *, version: MatVersion = "5") -> None:
    """Write columns of one length as CSV, MATLAB (of that version) or Parquet, by the suffix.

    Raises
    ------
    ValueError
        Another suffix; a name that MATLAB does not take; pandas, pyarrow or h5py missing.
    """
    path = Path(path)
    suffix = _suffix(path, TABLES)
    if suffix == ".mat":
        _save_table(path, table, version)
    elif suffix == ".parquet":
        optional("pyarrow", "Parquet")
        frame = optional("pandas", "Parquet").DataFrame(dict(table))
        with replacing(path) as temporary:
            frame.to_parquet(temporary, engine="pyarrow", index=False)
    else:
        rows = np.column_stack(list(table.values())).tolist()  # floats write themselves exactly
        lines = [files.csv_header(table), *(",".join(map(repr, row)) for row in rows)]
        write_text(path, "\n".join(lines) + "\n")


def in_si(table: Mapping[str, Array], units: Mapping[str, str]) -> dict[str, Array]:
    """Columns in SI units; ``units`` names those that are not yet.

    A name that ends with the unit that no longer holds, ``time_ms``, or with any in brackets, as
    ``p [deg/s]``, loses it.
    """
    if lacking := [name for name in units if name not in table]:
        raise ValueError(f"there is no column {lacking[0]!r}; there are {', '.join(table)}")
    found = dict[str, Array]()
    for name, x in table.items():
        unit = units.get(name, "1")
        plain = re.sub(r"\s*\[[^]]*\]$", "", name.removesuffix(f"_{unit}")).rstrip() or name
        new = plain if name in units and plain not in {*table, *found} else name
        found[new] = x * factor_of(plain, unit)  # pulses are a control's, lat_us is one
    return found


def frequency_table(response: FrequencyResponse) -> dict[str, Array]:
    """Columns of a frequency response: omega [rad/s], then five a pair.

    ``p_lat_dB``, ``p_lat_deg`` (unwrapped), ``p_lat_coherence``, ``p_lat_error`` and
    ``p_lat_resolution`` [rad/s], within which errors are alike; `pairs_of` names them for
    `read_frequency_csv`. An error of zero, as of a model's response, is an empty cell. Correlations
    of errors between outputs are in JSON alone.
    """
    table = {"omega": response.omega}
    with np.errstate(divide="ignore"):
        gain = 20 * np.log10(np.abs(response.G))
    for (output, name), columns in pairs_of(response).items():
        i, j = response.index(output, name)
        phase = np.angle(response.G[:, i, j])
        known = np.isfinite(phase)
        phase[known] = np.unwrap(phase[known])
        error = np.where(response.error > 0, response.error, np.nan)  # of a model, none
        told = response.coherence, error, response.resolution
        quality = (each[:, i, j] for each in told)
        values = (gain[:, i, j], np.degrees(phase), *quality)
        table |= dict(zip(columns, values, strict=True))
    return table


def pairs_of(response: FrequencyResponse) -> dict[tuple[str, str], tuple[str, ...]]:
    """Columns of `frequency_table` by (output, input), as `read_frequency_csv` wants them.

    Where two pairs would share one, as (p, lat_x) and (p_lat, x), names are joined by more bars.
    """
    kinds = ("dB", "deg", "coherence", "error", "resolution")
    pairs, bar = list(product(response.outputs, response.inputs)), "_"
    while len({bar.join(pair) for pair in pairs}) < len(pairs):
        bar += "_"
    return {pair: tuple(f"{bar.join(pair)}_{kind}" for kind in kinds) for pair in pairs}


def write_frequency(path: str | Path, response: FrequencyResponse) -> None:
    """Write a frequency response as JSON, as a CSV table or as a MATLAB file, by the suffix.

    In MATLAB arrays run (output, input, frequency), so that ``frd(response, omega)`` takes them.
    """
    suffix = _suffix(path, (".json", ".csv", ".mat"))
    if response.flags and suffix != ".json":
        count = len(set().union(*response.flags.values()))
        warn(
            f"{path}: {counted(count, 'frequency', 'frequencies')} to distrust, "
            f"{listed(tuple(response.flags), 3)}; that is not in such a file: write JSON, or leave "
            "them out (`FrequencyResponse.take`)"
        )
    if suffix == ".json":
        response.save(path)
    elif suffix == ".csv":
        write_table(path, frequency_table(response))
    else:
        content: dict[str, Any] = {
            name: getattr(response, name) for name in ("omega", "inputs", "outputs")
        }
        for name, field in (("response", "G"), ("coherence",) * 2, ("random_error", "error")):
            content[name] = np.moveaxis(getattr(response, field), 0, 2)
        _save_mat(path, content)


def write_fit_mat(path: str | Path, fit: AnyFit) -> None:
    """Write a fitted model as a MATLAB file of version 5.

    ``ss(A, B, C, D, 'InputDelay', delay, 'StateName', states, ...)`` makes it a model there;
    parameters are columns of one row each.
    """
    system = fit.model.system()
    rows, own = fit.parameters, {**UNITS, **getattr(fit.model, "units", {}), **fit.units}
    numbers = ("value", "std_error", "cramer_rao", "lower", "upper")
    content: dict[str, Any] = {
        "output_units": tuple(own.get(name, "") for name in system.outputs),
        "input_units": tuple(own.get(name, "") for name in system.inputs),
        "parameters": tuple(row.name for row in rows),
        "units": tuple(row.unit for row in rows),
        "free": fit.free_names,
        "covariance": np.zeros((0, 0)) if fit.covariance is None else fit.covariance,
        "structure": type(fit.model).__name__,
    }
    content |= {name: getattr(system, name) for name in (*"ABCD", "delay", *NAMED)}
    content |= {name: getattr(fit, name) for name in ("method", "cost")}
    content |= {name: np.array([getattr(row, name) for row in rows], float) for name in numbers}
    _save_mat(path, content)


def _suffix(path: str | Path, known: Sequence[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in known:
        raise ValueError(f"{path}: unknown suffix {suffix!r}; known are {', '.join(known)}")
    return suffix


def _parquet(path: Path) -> Any:  # noqa: ANN401 - a DataFrame
    check_file(path, TABLE_BYTES, "Parquet")
    optional("pyarrow", "Parquet")
    parquet = importlib.import_module("pyarrow.parquet")
    pandas = optional("pandas", "Parquet")
    try:
        size = parquet.read_metadata(path)
        check_size(path, 8.0 * size.num_rows * size.num_columns, TABLE_BYTES, "Parquet")
        return pandas.read_parquet(path, engine="pyarrow")
    except Exception as error:  # damaged bytes raise anything in Arrow
        raise ValueError(f"{path}: cannot read it as Parquet ({error}); write it again") from error


def _numbers(column: Any, path: Path, name: str) -> Array:  # noqa: ANN401
    try:
        return np.asarray(column.to_numpy(dtype=float, na_value=np.nan))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: column {name!r} holds no numbers: {error}") from error


def _vectors(path: Path) -> dict[str, Array]:
    found = {}
    for name, value in read_variables(path).items():
        array = np.asarray(value)
        if array.dtype.kind in "fiub" and array.ndim <= 2 and max(array.shape, default=0) > 1:
            if array.size == max(array.shape):
                found[name] = np.asarray(array.ravel(), dtype=float)
            else:
                columns = np.asarray(array.T, dtype=float)
                found |= {f"{name}_{k}": column for k, column in enumerate(columns, 1)}
    if not found or len({len(column) for column in found.values()}) > 1:
        told = ", ".join(f"{name} {len(column)}" for name, column in found.items()) or "none"
        raise ValueError(f"{path}: expected vectors of one length; there are: {told}")
    return found


def _save_table(path: str | Path, table: Mapping[str, Array], version: MatVersion) -> None:
    if version not in get_args(MatVersion):
        raise ValueError(f"version={version!r}: expected one of {', '.join(get_args(MatVersion))}")
    if version == "5":
        _save_mat(path, table)
    else:
        _check_names(path, table)
        write_hdf(Path(path), {name: column[:, None] for name, column in table.items()})


def _check_names(path: str | Path, names: Iterable[str]) -> None:
    if bad := [name for name in names if not VARIABLE.fullmatch(name)]:
        raise ValueError(
            f"{path}: MATLAB takes no variable {bad[0]!r}; rename the channel (letters, digits and "
            "_, a letter first, 63 at most)"
        )


def _save_mat(path: str | Path, content: Mapping[str, Any]) -> None:
    _check_names(path, content)
    cells = {
        name: np.array(value, dtype=object)[:, None] if isinstance(value, tuple) else value
        for name, value in content.items()
    }
    with replacing(path) as temporary:
        scipy.io.savemat(
            str(temporary), cells, appendmat=False, oned_as="column", long_field_names=True
        )
