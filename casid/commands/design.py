"""The command `design`: from a study to the next flight."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.text import Text

from casid.commands.study import OUTPUT, STUDY, VERBOSE
from casid.commands.terminal import exits, logged, new_table, terminal
from casid.design.inputs import design_inputs
from casid.design.plan import Design, DesignSettings, Limits
from casid.files import write_text
from casid.fit import AnyFit, Fit
from casid.record import Record
from casid.studies.study import Study, read_records
from casid.studies.studyfile import read_study

SHOWN = 12  # parameters in the table
DPI = 120


def _pairs(_: click.Context, option: click.Parameter, values: Sequence[str]) -> dict[str, float]:
    """``name=number`` as a mapping; of several the last counts."""
    found = {}
    for value in values:
        name, number = [*value.split("=", 1), ""][:2]
        try:
            found[name] = float(number)
        except ValueError:
            raise click.BadParameter(f"{value!r}, expected NAME=NUMBER", param=option) from None
    return found


def _limit(flag: str, what: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option(flag, multiple=True, callback=_pairs, metavar="NAME=NUMBER", help=what)


@click.command()
@STUDY
@OUTPUT
@click.option("--duration", default=60.0, show_default=True, help="Of the manoeuvre [s].")
@_limit("--stick", "Largest deviation of an input, SI; the largest flown unless given.")
@_limit("--rate", "Largest rate of an input, SI per second; free unless given.")
@_limit("--response", "Largest deviation of an output, SI; the largest flown unless given.")
@_limit("--feedback", "Gain of the loop that is flown: lat:p=0.15 is u_lat = r_lat - 0.15 p.")
@click.option("--matter", multiple=True, metavar="NAME", help="Parameter that counts; else all.")
@click.option("--method", default="best", help="best, steps or multisine.", show_default=True)
@VERBOSE
def design(
    study: Path,
    output: Path | None,
    duration: float,
    method: str,
    verbose: bool,
    **asked: Any,  # noqa: ANN401 - options by name
) -> None:
    """Design the next flight of a study: what is weak, what to fly, what it will buy.

    The fit that casid identify has kept is what is known before; without one the guess is taken,
    and the study's table [noise] says how noisy the outputs are.

    \b
    The output folder then also holds
      design/card.csv    time and designed stick deviations, SI
      design/design.md   what is compared, and every standard error before and after
      design/design.png  sticks and predicted responses with their limits
    """  # noqa: D301
    console = terminal()
    with exits(console), logged(console, verbose):
        what = read_study(study, output)
        limits, dt = _limits(what, asked)
        settings = DesignSettings(
            method=method, matter=asked["matter"], fixed=what.fixed, dt=dt  # type: ignore[arg-type]
        )  # fmt: skip
        model = _kept(what)
        noise = None if isinstance(model, Fit) or what.noise is None else what.noise.std
        feedback: dict[str, dict[str, float]] = {}
        for name, gain in asked["feedback"].items():
            stick, _, channel = name.partition(":")
            feedback.setdefault(stick, {})[channel] = gain
        made = design_inputs(
            model, limits, duration, noise=noise, feedback=feedback, settings=settings
        )
        _say(console, made, model if isinstance(model, Fit) else None)
        folder = what.output / "design"
        write_text(folder / "card.csv", made.to_csv())
        write_text(folder / "design.md", _page(made))
        np.ravel(made.plot())[0].figure.savefig(folder / "design.png", dpi=DPI)
        console.print(Text("Card: ").append(str((folder / "card.csv").resolve()), style="bold"))


def _kept(study: Study) -> Any:  # noqa: ANN401 - a fit, or a model without one
    """The fit of the study's last identification, if there is one, else its guess."""
    path = study.output / "fit.json"
    if not path.exists():
        return study.model
    return Fit.load(path, model=type(study.model))


def _limits(study: Study, asked: dict[str, dict[str, float]]) -> tuple[Limits, float]:
    """What was asked for, else what the study's records have reached; and their interval."""
    records = read_records(study)["identification"]
    flown = [record.select(study.model.inputs, study.model.outputs) for record in records]
    limits = Limits(
        sticks=_reached(flown, study.model.inputs) | asked["stick"],
        rates=asked["rate"],
        responses=_reached(flown, study.model.outputs) | asked["response"],
    )
    return limits, float(np.median([record.dt for record in flown]))


def _reached(records: Sequence[Record], names: Sequence[str]) -> dict[str, float]:
    """Largest deviation of each channel in any record."""
    return {n: max(float(np.nanmax(np.abs(r.channel(n)))) for r in records) for n in names}


def _say(console: Console, made: Design, fit: AnyFit | None) -> None:
    """What is compared, what is weak and what becomes of it."""
    console.print(Text(made.headline()))
    rows = list(made.ratios())
    table = new_table("Standard errors over those of 3-2-1-1", "input", "mean", "worst", "of")
    for name, mean, worst, parameter in rows:
        table.add_row(name, f"{mean:.3f}", f"{worst:.3f}", Text(parameter))
    console.print(table)
    values = {row.name: row.value for row in fit.parameters} if fit else {}
    table = new_table("Weakest parameters", "parameter", "value", "before", "3-2-1-1", "this")
    size = np.array([abs(values.get(name, 1.0)) for name in made.names])
    first, last = made.alternatives[0].std_errors, made.std_errors
    weak = np.where(np.isfinite(made.before), made.before, first) / np.maximum(size, 1e-9)
    for k in np.argsort(-weak)[:SHOWN]:
        value = f"{values[made.names[k]]:.4g}" if values else ""
        errors = (f"{column[k]:.2g}" for column in (made.before, first, last))
        table.add_row(made.names[k], value, *errors)
    console.print(table)
    for line in made.blind:
        console.print(Text("! ", style="bold yellow").append(line, style="default"))


def _page(made: Design) -> str:
    close = [f"- {a} and {b}: {c:+.2f}" for a, b, c in made.correlated()]
    blind = ["## Not told apart", "\n".join(f"- {line}" for line in made.blind)]
    parts = [
        f"# {made.headline()}", "## What could be flown", made.comparison(),
        "## Standard errors", made.to_markdown(), "## Share of each limit", made.shares(),
        "## Correlated errors", "\n".join(close) or "None above 0.9.",
        *(blind if made.blind else []),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"
