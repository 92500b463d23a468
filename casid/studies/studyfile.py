"""Studies from TOML files, paths in which are relative to the file.

Tables: ``[study]``, ``[model]``, ``[channels]``, ``[records.ROLE]``, ``[noise]``, ``[design]`` of
the next flight, ``[bounds]`` with cases to compare and one of options for each stage, whose keys
are fields of the stage's settings.
"""

import glob
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from casid.declaration import check_pair
from casid.files import Column
from casid.free import free_parameters
from casid.frequency.response import FrequencyResponse
from casid.model import Model
from casid.record import Hold
from casid.stages.listing import STAGES
from casid.stages.refinement import OUTPUT_ERROR
from casid.stages.stage import ROLES, Role, Stage, check_task, fitting
from casid.structure.modelfile import load_model, locate_model
from casid.studies.preparation import read_cutting, read_mending, read_second, read_trim
from casid.studies.responses import read_responses, response_names
from casid.studies.settings import read_settings
from casid.studies.study import AddedNoise, ChannelSettings, NextFlight, RecordSet, Study
from casid.tables import Table, placed, read_toml

REQUIRED: tuple[Role, ...] = ("identification", "validation")


def read_study(
    path: str | Path, output: str | Path | None = None, *, stages: Sequence[Stage] = STAGES
) -> Study:
    """Read and check a study file; records are read by `read_records`.

    Parameters
    ----------
    path : path
        The TOML file.
    output : path
        Folder of the results instead of the one the file names.
    stages : sequence of Stage
        What is done: ``(*STAGES, OWN)`` adds a stage of your own.

    Raises
    ------
    ValueError, ModelError
        Not TOML, an unknown key or role, an empty role, a model file that does not import or
        whose matrices disagree in shape, a bound with lower > upper, a table no stage would read.
    """
    path = Path(path)
    top = read_toml(path)
    tables = dict.fromkeys(stage.table for stage in stages if stage.table)
    top.only(("study", "model", "channels", "records", "noise", "design", *tables))
    model, model_file, fixed, bounds = _model(top.table("model", needed=True), path.parent)
    heading = top.table("study")
    heading.only(("title", "output", "png", "notes"))
    folder = heading.take("output", str, "out")
    channels = _channels(top.table("channels"), type(model))
    noise = _noise(top.table("noise"), channels) if "noise" in top.content else None
    roles = _roles(top.table("records", needed=True), path.parent)
    _check_roles(roles, noise, type(model), path)
    flown = {role: each.files for role, each in roles.items()}
    responses = response_names(top.table("output_error"), flown, choice="choice" in top.content)
    study = Study(
        path=path,
        title=heading.take("title", str, path.stem),
        output=Path(output) if output is not None else path.parent / folder,
        model=model,
        model_file=model_file,
        fixed=fixed,
        bounds=bounds,
        channels=channels,
        roles=roles,
        noise=noise,
        stages=fitting(model, stages, top.content),
        settings=_settings(top, stages, read_responses(responses, path.parent, model)),
        responses=responses,
        design=read_settings(top.table("design"), NextFlight()),
        png=heading.take("png", bool, False),
        notes=heading.names("notes"),
    )
    with placed(f"{path}:"):  # before any record is read, what the stages would refuse
        check_task(study.task(flown))
    with placed(f"{path}: [design]"):
        study.design.check(study)
    return study


def _model(
    table: Table, folder: Path
) -> tuple[Model, Path, tuple[str, ...], dict[str, tuple[float, float]]]:
    table.only(("file", "trim", "values", "bounds", "fixed"))
    reference = table.take("file", str)
    if reference is None:
        raise ValueError(f'{table.place} file = "path/to/file.py:ClassName" is missing')
    structure = load_model(reference, folder)
    infos = structure.infos()
    trim, values = table.numbers("trim"), table.numbers("values")
    plain = [f.name for f in fields(structure) if f.name not in infos]
    Table(trim, f"{table.place} trim:").only(plain)
    Table(values, f"{table.place} values:").only(infos)
    for name, value in (trim | values).items():
        if not np.isfinite(value):
            raise ValueError(f"{table.place} {name} = {value}, expected a finite number")
    limits = table.table("bounds")
    limits.only(infos)
    bounds = {name: limits.pair(name, "[lower, upper]") for name in limits.content}
    fixed = table.names("fixed")
    with placed(limits.place):
        for name, pair in bounds.items():
            check_pair(name, pair)
    for name, value in values.items():
        low, high = bounds.get(name, (infos[name].lower, infos[name].upper))
        if not low <= value <= high:
            raise ValueError(
                f"{table.place} {name} = {value:g} lies outside its bounds [{low:g}, {high:g}]; "
                "move the value or the bound"
            )
    model = replace(structure(), **trim, **values)
    with placed(table.place):
        model.system()
        free_parameters(model, fixed, bounds)
    return model, locate_model(reference, folder)[0], fixed, bounds


def _channels(table: Table, structure: type[Model]) -> ChannelSettings:
    own = ("inputs", "outputs", "check", "time", "units", "columns", "dt", "hold")
    table.only((*own, "shift", "outliers", "repeats", "join"))
    inputs = table.names("inputs", structure.inputs)
    outputs = table.names("outputs", structure.outputs)
    wanted = (("inputs", inputs, structure.inputs), ("outputs", outputs, structure.outputs))
    for kind, given, named in wanted:
        if given != named:
            raise ValueError(
                f"{table.place} {kind} are {', '.join(given)}, those of {structure.__name__} are "
                f"{', '.join(named)}; name the same ones in the same order, or leave the key out"
            )
    check = table.names("check")
    if wrong := [name for name in check if name in {*inputs, *outputs} or check.count(name) > 1]:
        raise ValueError(
            f"{table.place} check: {wrong[0]!r} is an input or output, or stands twice; name "
            "channels that are measured beside those of the structure"
        )
    if {"time", "dt"} <= {*table.content}:
        raise ValueError(
            f"{table.place} states time and dt: instants are read from a column, or counted at an "
            "interval where the files have none; leave one out"
        )
    units = table.table("units")
    columns = table.table("columns")
    hold = table.content.get("hold")
    if hold not in (None, *get_args(Hold)):
        one = ", one for all inputs" * isinstance(hold, dict)
        raise ValueError(f'{table.place} hold = {hold!r}, expected "foh" or "zoh"{one}')
    return ChannelSettings(
        inputs=inputs,
        outputs=outputs,
        check=check,
        time=table.take("time", str, "t"),
        units={name: units.take(name, str) for name in units.content},
        columns={name: _column(columns, name) for name in columns.content},
        dt=table.take("dt", (int, float)),
        hold=cast(Hold | None, hold),
        mending=read_mending(table),
        second=read_second(table.table("join"), (*inputs, *outputs, *check)),
    )


def _column(table: Table, name: str) -> Column:
    match table.take(name, (list, str, dict)):
        case [str(variable), int(column)]:
            return variable, column
        case str(column):
            return column
        case {**factors} if factors:
            return table.numbers(name)
        case value:
            raise ValueError(
                f'{table.place} {name} = {value!r}, expected "column", ["variable", column] or '
                "{ column = factor, ... }"
            )


def _roles(table: Table, folder: Path) -> dict[Role, RecordSet]:
    table.only(ROLES)
    for role in REQUIRED:
        if role not in table.content:
            raise ValueError(
                f"{table.place} role {role!r} is missing; "
                f'write [records.{role}] with files = ["..."]'
            )
    roles: dict[Role, RecordSet] = {
        role: _role(table.table(role), folder) for role in ROLES if role in table.content
    }
    trims = {str(role): each.detrend for role, each in roles.items()}
    for role, each in roles.items():
        if each.detrend in ROLES and trims.get(each.detrend, each.detrend) in ROLES:
            raise ValueError(
                f"{table.place} {role} takes its trim from role {each.detrend!r}, which "
                "must be given and have a trim of its own"
            )
    return roles


def _role(table: Table, folder: Path) -> RecordSet:
    table.only(("files", "detrend", "noise", "decimate", "cut", "resample", "trim"))
    files: list[Path] = []
    for pattern in table.names("files"):
        found = sorted(glob.glob(pattern, root_dir=folder))  # noqa: PTH207 - absolute patterns too
        if not found:
            raise ValueError(f"{table.place} no file matches {pattern!r} in {folder.resolve()}")
        files += [folder / name for name in found if folder / name not in files]
    if not files:
        raise ValueError(f'{table.place} the role is empty; give it files = ["..."]')
    detrend = table.take("detrend", str, "first")
    if detrend not in (known := ("first", "mean", "none", *ROLES)):
        raise ValueError(f"{table.place} detrend = {detrend!r}, expected one of {', '.join(known)}")
    decimate = table.take("decimate", int, 1)
    if decimate < 1:
        raise ValueError(f"{table.place} decimate = {decimate}, expected 1 or more")
    noise = table.take("noise", bool, False)
    cutting = read_cutting(table, decimate)
    Table(cutting.cuts, f"{table.place} cut:").only(file.stem for file in files)
    trim = read_trim(table, [file.stem for file in files])
    patterns = tuple(folder / pattern for pattern in table.names("files"))
    return RecordSet(
        files=tuple(files),
        patterns=patterns,
        detrend=detrend,
        trim=trim,
        noise=noise,
        cutting=cutting,
    )


def _noise(table: Table, channels: ChannelSettings) -> AddedNoise:
    table.only(("seed", "std"))
    seed = table.take("seed", int)
    if seed is None or seed < 0:
        raise ValueError(f"{table.place} seed = {seed}, expected an integer >= 0")
    std = table.numbers("std")
    table.table("std").only(channels.measured)
    if wrong := [name for name, value in std.items() if not 0 <= value < np.inf]:
        raise ValueError(
            f"{table.place} std of {wrong[0]} is {std[wrong[0]]:g}, expected a finite number, "
            "0 or more"
        )
    return AddedNoise(seed=seed, std=std)


def _check_roles(
    roles: Mapping[Role, RecordSet], noise: AddedNoise | None, structure: type[Model], path: Path
) -> None:
    """Refuse noise that nothing says, trims of what the structure lacks, or that are no numbers."""
    noisy = [role for role, each in roles.items() if each.noise]
    if noisy and noise is None:
        raise ValueError(f"{path}: role {noisy[0]!r} wants noise, but there is no table [noise]")
    known = (*structure.states, *structure.inputs, *structure.outputs)
    for role, each in roles.items():
        for name, value in (pair for trim in each.trim.values() for pair in trim.items()):
            place = f"{path}: [records.{role}] trim:"
            Table({name: value}, place).only(known)
            if not np.isfinite(value):
                raise ValueError(f"{place} {name} = {value}, expected a finite number")


def _settings(
    top: Table, stages: Sequence[Stage], responses: Sequence[FrequencyResponse]
) -> dict[str, Any]:
    """Settings of the stages whose tables there are, and of their defaults nothing."""
    own = {stage.table: stage for stage in stages if stage.table in top.content}
    found = {}
    for name, stage in own.items():
        table, defaults = top.table(name), stage.settings
        if name == OUTPUT_ERROR.table:
            rest = {key: value for key, value in table.content.items() if key != "responses"}
            table, defaults = Table(rest, table.place), replace(defaults, responses=responses)
        found[name] = read_settings(table, defaults, stage.given)
    return found
