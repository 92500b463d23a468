"""Whether the records of a study can be what they are said to be: units, time, dead channels."""

from collections.abc import Mapping, Sequence

import numpy as np

from casid.record import Record

FEWEST = 16  # samples of a record
SLOW = 1.0  # sampling interval [s] no manoeuvre of a rotorcraft is recorded with
FULL_TURN = {"phi": np.pi, "theta": np.pi / 2, "psi": 2 * np.pi + 0.1}  # rad
TUMBLING = 6.0  # rad/s, a full turn a second
RATES = ("p", "q", "r")


def check_plausible(
    identification: Sequence[Record],
    records: Sequence[Record],
    units: Mapping[str, str],
    time: str = "t",
) -> None:
    """Refuse records that nothing can be learnt from, and units that must be others.

    Parameters
    ----------
    identification : sequence of Record
        Every channel must move in one of these.
    records : sequence of Record
        All that the study reads.
    units : mapping
        The units the user has stated; what is stated is believed.
    time : str
        Name of the time column.

    Raises
    ------
    ValueError
        A sampling interval of a second or more, or angles and rates too large for radians, whose
        unit nobody stated; a record of a few samples; an input or output that is constant in every
        record of identification.
    """
    for record in records:
        if record.dt >= SLOW and time not in units:
            raise ValueError(
                f"record {record.name!r}: the time column {time!r} advances {record.dt:g} s a "
                f'sample; is it in ms? State its unit: [channels.units] {time} = "ms", or "s"'
            )
        _check_radians(record, units)
        if record.N < FEWEST:
            raise ValueError(
                f"record {record.name!r} has {record.N} samples, at least {FEWEST} are wanted; "
                "is it cut off? Take it out of the study, or decimate less"
            )
    _check_movement(identification)


def _check_movement(records: Sequence[Record]) -> None:
    for name in (*records[0].inputs, *records[0].outputs):
        if not any(_moves(record, name) for record in records):
            kind = "input" if name in records[0].inputs else "output"
            remedy = "add a record that excites it" if kind == "input" else "look at its sensor"
            raise ValueError(
                f"{kind} {name!r} is constant in {_shown(records)}, so nothing can be learnt from "
                f"it; {remedy}, or take a model without it"
            )


def _moves(record: Record, name: str) -> bool:
    values = record.channel(name)
    values = values[np.isfinite(values)]
    size = np.max(np.abs(values + record.trim.get(name, 0.0)), initial=0.0)
    return bool(values.size and np.ptp(values) > 1e-12 * size)


def _check_radians(record: Record, units: Mapping[str, str]) -> None:
    for name in record.outputs:
        limit = TUMBLING if name in RATES else FULL_TURN.get(name, np.inf)
        values = record.channel(name) + record.trim.get(name, 0.0)
        largest = np.max(np.abs(values[np.isfinite(values)]), initial=0.0)
        if largest > limit and name not in units:
            kind = ("rad/s", "deg/s") if name in RATES else ("rad", "deg")
            raise ValueError(
                f"record {record.name!r}: {name!r} reaches {largest:.3g} {kind[0]}; is it in "
                f'{kind[1]}? State its unit: [channels.units] {name} = "{kind[1]}", or "{kind[0]}"'
            )


def _shown(records: Sequence[Record]) -> str:
    names = ", ".join(repr(record.name) for record in records[:4])
    return f"record {names}" if len(records) == 1 else f"records {names}"
