"""Systems and records as the objects of other packages: python-control, SciPy, pandas."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array
from casid.checks import optional
from casid.exchange.delays import without_delay
from casid.exchange.equations import equations_of
from casid.files import Channels, Detrend, build
from casid.linear import StateSpace
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold, Record

DATED = ("M", "m")  # kinds of columns: dates, time deltas

# pandas and python-control have no types of their own that mypy could use.


def to_control(system: StateSpace | NonlinearModel, *, pade: int | None = None) -> Any:  # noqa: ANN401
    """A `control.StateSpace` with the same names; of a nonlinear structure a `NonlinearIOSystem`.

    ``pade`` is the order of the Padé approximation of delays (see `without_delay`), without which a
    continuous model with delays is refused (ValueError). A nonlinear structure has total values;
    ``equations_of(model, pade).x0`` is its reference condition.
    """
    import control  # noqa: PLC0415 - slow to import, and only wanted here

    if isinstance(system, NonlinearModel):
        found = equations_of(system, pade)
        names = {name: list(getattr(found, name)) for name in ("inputs", "outputs", "states")}
        return control.NonlinearIOSystem(
            lambda t, x, u, _: found.derivatives(t, x, u),
            lambda t, x, u, _: found.measurements(t, x, u),
            name=type(system).__name__,
            **names,
        )
    plain = without_delay(system, pade)
    names = {name: list(getattr(plain, name)) for name in ("inputs", "outputs", "states")}
    return control.ss(plain.A, plain.B, plain.C, plain.D, plain.dt or 0, **names)


def from_control(system: Any, *, delay: Sequence[float] = ()) -> StateSpace:  # noqa: ANN401
    """A `StateSpace` from a system of python-control; ``delay`` [s] is that of each input.

    Raises
    ------
    ValueError
        A discrete model whose interval python-control does not know (``dt=True``).
    TypeError
        Neither a state space nor a transfer function.
    """
    import control  # noqa: PLC0415 - slow to import, and only wanted here

    if isinstance(system, control.TransferFunction):
        system = control.ss(system)
    if not isinstance(system, control.StateSpace):
        raise TypeError(
            f"{type(system).__name__} is no state space or transfer function of python-control; "
            "control.linearize makes one of a nonlinear system"
        )
    if system.dt is True:
        raise ValueError("the system is discrete without a sampling interval; set its dt [s]")
    names = (system.input_labels, system.output_labels, system.state_labels)
    return _state_space(system, system.dt, names, delay)


def to_scipy(system: StateSpace | NonlinearModel, *, pade: int | None = None) -> Any:  # noqa: ANN401
    """A `scipy.signal.StateSpace`; it has no names, and delays as in `to_control`.

    Of a nonlinear structure its `Equations`, whose ``derivatives`` `scipy.integrate.solve_ivp`
    takes.
    """
    if isinstance(system, NonlinearModel):
        return equations_of(system, pade)
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
    frame.attrs |= {"units": dict(record.units)}
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
        Channels in columns; time is the column ``time``, or else the index: in s, a time delta, or
        dates, which count from the first.
    inputs, outputs, hold, name
        As in `read_csv`; from the ``attrs`` that `to_dataframe` leaves, unless given.
    time, units, detrend
        As in `read_csv`.

    Raises
    ------
    ValueError
        A column that is missing or holds no numbers, a unit of dates, and all that `Record`
        refuses.
    """
    kept = dict(frame.attrs)
    inputs = kept.get("inputs", ()) if inputs is None else inputs
    outputs = kept.get("outputs", ()) if outputs is None else outputs
    if not inputs or not outputs:
        raise ValueError(
            "which columns are inputs and which outputs? The frame does not say: name both; it has "
            + ", ".join(map(str, frame.columns))
        )
    if isinstance(time, str):
        frame = _with_seconds(frame, time, units or {})
    name = str(kept.get("name", "") if name is None else name)
    record = build(partial(_column, frame), inputs, outputs, time, units, name)
    trim = {each: float(value) for each, value in dict(kept.get("trim", {})).items()}
    own = {str(k): str(v) for k, v in dict(kept.get("units", {})).items()} | dict(record.units)
    record = replace(record, hold=hold or kept.get("hold", "foh"), trim=trim, units=own)
    return record.detrend(detrend)


def _with_seconds(frame: Any, time: str, units: Mapping[str, str]) -> Any:  # noqa: ANN401
    """The frame with its time, a column or else the index, in numbers: dates from the first [s]."""
    given = frame[time] if time in frame.columns else frame.index.to_series()
    kind = getattr(given.dtypes, "kind", "")
    if kind not in DATED and time in frame.columns:
        return frame
    if kind in DATED and time in units:
        raise ValueError(
            f"time {time!r} holds dates or time deltas, which are no {units[time]}: leave its unit "
            "out"
        )
    return frame.assign(**{time: in_seconds(given).to_numpy()})


def in_seconds(column: Any) -> Any:  # noqa: ANN401
    """A pandas Series of time deltas [s] or dates, from the first [s], in numbers; or as it is."""
    kind = getattr(column.dtypes, "kind", "")
    since = column - column.min() if kind == "M" else column
    return since.dt.total_seconds() if kind in DATED else column


def _column(frame: Any, name: str) -> Array:  # noqa: ANN401
    if name not in frame.columns:
        known = ", ".join(map(str, frame.columns))
        raise ValueError(f"the frame has no column {name!r}; it has {known}")
    if getattr(frame[name].dtypes, "kind", "") in DATED:  # which would be counted in nanoseconds
        raise ValueError(f"column {name!r} holds dates or time deltas, expected numbers")
    try:
        return np.asarray(frame[name].to_numpy(dtype=float, na_value=np.nan))
    except (TypeError, ValueError) as error:
        raise ValueError(f"column {name!r} holds no numbers: {error}") from error
