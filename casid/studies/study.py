"""A study: what to identify from which records, as frozen values."""

import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any

import numpy as np

from casid.checks import checked_fields
from casid.consistency.plausibility import check_plausible
from casid.consistency.reused_flights import Repeats, repeats
from casid.design.loop import gains
from casid.design.prior import check_trim
from casid.design.problem import check_limited, free_of
from casid.design.specification import DesignSettings, check_deviations, check_times
from casid.errors import DataWarning, warn
from casid.exchange.formats import read_record
from casid.files import Column, read_csv
from casid.folder import spare
from casid.model import Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold, Record
from casid.saturation import longest_stop, saturated
from casid.seams import seams_told
from casid.slow_sources import tell_repeats
from casid.stages.stage import ROLES, Role, Stage, Task, examine_task
from casid.stuck_channels import frozen
from casid.studies.preparation import Cutting, Mending, SecondLogger, tell_doubled, with_inputs
from casid.subspace.pbsid import Pbsid
from casid.tables import placed


@dataclass(frozen=True, kw_only=True)
class RecordSet:
    """The files of one role and how they are read."""

    files: tuple[Path, ...]
    patterns: tuple[Path, ...] = ()  # that the files were found by
    detrend: str = "first"  # first, mean, none, or the role whose trim is taken
    trim: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # by pattern of names
    noise: bool = False
    cutting: Cutting = Cutting()

    def placed(self, record: Record) -> Record:
        """A record with the flight condition that is told of it."""
        told = [trim for pattern, trim in self.trim.items() if fnmatchcase(record.name, pattern)]
        trim = reduce(or_, map(dict, told), dict(record.trim))
        tell_doubled(record, trim)
        return replace(record, trim=trim)


@dataclass(frozen=True, kw_only=True)
class ChannelSettings:
    """Columns of the files, their units, and what the inputs do between samples."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    check: tuple[str, ...] = ()  # measured, no outputs of the structure: shown and checked with
    time: str = "t"
    units: Mapping[str, str] = field(default_factory=dict)
    columns: Mapping[str, Column] = field(default_factory=dict)
    dt: float | None = None
    hold: Hold | None = None  # as not stated: "foh"
    mending: Mending = Mending()
    second: SecondLogger | None = None

    @property
    def measured(self) -> tuple[str, ...]:
        """Outputs and check channels."""
        return (*self.outputs, *self.check)


@dataclass(frozen=True, kw_only=True)
class AddedNoise:
    """Measurement noise that a study adds to simulated records: standard deviations, SI."""

    seed: int
    std: Mapping[str, float]


@checked_fields
@dataclass(frozen=True, kw_only=True)
class NextFlight:
    """Settings of the next flight, from a study's table ``[design]``.

    Parameters
    ----------
    duration : float
        Of the manoeuvre [s].
    sticks, rates, responses : mapping
        Limits as in `Limits`; sticks and outputs that are not named may deviate as far as in the
        study's records.
    feedback : mapping
        What holds the aircraft.
    trim : mapping
        Of a nonlinear structure, total values at which it is to be flown; the rest is what the
        records had before an input moved, moved to the nearest balance.
    settings : DesignSettings
        How inputs are designed, ``[design.settings]``; what it does not say of ``fixed``,
        ``bounds`` and ``dt`` is as in the study.
    """

    duration: float = 60.0
    sticks: Mapping[str, float] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    responses: Mapping[str, float] = field(default_factory=dict)
    feedback: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    trim: Mapping[str, float] = field(default_factory=dict)
    settings: DesignSettings = field(default_factory=DesignSettings)

    def __post_init__(self) -> None:
        check_times(duration=self.duration)
        check_deviations(self.sticks, self.rates, self.responses)

    def held(
        self, fixed: tuple[str, ...], bounds: Mapping[str, tuple[float, float]]
    ) -> DesignSettings:
        """The settings, with what a study holds fixed and in bounds where they say nothing."""
        own = self.settings
        return replace(
            own, fixed=fixed if own.fixed is None else own.fixed, bounds={**bounds, **own.bounds}
        )

    def check(self, study: "Study") -> None:
        """Refuse names that the structure of a study does not have."""
        model = study.model
        check_limited(model, (*self.sticks, *self.rates), self.responses)
        gains(self.feedback, model.inputs, model.outputs)
        check_trim(model, self.trim)
        free_of(model, self.held(study.fixed, study.bounds))


@dataclass(frozen=True, eq=False, kw_only=True)
class Study:
    """All that a study file says, checked."""

    path: Path
    title: str  # heading of the report
    output: Path  # folder of the results
    model: Model  # structure, guess and trim
    model_file: Path
    fixed: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    channels: ChannelSettings
    roles: Mapping[Role, RecordSet]  # the records' files
    noise: AddedNoise | None  # what is added to the records
    stages: tuple[Stage, ...]
    settings: Mapping[str, Any]  # by table, of stages that have one
    design: NextFlight = field(default_factory=NextFlight)
    png: bool = False  # whether figures are written as PNG beside the SVG
    responses: tuple[str, ...] = ()  # of the refinement, as the file names them
    notes: tuple[str, ...] = ()  # what is to be told with the results

    def spare(self, *names: str) -> None:
        """Refuse files in the folder of results that the study itself is read from: ValueError."""
        flown = [file for each in self.roles.values() for file in each.files]
        patterns = [pattern for each in self.roles.values() for pattern in each.patterns]
        for name in names:
            target = self.output / name
            spare(target, self.path, self.model_file, *flown)
            for pattern in patterns:
                if target.absolute().match(str(pattern.absolute())):
                    raise ValueError(
                        f"{target}, which the study writes, would be read as a flight by files = "
                        f'["{pattern}"]; name another folder for the results'
                    )

    def task(self, roles: Mapping[Role, Any], checks: Mapping[Role, Any] | None = None) -> Task:
        """What the stages work on, with these records by role, and those with check channels."""
        held: Any = {"fixed": self.fixed, "bounds": self.bounds, "settings": self.settings}
        held["hold"] = self.channels.hold
        kept = (checks or {}) if self.channels.check else {}
        return Task(model=self.model, roles=roles, checks=kept, stages=self.stages, **held)


def read_records(study: Study) -> dict[Role, tuple[Record, ...]]:
    """Records of every role: units converted, noise added, mended, cut, decimated, trim removed.

    The noise of a record depends on the study's seed and the record's name alone, so a record
    that serves in two roles is the same flight in both.

    Raises
    ------
    ValueError
        All that `read_record`, `Record.detrend` and `check_plausible` refuse.
    """
    return without_checks(study, read_flights(study)[0])


def without_checks(
    study: Study, flights: Mapping[Role, Sequence[Record]]
) -> dict[Role, tuple[Record, ...]]:
    """Records with the structure's outputs alone, as estimators take them."""
    outputs = study.channels.outputs
    return {role: tuple(r.select(outputs=outputs) for r in flights[role]) for role in flights}


def read_flights(study: Study) -> tuple[dict[Role, tuple[Record, ...]], Repeats]:
    """What `read_records` returns with check channels, and which records are the same flight."""
    _check_names(study)
    files = {file: None for each in study.roles.values() for file in each.files}
    measured = {file: _read(study, file) for file in files}
    mended = study.channels.mending.mended(
        {
            (file, role.noise): _noisy(study, measured[file]) if role.noise else measured[file]
            for role in study.roles.values()
            for file in role.files
        },
        second=() if study.channels.second is None else study.channels.second.channels,
        theta0=float(getattr(study.model, "theta0", 0.0)),
    )
    raw: dict[Role, list[Record]] = {}
    for role, each in study.roles.items():
        own = [each.cutting.of(mended[file, each.noise]) for file in each.files]
        raw[role] = [each.placed(record) for record in own]
    done: dict[Role, tuple[Record, ...]] = {}
    for role in sorted(raw, key=lambda role: study.roles[role].detrend in ROLES):
        how: Any = study.roles[role].detrend
        if how in ROLES:
            names = (*done[how][0].inputs, *done[how][0].outputs)
            how = {name: float(np.mean([r.trim[name] for r in done[how]])) for name in names}
        elif how == "none":
            how = None
        done[role] = tuple(record.detrend(how) for record in raw[role])
    every = {record.name: record for records in done.values() for record in records}
    channels = study.channels
    total = isinstance(study.model, NonlinearModel)
    stated = channels.units, channels.time if channels.dt is None else None
    learnt = without_checks(study, {"identification": done["identification"]})["identification"]
    check_plausible(learnt, tuple(every.values()), *stated, total=total)
    with placed("[pbsid]"):
        study.settings.get("pbsid", Pbsid()).check_lengths(learnt)
    with placed(f"{study.path}:"):
        examine_task(study.task(done))
    for record in measured.values():
        _tell_lost(record)
    _tell_repeats(study, measured, done)
    flown = {role: [measured[file] for file in each.files] for role, each in study.roles.items()}
    return {role: done[role] for role in ROLES if role in done}, repeats(flown)


def _tell_lost(record: Record) -> None:
    """Warn of what was not measured, though there are samples."""
    for said in (*(stretch.told() for stretch in frozen(record)), *seams_told(record)):
        warn(f"Record {record.name}: {said}")
    for name in record.outputs:
        values = record.channel(name)
        if n := longest_stop(values[np.isfinite(values)], stick=False):
            warn(f"Record {saturated(record.name, name, n, stick=False)}")


def _tell_repeats(
    study: Study, measured: Mapping[Path, Record], done: Mapping[Role, Sequence[Record]]
) -> None:
    """Warn of repeated samples that stay, also where resampling or a shift in time hide them."""
    if study.channels.mending.fresh:
        return
    whole = {role: study.roles[role].cutting.decimate == 1 for role in done}
    kept = [measured[file] for role in done if whole[role] for file in study.roles[role].files]
    thinned = [record for role in done if not whole[role] for record in done[role]]
    tell_repeats([*kept, *thinned], study.channels.outputs)


def _check_names(study: Study) -> None:
    """Refuse two files of one name: the name is what figures, tables and noise go by."""
    seen: dict[str, Path] = {}
    for file in (file for each in study.roles.values() for file in each.files):
        other = seen.setdefault(file.stem, file)
        if other.resolve() != file.resolve():
            raise ValueError(
                f"two records are called {file.stem!r}: {other} and {file}; rename one of them"
            )


def _read(study: Study, file: Path) -> Record:
    channels, second = study.channels, study.channels.second
    time = channels.time if channels.dt is None else _counted(channels, file, channels.dt)
    every = (channels.inputs, channels.measured)
    if second is None:
        return _read_channels(channels, file, *every, time)
    own = tuple(n for n in (*channels.inputs, *channels.measured) if n not in second.channels)
    first = _read_channels(channels, file, (), own, time)
    other = _read_channels(channels, second.beside(file), (), second.channels, second.time)
    first, other = (with_inputs(each, channels.inputs) for each in (first, other))
    return second.joined(first, other, fresh=channels.mending.fresh).select(*every)


def _counted(channels: ChannelSettings, file: Path, dt: float) -> float:
    """The interval [s] that a file's instants are counted at; ValueError where it has others."""
    second = () if channels.second is None else channels.second.channels
    some = tuple(name for name in channels.measured if name not in second)[:1]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # reading the channels tells them
            t = _read_channels(replace(channels, units={}), file, (), some, channels.time).t
    except ValueError:  # no such column, or no instants in it
        return dt
    if (np.abs(t - t[0] - dt * np.arange(len(t))) > dt / 2).any():
        raise ValueError(
            f"{file}: column {channels.time!r} has a sample every {np.median(np.diff(t)):g} s, "
            f"[channels] dt = {dt:g} counts other instants: leave dt out, with the column's unit "
            "in units if it is not s; or rename the column if it is no time"
        )
    return dt


def _read_channels(
    channels: ChannelSettings,
    file: Path,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    time: str | float,
) -> Record:
    """Some of the channels from one file."""
    times = () if channels.second is None else (channels.time, channels.second.time)
    elsewhere = {*channels.inputs, *channels.measured, *times} - {*inputs, *outputs, time}
    read = read_record if file.suffix.lower() in {".mat", ".parquet"} else read_csv
    return read(
        file,
        inputs={name: channels.columns.get(name, name) for name in inputs},
        outputs={name: channels.columns.get(name, name) for name in outputs},
        time=time,
        units={name: unit for name, unit in channels.units.items() if name not in elsewhere},
        hold=channels.hold or "foh",
    )


def _noisy(study: Study, record: Record) -> Record:
    """A record with the study's noise."""
    if study.noise is None:
        return record
    rng = np.random.default_rng([study.noise.seed, zlib.crc32(record.name.encode())])
    std, y = study.noise.std, []
    for names in (study.channels.outputs, study.channels.check):  # outputs have the same without
        part = {name: value for name, value in std.items() if name in names}
        y.append(record.select(outputs=names).with_noise(part, rng).y)
    return replace(record, y=np.hstack(y))
