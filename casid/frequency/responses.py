"""Frequency responses of other tools: read from CSV, and put together pair by pair."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.checks import check_known
from casid.files import LARGEST, read_columns
from casid.frequency.response import FrequencyResponse
from casid.records import several

Form = Literal["dB deg", "dB rad", "abs deg", "abs rad", "re im"]

Pair = tuple[str, str]

OTHER = "omega = NAME, or the columns of pairs"  # than those that a file lacks


def read_frequency_csv(
    path: str | Path,
    *,
    pairs: Mapping[Pair, Sequence[str]],
    omega: str = "omega",
    form: Form = "dB deg",
    hertz: bool = False,
    input_std: Mapping[str, float] | None = None,
    output_std: Mapping[str, float] | None = None,
) -> FrequencyResponse:
    """A frequency response from a CSV file with a header line.

    Parameters
    ----------
    path : path
        Comma-separated values; an empty cell or ``nan`` is a point that was not measured.
    pairs : mapping
        ``{(output, input): (gain, phase, coherence, random error, resolution)}``: the columns of
        every pair in the file, the last ones of which may be missing. Coherence is then taken as 1,
        the random error as unknown (NaN), the errors of all frequencies as independent. Pairs not
        named are NaN.
    omega : str
        The column of frequencies, in rad/s.
    form : {"dB deg", "dB rad", "abs deg", "abs rad", "re im"}
        What the first two columns of a pair hold.
    hertz : bool
        Whether the frequencies are in Hz instead.
    input_std, output_std : mapping
        Typical sizes of channels, which weigh them in a match; 1 unless given.

    Raises
    ------
    ValueError
        An unknown column or form, coherence outside [0, 1], a random error of 0, frequencies that
        do not increase.
    """
    if form not in get_args(Form):
        raise ValueError(f"form={form!r}: expected one of {', '.join(get_args(Form))}")
    if not pairs:
        raise ValueError('pairs is empty; name at least one: {("p", "lat"): ("gain", "phase")}')
    outputs = tuple(dict.fromkeys(output for output, _ in pairs))
    inputs = tuple(dict.fromkeys(name for _, name in pairs))
    check_known("input_std: no pair has", input_std or (), inputs)
    check_known("output_std: no pair has", output_std or (), outputs)
    wanted = [omega, *(column for columns in pairs.values() for column in columns)]
    table = read_columns(path, list(dict.fromkeys(wanted)), OTHER)
    shape = (len(table[omega]), len(outputs), len(inputs))
    G = np.full(shape, np.nan, dtype=complex)
    coherence, error, width = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape)
    for (output, name), columns in pairs.items():
        _check_columns((output, name), columns, form)
        at = (slice(None), outputs.index(output), inputs.index(name))
        values = [table[column] for column in columns]
        G[at] = _complex(values[0], values[1], form)
        _check_gains(G[at], f"{path}: {columns[0]}", values[0])
        coherence[at] = _coherence(values[2], f"{path}: {columns[2]}") if values[2:] else 1.0
        error[at] = _error(values[3], f"{path}: {columns[3]}") if values[3:] else np.nan
        width[at] = np.nan_to_num(values[4]) if values[4:] else 0.0
    coherence[np.isnan(G)] = np.nan
    return FrequencyResponse(
        omega=table[omega] * (2 * np.pi if hertz else 1.0),
        G=G,
        coherence=coherence,
        random_error=error,
        resolution=width * (2 * np.pi if hertz else 1.0),
        inputs=inputs,
        outputs=outputs,
        input_std=_sizes(inputs, input_std),
        output_std=_sizes(outputs, output_std),
        records=(Path(path).stem,),
    )


def _check_gains(G: ComplexArray, where: str, column: Array) -> None:
    """Refuse gains (K,) that no response has; ``column`` has them as they are written."""
    beyond = (np.abs(G) > LARGEST) | ((np.abs(G) < 1 / LARGEST) & (G != 0))
    if beyond.any():
        k = int(np.flatnonzero(beyond)[0])
        raise ValueError(
            f"{where} is {column[k]:g} in row {k + 1}, a gain of {np.abs(G[k]):.3g}, which no "
            "response has: leave the cell empty where nothing was measured, or say with form what "
            "the columns hold"
        )


def _check_columns(pair: Pair, columns: Sequence[str], form: Form) -> None:
    """Refuse a pair of fewer columns than two, or more than five."""
    if not 2 <= len(columns) <= 5:
        raise ValueError(
            f"pair {pair} names {len(columns)} columns, expected two of {form!r}, then "
            "coherence, random error and resolution where there are such"
        )


def merge_responses(
    responses: FrequencyResponse | Sequence[FrequencyResponse],
) -> FrequencyResponse:
    """The pairs of several responses on the same frequencies, in one.

    A pair measured in two of them is taken from the first; multiple coherence and condition number
    are no longer known, errors after different inputs count as independent, and a frequency that
    one of them flags is flagged.

    Raises
    ------
    ValueError
        No response, or grids that differ.
    """
    responses = several(responses)
    if not responses:
        raise ValueError("no responses given; at least one is needed")
    omega = responses[0].omega
    for other in responses[1:]:
        if other.omega.shape != omega.shape or not np.allclose(other.omega, omega):
            raise ValueError(
                f"responses on {len(omega)} and {len(other.omega)} frequencies that differ; "
                "estimate or export them on one grid"
            )
    return side_by_side([replace(one, omega=omega) for one in responses])


def side_by_side(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """All pairs of responses at all their frequencies, NaN where a pair was not measured."""
    omega = np.unique(np.concatenate([one.omega for one in responses]))
    outputs = tuple(dict.fromkeys(name for one in responses for name in one.outputs))
    inputs = tuple(dict.fromkeys(name for one in responses for name in one.inputs))
    shape = (len(omega), len(outputs), len(inputs))
    G = np.full(shape, np.nan, dtype=complex)
    coherence, error, leaks = (np.full(shape, np.nan) for _ in range(3))
    width, sizes = np.zeros(shape), (dict[str, float](), dict[str, float]())
    flags: dict[str, set[int]] = {}
    alike = np.tile(np.eye(len(outputs), dtype=complex), (len(omega), 1, 1))
    for one in reversed(responses):
        sizes[0].update(zip(one.inputs, one.input_std, strict=True))
        sizes[1].update(zip(one.outputs, one.output_std, strict=True))
        rows = np.array([outputs.index(name) for name in one.outputs])
        columns = np.array([inputs.index(name) for name in one.inputs])
        at = np.searchsorted(omega, one.omega)
        place, there = np.ix_(at, rows, columns), np.isfinite(one.G)
        parts = (one.G, one.coherence, one.random_error, one.leakage, one.resolution)
        for whole, part in zip((G, coherence, error, leaks, width), parts, strict=True):
            whole[place] = np.where(there, part, whole[place])
        for reason, doubted in one.flags.items():
            flags.setdefault(reason, set()).update(at[list(doubted)].tolist())
        if len(rows) == len(outputs):  # else blocks of several may be no correlation together
            alike[np.ix_(at, rows, rows)] = one.output_correlation
    told = dict.fromkeys(flight for one in responses for flight in one.flights())
    named = [name for name, *_ in told]
    unnamed = [name for one in responses for name in one.records if name not in named]
    return FrequencyResponse(
        omega=omega,
        G=G,
        coherence=coherence,
        random_error=error,
        leakage=leaks,
        resolution=width,
        output_correlation=alike,
        inputs=inputs,
        outputs=outputs,
        input_std=_sizes(inputs, sizes[0]),
        output_std=_sizes(outputs, sizes[1]),
        flags={reason: tuple(sorted(doubted)) for reason, doubted in flags.items()},
        records=(*named, *dict.fromkeys(unnamed)),
        fingerprints=tuple(prints for _, prints, *_ in told),
        printed=tuple((u, y) for _, _, u, y in told),
    )


def _complex(first: Array, second: Array, form: Form) -> ComplexArray:
    if form == "re im":
        return np.asarray(first.astype(complex) + 1j * second)
    gain, phase = form.split()
    modulus = 10 ** (first / 20) if gain == "dB" else first
    angle = np.radians(second) if phase == "deg" else second
    return np.asarray(modulus * np.exp(1j * angle), dtype=complex)


def _coherence(values: Array, where: str) -> Array:
    if ((values < 0) | (values > 1)).any():
        k = int(np.flatnonzero((values < 0) | (values > 1))[0])
        raise ValueError(f"{where} is {values[k]:g} in row {k + 1}; coherence is in [0, 1]")
    return values


def _error(values: Array, where: str) -> Array:
    if (values == 0).any():
        raise ValueError(
            f"{where} is 0 in row {int(np.flatnonzero(values == 0)[0]) + 1}: no measurement is "
            "without error, and a fit would take that for certain; leave the cell empty, or the "
            "column out, where the random error is not known"
        )
    return values


def _sizes(names: Sequence[str], known: Mapping[str, float] | None) -> Array:
    return np.array([float((known or {}).get(name, 1.0)) for name in names])
