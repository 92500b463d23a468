"""What a study does to its records before anything is estimated: the operations of `Record`."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

import numpy as np

from casid.checks import hint
from casid.consistency.alignment import aligned, moves_told
from casid.consistency.kinematics import kinematic_check
from casid.errors import warn
from casid.outlier_detection import outliers
from casid.record import Record
from casid.repeated_samples import repeated, without_repeats
from casid.samples import known_inputs
from casid.tables import Table

FINER = 0.9  # of a record's interval, from which on resampling adds samples
STAYING = 4.0  # standard deviations between a mean and zero
KINEMATICS: Literal["kinematics"] = "kinematics"


@dataclass(frozen=True, kw_only=True)
class SecondLogger:
    """A second logger of the same flights: its file beside each record's, channels and clock."""

    file: str  # "{name}_nav.csv" or "../nav/{name}.csv", from the folder of the record's own
    channels: tuple[str, ...]
    time: str = "t"
    clock: float = 0.0  # added to its time [s]

    def beside(self, file: Path) -> Path:
        """The file that belongs to a record's."""
        return file.parent / self.file.replace("{name}", file.stem)

    def joined(self, first: Record, other: Record, *, fresh: bool) -> Record:
        """The records of both loggers as one; repeated samples of this one are told or missing."""
        # At the instants of the first they would be interpolated, and no repeats any more.
        marks = repeated(other)
        if fresh:
            other = without_repeats(other)
        elif marks.any():
            names = np.array([*other.inputs, *other.outputs])[marks.any(axis=0)]
            warn(
                f"record {other.name!r} repeats samples of a slower source in {', '.join(names)}, "
                'which the join takes for movement in steps: [channels] repeats = "mask"'
            )
        return first.join(other, clock=self.clock)

    def told(self) -> str:
        """What is joined."""
        return f"{', '.join(self.channels)} from {self.file}, clock {self.clock:+g} s"


@dataclass(frozen=True, kw_only=True)
class Mending:
    """Preprocessing of all records as they are read: shifts, outliers and repeats masked."""

    shift: Mapping[str, float] | Literal["kinematics"] = field(default_factory=dict)
    mask: bool = False  # outliers count as missing
    fresh: bool = False  # repeated samples count as missing

    def told(self) -> dict[str, str]:
        """What is done, by key."""
        if isinstance(self.shift, str):
            said = {"channels.shift": "as kinematics asks for"}
        else:
            lags = ", ".join(f"{name} {lag:+g} s" for name, lag in self.shift.items())
            said = {"channels.shift": lags} if lags else {}
        said |= {"channels.repeats": "count as missing"} if self.fresh else {}
        return said | ({"channels.outliers": "count as missing"} if self.mask else {})

    def mended(
        self, records: Mapping[Any, Record], second: Collection[str] = (), theta0: float = 0.0
    ) -> dict[Any, Record]:
        """Records with repeats and outliers marked as missing and channels moved in time.

        Channels of the ``second`` logger move together, and so do all others; ``theta0`` [rad] is
        the pitch attitude of the trim, where it was not recorded.
        """
        done = dict(records)
        if self.fresh:
            done = {key: without_repeats(record) for key, record in done.items()}
        if self.mask:
            marks = {key: outliers(record) for key, record in done.items()}
            done = {key: record.mask(marks[key]) for key, record in done.items()}
            count = sum(int(each.sum()) for each in marks.values())
            told = f"{count} in all" if count else "but none was found"
            warn(f"outliers count as missing, {told}, as the study asks for")
        by, drift = self.shift, dict[str, float]()
        if isinstance(by, str):
            by, drift, why = _skews(tuple(done.values()), second, theta0)
            said = "; ".join((moves_told(by), *why))
            warn(f"kinematics moves channels in time, as the study asks for: {said}")
        lags = by
        return {
            key: record.shift(lags, drift=drift) if lags or drift else record
            for key, record in done.items()
        }


@dataclass(frozen=True, kw_only=True)
class Cutting:
    """What is done to the records of one role: start and end [s], of single ones by name."""

    cut: tuple[float, float] | None = None
    cuts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    resample: float | None = None  # s
    decimate: int = 1

    def told(self) -> str:
        """What is done."""
        said = [f"cut {a:g} to {b:g} s" for a, b in ([self.cut] if self.cut else [])]
        said += [f"{name} cut {a:g} to {b:g} s" for name, (a, b) in self.cuts.items()]
        said += [f"resampled every {self.resample:g} s"] if self.resample else []
        return ", ".join([*said, f"every {self.decimate}. sample"])

    def of(self, record: Record) -> Record:
        """A record cut and sampled as its role asks for."""
        span = self.cuts.get(record.name, self.cut)
        if span is not None:
            _tell_beyond(record, span[1])
            record = record.cut(*span)
        if self.resample is not None:
            record = self._resampled(record, self.resample)
        return record.decimate(self.decimate)

    @staticmethod
    def _resampled(record: Record, dt: float) -> Record:
        if dt < FINER * record.dt:
            warn(
                f"record {record.name!r} is measured every {record.dt:g} s: resample = {dt:g} adds "
                "samples that nobody measured, and standard errors count them; leave it out"
            )
        try:
            return record.resample(dt)
        except ValueError as error:
            raise ValueError(f"resample = {dt:g}: {error}") from error


def _tell_beyond(record: Record, end: float) -> None:
    """Warn of a cut that ends [s] beyond the record, unless at infinity."""
    last = float(record.t[-1])
    if last + record.dt < end < np.inf:
        warn(
            f"record {record.name!r} lasts from {record.t[0]:.12g} to {last:.12g} s: its cut ends "
            f"at {end:.12g} s, beyond it; mend the cut, or write inf for as far as records go"
        )


def _skews(
    records: Sequence[Record], second: Collection[str], theta0: float
) -> tuple[dict[str, float], dict[str, float], tuple[str, ...]]:
    """Shifts [s] and drifts [s/s] that bring channels of both loggers into line, why in words."""
    check = kinematic_check(records, trim={"theta0": theta0})
    if check.by_record:
        raise ValueError(f'shift = "{KINEMATICS}": {"; ".join(check.by_record)}')
    if not check.channels:
        told = "; ".join((*check.further, *check.notes)) or "no angular rate with its attitude"
        raise ValueError(
            f'shift = "{KINEMATICS}": kinematics cannot judge these records ({told}); mend '
            "what is named, or state the shifts: shift = { phi = -0.06 }, {} for none"
        )
    first = [name for name in records[0].outputs if name not in second]
    moves, why = aligned(check, first, second, records[0].inputs)
    return moves, check.drifts.remedy, (*why, *check.drifts.told())


def with_inputs(record: Record, names: tuple[str, ...]) -> Record:
    """The record, those of its outputs that are named being inputs.

    Samples at which one is not known, between its own by ``hold``, are left out.
    """
    kept = [name for name in record.outputs if name not in names]
    moved = [name for name in record.outputs if name in names]
    y = [record.outputs.index(name) for name in moved]
    u, known = known_inputs(record.t, record.y[:, y], [record.hold] * len(moved))
    inputs = (*record.inputs, *moved)
    whole = record.select(outputs=kept).take(known)
    return replace(whole, u=np.hstack([whole.u, u[known]]), inputs=inputs)


def tell_doubled(record: Record, trim: Mapping[str, float]) -> None:
    """Warn of channels whose values still hold the trim that is said to be subtracted."""
    for name in (each for each in (*record.inputs, *record.outputs) if each in trim):
        values = record.channel(name)[np.isfinite(record.channel(name))]
        if not len(values):
            continue
        mean, spread = float(values.mean()), float(values.std())
        # Deviations begin at zero: they do not stay so far from it, and about the trim at that.
        near = abs(mean - trim[name]) < min(abs(mean), abs(trim[name]))
        if near and abs(mean) > STAYING * spread:
            warn(
                f"record {record.name!r}: trim says that {name} = {trim[name]:g} was subtracted, "
                f"but its values lie about {mean:.4g} and never near 0: if they are total values, "
                f"leave {name} out of trim, which counts it twice"
            )


def read_mending(table: Table) -> Mending:
    """The keys ``shift``, ``outliers`` and ``repeats`` of [channels]."""
    marked = {}
    for key, field_ in (("outliers", "mask"), ("repeats", "fresh")):
        asked = table.take(key, str, "keep")
        if asked not in ("keep", "mask"):
            raise ValueError(f'{table.place} {key} = {asked!r}, expected "keep" or "mask"')
        marked[field_] = asked == "mask"
    shift = table.content.get("shift", {})
    if isinstance(shift, str):
        if shift != KINEMATICS:
            raise ValueError(
                f'{table.place} shift = {shift!r}, expected "kinematics" or {{ phi = -0.06 }}'
            )
        return Mending(shift=KINEMATICS, **marked)
    return Mending(shift=table.numbers("shift"), **marked)


def read_second(table: Table, known: tuple[str, ...]) -> SecondLogger | None:
    """The table [channels.join], if it is there."""
    if not table.content:
        return None
    table.only(("file", "channels", "time", "clock"))
    file, channels = table.take("file", str), table.names("channels")
    if file is None or "{name}" not in file:
        raise ValueError(
            f"{table.place} file = {file!r}, expected the second file of each record, such as "
            '"{name}_nav.csv"'
        )
    if wrong := [name for name in channels if name not in known]:
        raise ValueError(f"{table.place} channels: {wrong[0]!r} is none of {', '.join(known)}")
    if not channels:
        raise ValueError(f"{table.place} channels are missing: name those of the second file")
    clock = float(table.take("clock", (int, float), 0.0))
    return SecondLogger(
        file=file, channels=channels, time=table.take("time", str, "t"), clock=clock
    )


def read_cutting(table: Table, decimate: int) -> Cutting:
    """The keys ``cut``, ``resample`` of a role."""
    asked, resample = table.content.get("cut"), table.take("resample", (int, float))
    cut, cuts = None, {}
    if isinstance(asked, dict):
        inner = table.table("cut")
        cuts = {name: _span(inner, name) for name in asked}
    elif asked is not None:
        cut = _span(table, "cut")
    if resample is not None and not resample > 0:
        raise ValueError(f"{table.place} resample = {resample}, expected seconds above 0")
    return Cutting(cut=cut, cuts=cuts, resample=resample, decimate=decimate)


def read_trim(table: Table, files: Collection[str]) -> dict[str, dict[str, float]]:
    """The key ``trim`` of a role: values for all its records, or by name or pattern of names."""
    inner = table.table("trim")
    if not any(isinstance(value, dict) for value in inner.content.values()):
        return {"*": table.numbers("trim")} if inner.content else {}
    for pattern in inner.content:
        if not any(fnmatchcase(name, pattern) for name in files):
            told = hint(pattern, files)
            raise ValueError(f"{inner.place} no record is called {pattern!r}; {told}")
    return {pattern: inner.numbers(pattern) for pattern in inner.content}


def _span(table: Table, key: str) -> tuple[float, float]:
    start, end = table.pair(key, wanted := "[start, end] in seconds")
    if not start < end:
        raise ValueError(f"{table.place} {key} = {[start, end]}, expected {wanted}")
    return start, end
