"""Studies from TOML files.

Paths in the file are relative to the file. Tables: ``[study]``, ``[model]``, ``[channels]``,
``[records.ROLE]``, ``[noise]``, ``[bounds]`` with cases to compare and one of options for each
stage, whose keys are the keyword arguments of the stage's function.
"""

import glob
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from types import NoneType
from typing import Any, cast, get_args, get_origin, get_type_hints

import numpy as np

from casid.arrays import Array
from casid.baseline.derivid import Derivid
from casid.bounds.cases import read_cases
from casid.bounds.trials import ESTIMATORS
from casid.errors import ModelError
from casid.files import Column
from casid.frequency.estimation import frequency_response
from casid.matching.match import Match
from casid.model import Bounds, Model, free_parameters
from casid.record import Hold
from casid.shooting.output_error import OutputError
from casid.structure.modelfile import load_model, locate_model
from casid.studies.study import ROLES, Channels, Noise, RecordSet, Role, Study
from casid.subspace.pbsid import pbsid
from casid.tables import Table, read_toml

REQUIRED: tuple[Role, ...] = ("identification", "validation")

STAGES: Mapping[str, Callable[..., Any]] = {
    "pbsid": pbsid,
    "frequency": frequency_response,
    "match": Match,
    "output_error": OutputError,
    "derivid": Derivid,
}
# What the study itself gives to a stage is no option of it.
GIVEN = {"records", "norm", "solver"}
MOST_POINTS = 10_000  # of a grid: a matching problem of millions of unknowns
TARGETS = ("black box", "frequency response")
SOLVER = ("tolerance", "max_iterations", "max_seconds", "ipopt")


def read_study(path: str | Path, output: str | Path | None = None) -> Study:
    """Read and check a study file; records are read by `read_records`.

    Parameters
    ----------
    path : path
        The TOML file.
    output : path
        Folder of the results instead of the one the file names.

    Raises
    ------
    ValueError, ModelError
        Not TOML, an unknown key or role, an empty role, a model file that does not import or
        whose matrices disagree in shape, a bound with lower > upper.
    """
    path = Path(path)
    top = read_toml(path)
    top.only(("study", "model", "channels", "records", "noise", "bounds", *STAGES))
    model, model_file, fixed, bounds = _model(top.table("model", needed=True), path.parent)
    heading = top.table("study")
    heading.only(("title", "output"))
    folder = heading.take("output", str, "out")
    options, solver = _options(top)
    noise = _noise(top.table("noise"), type(model)) if "noise" in top.content else None
    roles = _roles(top.table("records", needed=True), path.parent)
    _check_noise(roles, noise, path)
    return Study(
        path=path,
        title=heading.take("title", str, path.stem),
        output=Path(output) if output is not None else path.parent / folder,
        model=model,
        model_file=model_file,
        fixed=fixed,
        bounds=bounds,
        channels=_channels(top.table("channels"), type(model)),
        roles=roles,
        noise=noise,
        options=options,
        solver=solver,
        targets=_targets(top.table("match"), roles),
        comparison=_comparison(top, model, fixed, bounds),
    )


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
    bounds = {name: _pair(limits, name) for name in limits.content}
    fixed = table.names("fixed")
    for name, value in values.items():
        low, high = bounds.get(name, (infos[name].lower, infos[name].upper))
        if not low <= value <= high:
            raise ValueError(
                f"{table.place} {name} = {value:g} lies outside its bounds [{low:g}, {high:g}]; "
                "move the value or the bound"
            )
    model = replace(structure(), **trim, **values)
    try:
        model.system()
        free_parameters(model, fixed, bounds)
    except ModelError as error:
        raise ModelError(f"{table.place} {error}") from error
    return model, locate_model(reference, folder)[0], fixed, bounds


def _pair(table: Table, name: str) -> tuple[float, float]:
    value = table.take(name, list)
    numeric = all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    if len(value) != 2 or not numeric:
        raise ValueError(f"{table.place} {name} = {value!r}, expected [lower, upper]")
    return float(value[0]), float(value[1])


def _channels(table: Table, structure: type[Model]) -> Channels:
    table.only(("inputs", "outputs", "time", "units", "columns", "dt", "hold"))
    inputs = table.names("inputs", structure.inputs)
    outputs = table.names("outputs", structure.outputs)
    wanted = (("inputs", inputs, structure.inputs), ("outputs", outputs, structure.outputs))
    for kind, given, own in wanted:
        if given != own:
            raise ValueError(
                f"{table.place} {kind} are {', '.join(given)}, those of {structure.__name__} are "
                f"{', '.join(own)}; name the same ones in the same order, or leave the key out"
            )
    units = table.table("units")
    columns = table.table("columns")
    hold = table.take("hold", str, "foh")
    if hold not in get_args(Hold):
        raise ValueError(f'{table.place} hold = {hold!r}, expected "foh" or "zoh"')
    return Channels(
        inputs=inputs,
        outputs=outputs,
        time=table.take("time", str, "t"),
        units={name: units.take(name, str) for name in units.content},
        columns={name: _column(columns, name) for name in columns.content},
        dt=table.take("dt", (int, float)),
        hold=cast(Hold, hold),
    )


def _column(table: Table, name: str) -> Column:
    match table.take(name, (list, str)):
        case [str(variable), int(column)]:
            return variable, column
        case str(column):
            return column
        case value:
            raise ValueError(
                f'{table.place} {name} = {value!r}, expected "column" or ["variable", column]'
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
    table.only(("files", "detrend", "noise", "decimate"))
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
    return RecordSet(files=tuple(files), detrend=detrend, noise=noise, decimate=decimate)


def _noise(table: Table, structure: type[Model]) -> Noise:
    table.only(("seed", "std"))
    seed = table.take("seed", int)
    if seed is None or seed < 0:
        raise ValueError(f"{table.place} seed = {seed}, expected an integer >= 0")
    std = table.numbers("std")
    table.table("std").only(structure.outputs)
    if wrong := [name for name, value in std.items() if not 0 <= value < np.inf]:
        raise ValueError(
            f"{table.place} std of {wrong[0]} is {std[wrong[0]]:g}, expected a finite number, "
            "0 or more"
        )
    return Noise(seed=seed, std=std)


def _check_noise(roles: Mapping[Role, RecordSet], noise: Noise | None, path: Path) -> None:
    noisy = [role for role, each in roles.items() if each.noise]
    if noisy and noise is None:
        raise ValueError(f"{path}: role {noisy[0]!r} wants noise, but there is no table [noise]")


def _comparison(top: Table, model: Model, fixed: tuple[str, ...], bounds: Bounds) -> dict[str, Any]:
    """Estimator and cases of a comparison of bounds."""
    if "bounds" not in top.content:
        return {}
    table = top.table("bounds")
    table.only(("estimator", "norm", "cases"))
    estimator = table.take("estimator", str, "output_error")
    if estimator not in ESTIMATORS:
        raise ValueError(
            f"{table.place} estimator = {estimator!r}, expected one of {', '.join(ESTIMATORS)}"
        )
    cases = dict(table.table("cases", needed=True).content)
    try:
        read_cases(model, cases, fixed, bounds)
    except ModelError as error:
        raise ModelError(f"{table.place} {error}") from error
    norm = {"norm": table.take("norm", str, "hinf")} if estimator == "match" else {}
    return {"estimator": estimator, "cases": cases, "settings": norm}


# ---- options of the stages ----------------------------------------------------------------------


def _targets(table: Table, roles: Mapping[Role, RecordSet]) -> tuple[str, ...]:
    targets = table.names("targets", TARGETS[:1])
    if TARGETS[0] not in targets or not set(targets) <= set(TARGETS):
        raise ValueError(
            f"{table.place} targets = {list(targets)}, expected {TARGETS[0]!r} and perhaps "
            f"{TARGETS[1]!r}"
        )
    if TARGETS[1] in targets and "frequency" not in roles:
        raise ValueError(f"{table.place} {TARGETS[1]!r} needs records: write [records.frequency]")
    return targets


def _options(top: Table) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, Any]]]:
    options, solver = {}, {}
    for stage, function in STAGES.items():
        if stage not in top.content:
            continue
        table = top.table(stage)
        parameters = inspect.signature(function).parameters.values()
        keywords = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.name not in GIVEN]
        solves = "solver" in (p.name for p in parameters)
        own = (*(("solver",) if solves else ()), *(("targets",) if stage == "match" else ()))
        table.only((*keywords, *own))
        hints = get_type_hints(function)
        options[stage] = {
            name: _value(table, name, hints[name]) for name in table.content if name not in own
        }
        if "solver" in table.content:
            solver[stage] = _solver(table.table("solver"))
    return options, solver


def _solver(table: Table) -> dict[str, Any]:
    table.only(SOLVER)
    for name, kind, least in (
        ("tolerance", (int, float), 1e-15),
        ("max_iterations", int, 1),
        ("max_seconds", (int, float), 1e-3),
    ):
        value = table.take(name, kind, least)
        if not least <= value < np.inf:
            raise ValueError(f"{table.place} {name} = {value}, expected at least {least:g}")
    table.table("ipopt")
    return dict(table.content)


def _value(table: Table, name: str, hint: Any) -> Any:  # noqa: ANN401 - whatever the stage takes
    if name == "omega":
        return _grid(table, table.content[name])
    kinds = {get_origin(kind) or kind for kind in (get_args(hint) or (hint,))}
    if kinds <= {int, float, bool, NoneType}:  # what is no plain number, the stage checks
        wanted = kinds - {NoneType} | ({int} if float in kinds else set())
        table.take(name, tuple(sorted(wanted, key=str)))
    return _frozen(table.content[name])


def _frozen(value: Any) -> Any:  # noqa: ANN401
    """Lists as tuples; a table of numbers as an array."""
    if not isinstance(value, list):
        return value
    rows = [row for row in value if isinstance(row, list)]
    if rows and all(isinstance(x, int | float) for row in rows for x in row):
        return np.asarray(value, dtype=float)
    return tuple(_frozen(item) for item in value)


def _grid(table: Table, value: Any) -> Array:  # noqa: ANN401
    """Frequencies [rad/s]: a list, or {from, to, points} spaced logarithmically."""
    if isinstance(value, dict):
        inner = table.table("omega")
        inner.only(("from", "to", "points"))
        low, high = (inner.take(key, (int, float)) for key in ("from", "to"))
        points = inner.take("points", int, 40)
        if low is None or high is None or not 0 < low < high < np.inf:
            raise ValueError(f"{table.place} omega = {value!r}, expected 0 < from < to")
        if not 2 <= points <= MOST_POINTS:
            raise ValueError(f"{table.place} points = {points}, expected 2, at most {MOST_POINTS}")
        return np.geomspace(low, high, points)
    numeric = isinstance(value, list) and all(isinstance(x, int | float) for x in value)
    grid = np.asarray(value if numeric else [], dtype=float)
    if not len(grid) or not ((grid > 0) & np.isfinite(grid)).all():
        raise ValueError(
            f"{table.place} omega = {value!r}, expected frequencies > 0 in a list or "
            "{from = 0.5, to = 12, points = 40}"
        )
    return grid
