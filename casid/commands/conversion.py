"""The command that turns records, responses and fits into files of other formats."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import click
import numpy as np
from rich.text import Text

from casid.commands.columns import HOLD, MODEL, UNIT
from casid.commands.terminal import exits
from casid.display import counted
from casid.exchange import formats
from casid.exchange.code import write_c, write_fmu
from casid.exchange.equations import equations_of
from casid.exchange.listing import write_equations
from casid.exchange.standalone import write_module
from casid.exchange.stepping import usual_steps
from casid.fit import AnyFit, Fit, is_fit
from casid.folder import check_target, spare
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.nonlinear.model import NonlinearModel
from casid.record import Hold
from casid.structure.imports import structure_files
from casid.structure.modelfile import load_model, locate_model
from casid.textfile import read_json


@click.command()
@click.argument("source", metavar="FROM")
@click.argument("target", metavar="TO")
@UNIT
@MODEL
@click.option(
    "--mat-version",
    type=click.Choice(get_args(formats.MatVersion)),
    help="Version of the .mat file of a record, 5 unless given.",
)
@click.option("--dt", type=float, help="Sampling interval [s] of a fit written as .c.")
@click.option("--pade", type=int, help="Order of the delays' approximation in .fmu, .m.")
@click.option("--steps", type=int, help="Runge-Kutta steps per interval of a nonlinear .c.")
@HOLD
def convert(
    source: str,
    target: str,
    units: dict[str, str],
    structure: str | None,
    mat_version: formats.MatVersion | None,
    dt: float | None,
    pade: int | None,
    steps: int | None,
    hold: Hold | None,
) -> None:
    """Turn a file into another format; suffixes say which. TO is replaced if it is there.

    \b
    FROM                                   TO
    record .csv .mat (5 to 7.3) .parquet   .csv .mat .parquet
    frequency response .json               .json .csv .mat      (stages/frequency.json of a study)
    fit .json, with --model                .mat, .m (dx/dt and y), .py (simulates with NumPy alone;
                                           dx/dt and y if nonlinear), .fmu (FMI 3.0), .c (steps the
                                           model, with --dt)

    Parquet and version 7.3 need: pip install 'casid[tables]'. Of a record all columns are taken,
    whether inputs or outputs; --unit turns one into SI on the way.
    """  # noqa: D301
    with exits() as console:
        check_target(target, source)
        stepping = {"--dt": dt, "--pade": pade, "--steps": steps, "--hold": hold}
        table: dict[str, Any] = {"--unit": units, "--mat-version": mat_version}
        if Path(source).suffix.lower() == ".json":
            _refuse(source, "whose numbers are in SI already", table)
            done = _convert_result(Path(source), Path(target), structure, stepping)
        else:
            _refuse(source, "a record", {"--model": structure, **stepping})
            if Path(target).suffix.lower() != ".mat":
                _refuse(target, "which is no .mat", {"--mat-version": mat_version})
            columns = formats.in_si(formats.read_table(source), units)
            formats.write_table(target, columns, version=mat_version or "5")
            done = f"{len(next(iter(columns.values())))} samples of {', '.join(columns)}"
        console.print(Text(f"{target}: {done}"), soft_wrap=True)


# Options that say something about a fit in a format, and those about one kind of fit only.
TAKEN = {".m": ("--pade",), ".fmu": ("--pade",), ".c": ("--dt", "--hold")}
LINEAR = {".py": ("--hold",)}
NONLINEAR = {".py": ("--pade",), ".c": ("--steps",)}


def _refuse(path: str | Path, kind: str, given: Mapping[str, Any]) -> None:
    """Refuse options that say nothing about a file: ValueError."""
    if wrong := [name for name, value in given.items() if value not in (None, {})]:
        raise ValueError(f"{wrong[0]} does not apply to {path}, {kind}; leave it out")


def _convert_result(
    source: Path, target: Path, structure: str | None, given: Mapping[str, Any]
) -> str:
    if not is_fit(read_json(source)):
        _refuse(source, "a response", {"--model": structure, **given})
        response = FrequencyResponse.load(source)
        formats.write_frequency(target, response)
        return f"{len(response.omega)} frequencies, {counted(len(response.outputs), 'output')}"
    fit = load_fit(source, structure)
    spare(target, *files_of(structure))
    if target.suffix not in FITS:
        *some, last = FITS
        known = f"{', '.join(some)} or {last}"
        raise ValueError(f"{target}: a fit becomes {known}, not {target.suffix!r}")
    kind, own = "a linear fit", LINEAR
    if isinstance(fit.model, NonlinearModel):
        kind, own = "a nonlinear fit", NONLINEAR
    taken = {each for table in (TAKEN, own) for each in table.get(target.suffix, ())}
    _refuse(target, kind, {name: value for name, value in given.items() if name not in taken})
    told = f"{type(fit.model).__name__} after {fit.method}"
    return told + FITS[target.suffix](target, fit, told, given)


def _mat(target: Path, fit: AnyFit, _: str, __: Mapping[str, Any]) -> str:
    formats.write_fit_mat(target, fit)
    return ", linear at its reference condition" * isinstance(fit.model, NonlinearModel)


def _equations(target: Path, fit: AnyFit, told: str, given: Mapping[str, Any]) -> str:
    found = equations_of(_system(fit), given["--pade"], fit.units)
    write_equations(target, found, title=told)
    return ""


def _module(target: Path, fit: AnyFit, told: str, given: Mapping[str, Any]) -> str:
    if isinstance(fit.model, NonlinearModel):
        return _equations(target, fit, told, given)
    hold = given["--hold"] or hold_of(fit)
    write_module(target, fit.model.system(), hold=hold, title=told, units=fit.units)
    return HELD[hold]


def _fmu(target: Path, fit: AnyFit, _: str, given: Mapping[str, Any]) -> str:
    write_fmu(target, _system(fit), pade=given["--pade"], units=fit.units)
    return ""


def _c(target: Path, fit: AnyFit, _: str, given: Mapping[str, Any]) -> str:
    if (dt := given["--dt"]) is None:
        raise ValueError("C source steps at one interval: give it, --dt 0.02")
    steps, hold = given["--steps"], given["--hold"] or hold_of(fit)
    if steps is None and isinstance(fit.model, NonlinearModel) and 0 < dt < np.inf:
        steps = usual_steps(fit.model, dt, getattr(fit.notes, "covered", None))
    write_c(target, _system(fit), dt=dt, hold=hold, steps=steps, units=fit.units)
    return HELD[hold]


HELD = {"zoh": ", inputs held between samples", "foh": ", inputs in straight lines"}
FITS = {".mat": _mat, ".m": _equations, ".py": _module, ".c": _c, ".fmu": _fmu}


def _system(fit: AnyFit) -> StateSpace | NonlinearModel:
    """What a fit is written as: a nonlinear structure itself."""
    return fit.model if isinstance(fit.model, NonlinearModel) else fit.model.system()


def hold_of(fit: AnyFit) -> Hold:
    """What inputs did between the samples of a fit's records, straight lines if nothing says so."""
    return getattr(fit.notes, "hold", None) or "foh"


def load_fit(source: Path, structure: str | None) -> AnyFit:
    """A fit with the structure that it is of."""
    if structure is None:
        raise ValueError(f"{source} is a fit: name its structure, --model models/six_dof.py:SixDof")
    return Fit.load(source, model=load_model(structure))


def files_of(structure: str | None) -> Sequence[Path]:
    """A structure's file and those of the user's that it imports."""
    return [] if structure is None else list(structure_files(locate_model(structure)[0]))
