"""Command about logs: import."""

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import click
import numpy as np
from rich.console import Console
from rich.text import Text

from casid.channels import UNITS
from casid.commands.columns import COLUMN, UNIT
from casid.commands.terminal import caution, exits, new_table
from casid.consistency.alignment import moves_told
from casid.display import counted
from casid.excitations import Excitation
from casid.logs.drafting import Draft, import_log
from casid.logs.reading import read_log
from casid.logs.topics import Log
from casid.record import Hold

SHOWN = 1e-3  # s of delay between topics that are told


@click.command("import")
@click.argument("log", metavar="LOG")
@click.option("--model", metavar="MODEL.py:CLASS", help="Structure; one is written unless given.")
@COLUMN
@UNIT
@click.option("--dt", type=float, help="Sampling interval of the records [s].")
@click.option(
    "--hold",
    type=click.Choice(get_args(Hold)),
    help="What inputs did between samples, lines or steps; as they look unless given.",
)
@click.option("--output", "-o", metavar="FOLDER", help="Where to write; LOG's name unless given.")
@click.option("--fresh", is_flag=True, help="Replace a study that is there.")
@click.option("--list", "only", is_flag=True, help="List topics and columns; write nothing.")
def import_command(
    log: str,
    model: str | None,
    renamed: dict[str, str],
    units: dict[str, str],
    dt: float | None,
    hold: Hold | None,
    output: str | None,
    fresh: bool,
    only: bool,
) -> None:
    """Turn a log into records and a study: PX4 ULog, ArduPilot dataflash (.bin, .log), TDMS.

    Lists topics with their rates and gaps, puts inputs, rates, attitudes, specific forces and
    velocities on one clock in SI, says how late topics are that hold the same, cuts out the
    stretches in which the inputs move, and writes a study that casid identify runs. Columns that
    are not found are named: --column lat=RCOU.C1; units not stated in the log: --unit p=deg/s.

    \b
    FOLDER then holds
      study.toml       the study
      data/            a record (CSV, SI, total values) for every stretch
      axes.py          a structure to start from, unless --model names one
    """  # noqa: D301
    with exits() as console:
        if only:
            _list(console, read_log(log), columns=True)
            return
        how = {"columns": renamed, "units": units}
        draft = import_log(log, output, model=model, **how, dt=dt, hold=hold, fresh=fresh)
        _list(console, draft.log, columns=False)
        _show(console, draft)


def _list(console: Console, log: Log, *, columns: bool) -> None:
    last = ["columns"] if columns else []
    headings = ("samples", "Hz", "from", "to [s]", "gaps", "longest [s]", *last)
    table = new_table(
        f"{log.path.name}: {log.kind}, {counted(len(log.topics), 'topic')}", "topic", *headings
    )
    for topic in log.topics.values():
        gaps = topic.gaps()
        longest = f"{max(length for _, length in gaps):.3g}" if gaps else ""
        span = (f"{topic.t[0]:.7g}", f"{topic.t[-1]:.7g}", str(len(gaps) or ""), longest)
        rate = f"{1 / topic.interval:.4g}" if topic.interval > 0 else ""
        named = [", ".join(topic.columns)] if columns else []
        table.add_row(Text(topic.name), str(len(topic.t)), rate, *span, *map(Text, named))
    console.print(table, "")
    for note in log.notes:
        console.print(Text(f"! {note}", style="yellow"))


def _show_clocks(console: Console, draft: Draft) -> None:
    for assumed in draft.assumed:
        caution(console, assumed)
    for each in draft.delays:
        if abs(each.seconds) >= SHOWN:
            after = "after" if each.seconds > 0 else "before"
            said = f"{1000 * abs(each.seconds):.1f} ms {after} {each.than}"
            console.print(Text(f"{each.late} comes {said} (correlation {each.correlation:.2f})"))
    if draft.moves:
        caution(
            console,
            f"kinematics asks for {moves_told(draft.moves)}. The shares from outside are those "
            "of channels so shifted; the study offers the shifts, commented out",
        )


def _show(console: Console, draft: Draft) -> None:
    table = new_table(
        "Channels", "channel", "", "column", "unit", "Hz", "sampled before its stamp [ms]"
    )
    for kind, sources in (("in", draft.inputs), ("out", draft.outputs)):
        for name, source in sources.items():
            age = f"{1000 * source.topic.age:.3g}" if source.topic.age else ""
            rate = f"{1 / source.topic.interval:.4g}"
            unit = "not stated" if source.unit == "" else source.unit or UNITS.get(name, "")
            table.add_row(Text(name), kind, Text(source.place), Text(unit), rate, age)
    console.print(table, "")
    _show_clocks(console, draft)
    inputs = draft.stretches[0].record.inputs
    headings = ("from", "to [s]", *(f"{name} std" for name in inputs), "from outside")
    table = new_table("Stretches in which the inputs move", "record", *headings)
    for stretch in draft.stretches:
        record, found = stretch.record, stretch.excitation
        share = "" if found is None else _shares(found, inputs)
        moved = [f"{value:.2g}" for value in stretch.moved]
        table.add_row(record.name, f"{record.t[0]:.6g}", f"{record.t[-1]:.6g}", *moved, share)
    console.print(table, "")
    for doubt in draft.doubts:
        caution(console, doubt)
    study = Path(draft.study)
    console.print(Text(f"{study}: look with  casid inspect {study}"), soft_wrap=True)
    console.print(Text(f"then  casid identify {study}"), soft_wrap=True)


def _shares(found: Excitation, inputs: Sequence[str]) -> str:
    """Median share of every input within its band, in their order; "-" of one that rests."""
    bands = zip(found.inputs, found.lower.T, found.within.T, strict=True)
    shares = {name: f"{np.median(x[w]):.0%}" for name, x, w in bands if w.any()}
    return ", ".join(shares.get(name, "-") for name in inputs)
