"""Commands about records and structures: inspect, simulate, new-model."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from casid.channels import CONTROLS, UNITS
from casid.checks import check_known
from casid.commands.columns import (
    COLUMN,
    HOLD,
    MODEL,
    TIME,
    TIME_COLUMN,
    UNIT,
    refuse_beside_study,
)
from casid.commands.conversion import files_of, hold_of, load_fit
from casid.commands.inspection import Inspection, RecordFacts, inspect_records, unit_advice
from casid.commands.scaffold import new_model
from casid.commands.terminal import exits, new_table
from casid.consistency.kinematics import KinematicCheck
from casid.display import counted
from casid.exchange import formats
from casid.folder import check_target
from casid.model import Model
from casid.record import Hold, Record
from casid.report.tables import cells
from casid.slow_sources import repeats_known
from casid.structure.modelfile import load_model
from casid.studies.study import read_flights
from casid.studies.studyfile import read_study
from casid.validation import validate


def _names(_: click.Context, __: click.Parameter, value: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (value or "").split(",") if name.strip())


WRITTEN = "Write inputs, measured and simulated outputs (p, p_sim) as .csv, .mat or .parquet."


@click.command("inspect")
@click.argument("sources", nargs=-1, required=True, metavar="RECORD...|STUDY.toml")
@click.option(
    "--inputs",
    callback=_names,
    metavar="A,B,...",
    help="Columns that are inputs; those of the model, or col, lat, lon and ped, unless given.",
)
@click.option(
    "--outputs",
    callback=_names,
    metavar="A,B,...",
    help="Columns that are outputs; those of the model, or all others, unless given.",
)
@MODEL
@UNIT
@COLUMN
@TIME
def inspect_command(
    sources: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    structure: str | None,
    units: dict[str, str],
    renamed: dict[str, str],
    time: str,
) -> None:
    """Show what records hold, and say whether a model could be identified from them.

    Channels and their units, sampling and gaps, where the power lies (frequencies below which 5, 50
    and 95 % of it lie), correlation of the inputs, saturation, noise; whether rates, attitudes,
    specific forces and velocities agree with each other; with --model, whether the parameters can
    be told apart. Nothing is fitted. RECORD is .csv, .mat or .parquet; of a study the records of
    identification are taken, as the study reads them, with its check channels.
    """
    with exits() as console:
        first, *others = sources
        if first.endswith(".toml"):
            if others:
                raise ValueError("a study says which records, channels and units: name it alone")
            refuse_beside_study(
                inputs=inputs,
                outputs=outputs,
                model=structure,
                unit=units,
                column=renamed,
                time=time != TIME_COLUMN,
            )
            study = read_study(Path(first))
            with repeats_known():  # the advice names them, one by one
                records: Sequence[Record] = read_flights(study)[0]["identification"]
            model: Model | None = study.model
            held: Any = {"fixed": study.fixed, "bounds": study.bounds}
            named: Any = {"time": study.channels.time, "stated": study.channels.units}
            found = inspect_records(records, model=model, **held, **named)
        else:
            model = None if structure is None else load_model(structure)()
            records = _records(sources, model, (inputs, outputs), units, renamed, time)
            found = inspect_records(records, model=model, time=time, stated=units)
        _show(console, found)


def _records(
    sources: Sequence[str],
    model: Model | None,
    channels: tuple[tuple[str, ...], tuple[str, ...]],
    units: Mapping[str, str],
    renamed: Mapping[str, str],
    time: str,
) -> list[Record]:
    inputs, outputs = channels
    taken = {column: name for name, column in renamed.items()}
    found = formats.read_table(sources[0])
    check_known(f"{sources[0]}: no column", taken, found)
    columns = [taken.get(name, name) for name in found if name != time]
    if not inputs:
        known = CONTROLS if model is None else model.inputs
        inputs = tuple(name for name in known if name in columns or model is not None)
    if not inputs:
        raise ValueError(
            f"{sources[0]}: which columns are inputs? Name them, --inputs A,B; there are "
            + ", ".join(columns)
        )
    if not outputs:
        known = tuple(name for name in columns if name not in inputs)
        extra = [name for name in ("u", "v", "w") if name in columns]
        outputs = known if model is None else tuple(dict.fromkeys((*model.outputs, *extra)))
    return [
        formats.read_record(
            source,
            inputs={name: renamed.get(name, name) for name in inputs},
            outputs={name: renamed.get(name, name) for name in outputs},
            time=time,
            units=units,
        )
        for source in sources
    ]


def _show(console: Console, found: Inspection) -> None:
    for facts in found.records:
        console.print(_channel_table(facts, found.inputs), "")
    console.print(Text("5 %, 50 %, 95 %: that share of the power lies below these frequencies.\n"))
    if len(found.inputs) > 1:
        console.print(_correlation_table(found), "")
    if found.kinematics.channels:
        console.print(kinematics_table(found.kinematics), "")
    for note in found.kinematics.notes:
        console.print(Text(f"note: {note}"))
    if found.excitation is not None:
        console.print(Text(f"Excitation: {found.excitation.headline()}"))
    if found.identifiability is not None:
        told = str(found.identifiability).splitlines()[0]
        can = "can" if found.usable else "cannot"
        console.print(Text(f"Identifiability: {told}; the records {can} tell all parameters apart"))
    _advise(console, found.advice)
    if not found.advice:
        console.print("Nothing is in the way of an identification.")


def _advise(console: Console, advice: Sequence[str]) -> None:
    for said in advice:
        console.print(Text(f"- {said}", style="yellow"))


def _channel_table(facts: RecordFacts, inputs: Sequence[str]) -> Table:
    even = "" if facts.equidistant else ", not equidistant"
    gaps = f", {counted(len(facts.gaps), 'gap')}" if facts.gaps else ""
    lacking = any(each.missing for each in facts.channels)
    title = (
        f"{facts.name}: {facts.samples} samples in {facts.duration:.5g} s, every "
        f"{facts.interval:.4g} s{even}{gaps}; quiet for {facts.quiet:.3g} s"
    )
    headings = ["", "unit", "lowest", "highest", "std", "noise", "5 %", "50 %", "95 % [rad/s]"]
    table = new_table(title, "channel", *headings, *(["missing"] if lacking else []))
    for each in facts.channels:
        numbers = [f"{value:.4g}" for value in (each.lowest, each.highest)]
        numbers += [f"{value:.2g}" for value in (each.deviation, each.noise)]
        band = [f"{omega:.3g}" if np.isfinite(omega) else "-" for omega in each.band]
        missing = [f"{each.missing:.1%}" if each.missing else ""] if lacking else []
        kind = "in" if each.name in inputs else "out"
        table.add_row(Text(each.name), kind, each.unit, *numbers, *band, *missing)
    return table


def _correlation_table(found: Inspection) -> Table:
    table = new_table("Correlation of inputs", "", *found.inputs)
    for name, row in zip(found.inputs, found.correlation, strict=True):
        table.add_row(Text(name), *(f"{x:+.2f}" if np.isfinite(x) else "-" for x in row))
    return table


def kinematics_table(found: KinematicCheck) -> Table:
    """Scale, skew and bias of each rate and specific force, for the terminal."""
    heading, rows = cells(found)
    table = new_table("Kinematic consistency", *heading)
    for each, row in zip(found.channels, rows, strict=True):
        table.add_row(*row, style="yellow" if each.remarks else None)
    return table


@click.command()
@click.argument("fit", metavar="FIT.json")
@click.argument("record", metavar="RECORD")
@MODEL
@UNIT
@COLUMN
@TIME
@click.option(
    "--detrend",
    type=click.Choice(["first", "mean", "none"]),
    default="first",
    show_default=True,
    help="Trim that is removed first: the mean before an input moves, the mean, or nothing.",
)
@HOLD
@click.option("--output", "-o", metavar="FILE", help=WRITTEN)
def simulate(
    fit: str,
    record: str,
    structure: str | None,
    units: dict[str, str],
    renamed: dict[str, str],
    time: str,
    detrend: str,
    hold: Hold | None,
    output: str | None,
) -> None:
    """Simulate a fitted model with the inputs of a record, and measure what it misses.

    Initial state and constant biases are estimated from the record, parameters are not, nor biases
    that the fit was without. A model that grows too much over it is predicted piece by piece
    instead, which the output then says. Theil's coefficient is 0 for a perfect prediction, 1 for a
    useless one.
    """
    with exits() as console:
        flying = load_fit(Path(fit), structure)
        model, hold = flying.model, hold or hold_of(flying)
        if output is not None:
            check_target(output, record, fit, *files_of(structure))
        how: Any = None if detrend == "none" else detrend
        names: Any = {
            kind: {name: renamed.get(name, name) for name in getattr(model, kind)}
            for kind in ("inputs", "outputs")
        }
        names |= {"time": time, "units": units, "detrend": how, "hold": hold}
        flown = formats.read_record(record, **names)
        found = validate({"model": model}, [flown])
        title = f"{type(model).__name__} on {flown.name}, {flown.duration:.5g} s"
        table = new_table(title, "output", "rms error", "unit", "fit [%]", "Theil")
        for i, name in enumerate(found.outputs):
            numbers = (found.rms, found.fit, found.theil)
            rms, fitted, theil = (float(each["model"][0, i]) for each in numbers)
            cells = (f"{rms:.3g}", UNITS.get(name, ""), f"{fitted:.1f}", f"{theil:.3f}")
            table.add_row(Text(name), *cells)
        console.print(table, "")
        if found.predicted:
            console.print(Text(found.predicted, style="yellow"), soft_wrap=True)
        _advise(console, unit_advice([flown], time, units))
        if output is not None:
            formats.write_table(output, _histories(flown, found.simulated["model"][0]))
            console.print(Text(f"Time histories: {output}"), soft_wrap=True)


def _histories(record: Record, simulated: np.ndarray) -> dict[str, Any]:
    columns = {"t": record.t} | record.totals()
    for name, y in zip(record.outputs, simulated.T, strict=True):
        columns[f"{name}_sim"] = y + record.trim.get(name, 0.0)
    return columns


@click.command("new-model")
@click.argument("name")
def new_model_command(name: str) -> None:
    """Write NAME.py, a small structure with comments, to be changed into yours.

    my_roll becomes my_roll.py with the class MyRoll. A file that is there is never overwritten.
    """
    with exits() as console:
        path, structure = new_model(name)
        told = f"{path}: look at it with  casid check {path}:{structure}"
        console.print(Text(told), soft_wrap=True)
