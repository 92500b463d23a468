"""Whether the records of a study can be what they are said to be: units, time, dead channels."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.channels import CONTROLS, MEASURES, RATES
from casid.record import Record
from casid.records import still

FEWEST = 16  # samples of a record
USUAL, SLOW, NEVER = 0.02, 1.0, 10.0  # sampling intervals [s]: of most, of hardly any, of no flight
FASTEST = 1.1e-4  # s: a shorter sampling interval is no flight's
KILOHERTZ, SHORTEST = 1.1e-3, 0.1  # s: nor is one below the first in a record below the second
TIMES = ("s", "ms", "us", "ns")  # units that clocks count in
FULL_TURN = {"phi": np.pi, "theta": np.pi / 2, "psi": 6 * np.pi}  # rad: three turns
TUMBLING = 6.0  # rad/s, a full turn a second
PULSES = (700.0, 2300.0)  # µs, between which the pulses of a servo stay
ROUNDING = 1e-9  # of a level, by which means of what stands still may differ
FULL = 2.0  # travels of a stick that no stick has


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """A channel that is hardly in the unit it is taken for: what it does, and what may be right."""

    channel: str
    said: str
    units: tuple[str, str]  # the likelier, the one it was taken for
    sure: bool = False  # it is not what it was taken for, whoever stated it
    remedy: str = ""  # where no other unit is one

    def asked(self) -> str:
        """The units that may be stated, the likelier first."""
        return self.units[0] if self.sure else " or ".join(self.units)

    def advice(self, statement: str) -> str:
        """What may be right, and how to say so where ``statement`` is that of a unit."""
        return self.remedy or f"is it in {self.units[0]}? State its unit{statement}"


def unit_doubts(
    record: Record, time: str | None = "t", stated: Collection[str] = ()
) -> list[Doubt]:
    """Doubts about time, angles, rates and sticks of a record, columns of ``stated`` unit apart.

    Time that no unit makes a flight's is doubted all the same where ``stated`` says its unit.
    ``time`` is the column of instants, None where they were counted by an interval.
    """
    known = isinstance(stated, Mapping)
    taken = stated.get(time or "", "s") if isinstance(stated, Mapping) else "s"
    found = (*_doubts_of_time(record, time, taken), *_doubts(record))
    return [each for each in found if each.channel not in stated or (each.sure and known)]


def _unit_of_time(interval: float, taken: str) -> str:
    """The unit other than that taken with which an interval [s] is nearest to a usual one."""
    factors = MEASURES["s"]
    off = {u: abs(np.log(interval * factors[u] / (factors[taken] * USUAL))) for u in TIMES}
    return min((unit for unit in TIMES if unit != taken), key=lambda unit: off[unit])


def _doubts_of_time(record: Record, time: str | None, unit: str) -> Iterator[Doubt]:
    slow, long = record.dt >= SLOW, record.duration >= SHORTEST or record.N < FEWEST
    if not slow and record.dt > FASTEST and (long or record.dt > KILOHERTZ):
        return
    said = f"advances {record.dt:g} s a sample"
    if not slow:
        said += f", so that {record.N} samples last {record.duration:.3g} s, as no flight's do"
    if time is None:
        said = f"time {said}"
        yield Doubt(channel="dt", said=said, units=("s", "s"), remedy="correct dt, in seconds")
        return
    said = f"the time column {time!r} {said}"
    if slow or unit != "s":
        units = _unit_of_time(record.dt, unit), unit
        yield Doubt(channel=time, said=said, units=units, sure=not slow or record.dt >= NEVER)
        return
    remedy = "convert it to seconds (days times 86400, minutes times 60), or state that it is in s"
    yield Doubt(channel=time, said=said, units=("s", "s"), remedy=remedy)


def _doubts(record: Record) -> Iterator[Doubt]:
    for name in (*record.inputs, *record.outputs):
        values = record.channel(name) + record.trim.get(name, 0.0)
        largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
        if name in CONTROLS and largest > FULL:
            said = f"{name!r} reaches {largest:.3g}, more than full travel"
            pulses = PULSES[0] < float(np.nanmin(values)) and largest < PULSES[1]
            yield Doubt(channel=name, said=said, units=("pwm" if pulses else "%", "1"))
        elif name in RATES and largest > TUMBLING:
            said = f"{name!r} reaches {largest:.3g} rad/s"
            yield Doubt(channel=name, said=said, units=("deg/s", "rad/s"))
        elif largest > FULL_TURN.get(name, np.inf):
            said = f"{name!r} reaches {largest:.3g} rad"
            yield Doubt(channel=name, said=said, units=("deg", "rad"))


def check_plausible(
    identification: Sequence[Record],
    records: Sequence[Record],
    units: Mapping[str, str],
    time: str | None = "t",
    *,
    total: bool = False,
) -> None:
    """Refuse records that nothing can be learnt from, and units that must be others.

    ``total`` says that the structure is of total values: an input that stands still in each record,
    like a throttle, then teaches something if it does so elsewhere in another.

    ValueError: a sampling interval of a second and more, or of 0.1 ms and less, less than 0.1 s at
    a kilohertz and more, or angles and rates too large for radians, whose unit nobody stated; an
    interval of ten seconds and more, or such a short one in another unit than s, whoever stated it;
    a record of a few samples; a channel constant in all of ``identification``.
    """
    for record in records:
        for doubt in unit_doubts(record, time, units):
            if doubt.channel not in CONTROLS:  # a structure may take sticks in any unit
                likely, taken = doubt.units
                statement = f': [channels.units] {doubt.channel} = "{likely}"'
                statement += f', or "{taken}"' if not doubt.sure else ""
                raise ValueError(f"record {record.name!r}: {doubt.said}; {doubt.advice(statement)}")
        if record.N < FEWEST:
            raise ValueError(
                f"record {record.name!r} has {record.N} samples, at least {FEWEST} are wanted; "
                "is it cut off? Take it out of the study, or decimate less"
            )
    _check_movement(identification, total=total)


def _check_movement(records: Sequence[Record], *, total: bool) -> None:
    for name in still(records, (*records[0].inputs, *records[0].outputs)):
        kind = "input" if name in records[0].inputs else "output"
        if kind == "input" and total and _differs(records, name):
            continue
        names = ", ".join(repr(record.name) for record in records[:4])
        remedy = "add a record that excites it" if kind == "input" else "look at its sensor"
        raise ValueError(
            f"{kind} {name!r} is constant in record{'s' * (len(records) > 1)} {names}, so nothing "
            "can be learnt from it; "
            f"{remedy}, or take a model without it"
        )


def _differs(records: Sequence[Record], name: str) -> bool:
    """Whether a channel at rest in each record is elsewhere in some, by more than rounding."""
    levels = [np.nanmean(record.totals()[name]) for record in records]
    return bool(np.ptp(levels) > ROUNDING * np.max(np.abs(levels)))
