"""Systems and records as the objects of other packages: python-control, SciPy, pandas."""

import importlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg
import scipy.signal

from casid.arrays import Array
from casid.files import Channels, Detrend, build
from casid.linear import StateSpace
from casid.record import Hold, Record

# pandas and python-control have no types of their own that mypy could use.


def to_control(system: StateSpace, *, pade: int | None = None) -> Any:  # noqa: ANN401
    """A `control.StateSpace` with the same names.

    ``pade`` is the order of the Padé approximation of delays (see `without_delay`), without which a
    continuous model with delays is refused (ValueError).
    """
    import control  # noqa: PLC0415 - slow to import, and only wanted here

    plain = without_delay(system, pade)
    names = {name: list(getattr(plain, name)) for name in ("inputs", "outputs", "states")}
    return control.ss(plain.A, plain.B, plain.C, plain.D, plain.dt or 0, **names)


def from_control(system: Any, *, delay: Sequence[float] = ()) -> StateSpace:  # noqa: ANN401
    """A `StateSpace` from a `control.StateSpace`; ``delay`` [s] is that of each input.

    Raises
    ------
    ValueError
        A discrete model whose interval python-control does not know (``dt=True``).
    """
    if system.dt is True:
        raise ValueError("the system is discrete without a sampling interval; set its dt [s]")
    names = (system.input_labels, system.output_labels, system.state_labels)
    return _state_space(system, system.dt, names, delay)


def to_scipy(system: StateSpace, *, pade: int | None = None) -> Any:  # noqa: ANN401
    """A `scipy.signal.StateSpace`; it has no names, and delays as in `to_control`."""
    plain = without_delay(system, pade)
    time = {} if plain.dt is None else {"dt": plain.dt}
    return scipy.signal.StateSpace(plain.A, plain.B, plain.C, plain.D, **time)


def from_scipy(
    system: Any,  # noqa: ANN401 - a system of SciPy in any form
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    states: Sequence[str] = (),
    delay: Sequence[float] = (),
) -> StateSpace:
    """A `StateSpace` from any system of SciPy (state space, transfer function, zeros and poles).

    Parameters
    ----------
    system : scipy.signal.lti or dlti
        The system.
    inputs, outputs, states : sequence of str
        Names, which SciPy does not keep.
    delay : sequence of float
        Of each input [s].
    """
    plain = system.to_ss()
    return _state_space(plain, plain.dt, (inputs, outputs, states), delay)


def _state_space(
    system: Any,  # noqa: ANN401
    dt: float | None,
    names: Iterable[Sequence[str]],
    delay: Sequence[float],
) -> StateSpace:
    inputs, outputs, states = map(tuple, names)
    time, late = float(dt) if dt else None, np.array(delay, dtype=float)
    return StateSpace(system.A, system.B, system.C, system.D, time, inputs, outputs, states, late)


def without_delay(system: StateSpace, pade: int | None = None) -> StateSpace:
    """The same system with its delays turned into states.

    A discrete model holds past inputs as states, which is exact. A continuous one gets a Padé
    approximation for each delayed input: all-pass, the phase right up to about ``pade``/delay
    rad/s.

    Parameters
    ----------
    system : StateSpace
        With or without delays.
    pade : int
        Order of the approximation, 1 to 10; needed for a continuous model with delays.

    Raises
    ------
    ValueError
        Delays of a continuous model without ``pade``; of a discrete one that are no multiples of
        its interval.
    """
    if not system.delay.any():
        return system
    if system.dt is None and pade is None:
        told = ", ".join(
            f"{name} {tau:g} s"
            for name, tau in zip(system.inputs, system.delay, strict=True)
            if tau
        )
        raise ValueError(
            f"the model has delays ({told}), the target has none: pass pade=3 for approximations, "
            "or dataclasses.replace(system, delay=()) to drop them knowingly"
        )
    lines = [_delay_line(system, j, pade) for j in range(system.nu)]
    A, B, C, D = (scipy.linalg.block_diag(*blocks) for blocks in zip(*lines, strict=True))
    named = zip(system.inputs, lines, strict=True)
    names = [f"{name}_{k + 1}" for name, line in named for k in range(len(line[0]))]
    n = len(A)
    return StateSpace(
        np.block([[system.A, system.B @ C], [np.zeros((n, system.nx)), A]]),
        np.vstack([system.B @ D, B]),
        np.hstack([system.C, system.D @ C]),
        system.D @ D,
        system.dt,
        system.inputs,
        system.outputs,
        (*system.states, *names),
    )


def _delay_line(system: StateSpace, j: int, pade: int | None) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D of the delay of one input."""
    tau = float(system.delay[j])
    if system.dt is not None:
        n = round(tau / system.dt)
        if abs(tau - n * system.dt) > 1e-6 * system.dt:
            raise ValueError(
                f"the delay of {system.inputs[j]!r}, {tau:g} s, is no multiple of the interval "
                f"{system.dt:g} s of this discrete model"
            )
        if n:
            A = np.eye(n, k=-1)
            return A, np.eye(n, 1), np.eye(n)[-1:], np.zeros((1, 1))
    elif tau:
        if pade is None or not 1 <= pade <= 10:
            raise ValueError(f"pade={pade}: expected an order of 1 to 10")
        import control  # noqa: PLC0415 - slow to import, and only wanted here

        numerator, denominator = control.pade(tau, pade)
        line = scipy.signal.tf2ss(numerator, denominator)
        return tuple(np.atleast_2d(part) for part in line)  # type: ignore[return-value]
    return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))


def to_dataframe(record: Record) -> Any:  # noqa: ANN401
    """A pandas DataFrame: a column a channel, time [s] as index ``t``, SI units.

    What a frame has no place for (which are inputs, hold, trim, name) stands in its ``attrs``.

    Raises
    ------
    ValueError
        pandas is not installed.
    """
    pandas = optional("pandas", "a DataFrame")
    values = np.hstack([record.u, record.y])
    names = [*record.inputs, *record.outputs]
    frame = pandas.DataFrame(values, index=pandas.Index(record.t, name="t"), columns=names)
    frame.attrs = {"inputs": list(record.inputs), "outputs": list(record.outputs)}
    frame.attrs |= {"name": record.name, "hold": record.hold, "trim": dict(record.trim)}
    return frame


def from_dataframe(
    frame: Any,  # noqa: ANN401
    *,
    inputs: Channels | None = None,
    outputs: Channels | None = None,
    time: str | float = "t",
    units: Mapping[str, str] | None = None,
    detrend: Detrend = None,
    hold: Hold | None = None,
    name: str | None = None,
) -> Record:
    """A record from a pandas DataFrame.

    Parameters
    ----------
    frame : pandas.DataFrame
        Channels in columns; time is the column ``time``, or else the index in s (or a time delta).
    inputs, outputs, hold, name
        As in `read_csv`; from the ``attrs`` that `to_dataframe` leaves, unless given.
    time, units, detrend
        As in `read_csv`.

    Raises
    ------
    ValueError
        A column that is missing or holds no numbers, and all that `Record` refuses.
    """
    kept = dict(frame.attrs)
    inputs = kept.get("inputs", ()) if inputs is None else inputs
    outputs = kept.get("outputs", ()) if outputs is None else outputs
    if not inputs or not outputs:
        raise ValueError(
            "which columns are inputs and which outputs? The frame does not say: name both; it has "
            + ", ".join(map(str, frame.columns))
        )
    if time not in frame.columns and isinstance(time, str):
        index = frame.index
        index = index.total_seconds() if hasattr(index, "total_seconds") else index
        frame = frame.assign(**{time: np.asarray(index, dtype=float)})
    name = str(kept.get("name", "") if name is None else name)
    record = build(partial(_column, frame), inputs, outputs, time, units, name)
    trim = {each: float(value) for each, value in dict(kept.get("trim", {})).items()}
    return replace(record, hold=hold or kept.get("hold", "foh"), trim=trim).detrend(detrend)


def _column(frame: Any, name: str) -> Array:  # noqa: ANN401
    if name not in frame.columns:
        known = ", ".join(map(str, frame.columns))
        raise ValueError(f"the frame has no column {name!r}; it has {known}")
    try:
        return np.asarray(frame[name].to_numpy(dtype=float, na_value=np.nan))
    except (TypeError, ValueError) as error:
        raise ValueError(f"column {name!r} holds no numbers: {error}") from error


def optional(module: str, what: str, *, extra: str = "tables") -> Any:  # noqa: ANN401 - a module
    """Import a package that casid does not depend on; ValueError where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ValueError(
            f"{what} needs {module}, which is not installed: pip install 'casid[{extra}]'"
        ) from error
