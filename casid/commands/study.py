"""Commands about studies: identify, bounds, check."""

import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np
from rich.console import Console, RenderableType
from rich.live import Live
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from casid.bounds.compare import BoundsComparison
from casid.commands.columns import COLUMN, TIME, TIME_COLUMN, UNIT, refuse_beside_study
from casid.commands.remarks import idle, unpredicted
from casid.commands.terminal import BAD_INPUT, caution, exits, logged, new_table
from casid.errors import DataWarning
from casid.exchange.formats import read_record
from casid.fit import AnyFit, Fit
from casid.frequency.estimation import SpectralAnalysis
from casid.interrupts import check_interrupt
from casid.nlp import Progress
from casid.record import Record
from casid.records import steps_told, twins_told, units_told
from casid.report.content import Timing
from casid.report.words import brief, prior
from casid.slow_sources import repeats_told
from casid.stages.listing import STAGES, stages_in_words, tables_of_stages
from casid.structure.identifiability import identifiability
from casid.structure.modelfile import load_model
from casid.structure.overview import describe
from casid.studies.keeping import Watch
from casid.studies.runner import StudyOutcome, run_study
from casid.studies.study import Study, read_flights
from casid.studies.studyfile import read_study
from casid.values import digest

WIDE = 24  # column of stages


STUDY = click.argument("study", type=click.Path(path_type=Path), metavar="STUDY.toml")
PNG = click.option("--png", is_flag=True, help="Write every figure as PNG too.")
OUTPUT = click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of the results, instead of the one the study names.",
)
VERBOSE = click.option("--verbose", "-v", is_flag=True, help="Say what each stage does.")


IDENTIFY = f"""Identify the structure a study names and write its report.

Stages: {stages_in_words(STAGES)}, report. Each result is kept when its stage ends: an interrupted
study goes on where it stopped, and a stage is computed again only if something it depends on has
changed. Their settings stand in the tables {tables_of_stages(STAGES)} of the study.

\b
The output folder then holds
  report.html      everything on one page, for screen and paper
  fit.json         the identified model, for casid.Fit.load
  parameters.csv   the parameter table
  figures/         every figure as SVG, with --png as PNG too
  stages/          the result of each stage
"""


@click.command(help=IDENTIFY)
@STUDY
@OUTPUT
@click.option("--fresh", is_flag=True, help="Compute every stage again, whatever was kept.")
@click.option("--parameters", is_flag=True, help="Print the table of parameters too.")
@PNG
@VERBOSE
def identify(
    study: Path, output: Path | None, fresh: bool, parameters: bool, png: bool, verbose: bool
) -> None:
    """Identify the structure a study names and write its report."""
    begun = perf_counter()
    with exits() as console, logged(console, verbose), Monitor(console) as monitor:
        asked = _read(study, output, png)
        outcome = run_study(asked, fresh=fresh, watch=monitor)
    console.print(Text(_line("total", None, None, perf_counter() - begun), style="bold"))
    if parameters:
        chosen = any(timing.stage == "chosen" for timing in outcome.timings)
        delivered = Fit.load(asked.output / "fit.json", model=type(asked.model))
        console.print(printed_parameters(delivered, of="the chosen step, " * chosen))
    _judge(console, outcome)
    _say_where(console, outcome)


@click.command()
@STUDY
@OUTPUT
@PNG
@VERBOSE
def bounds(study: Path, output: Path | None, png: bool, verbose: bool) -> None:
    """Compare the cases of a study's table [bounds] and price every bound.

    The study is identified first, as by casid identify; what that kept is taken. Every case is
    kept when it is done: an interrupted comparison goes on where it stopped.

    \b
    The output folder then also holds
      report.html      with a section about the cases
      bounds.csv       one row a case and parameter; bounds_cases.csv: one row a case
      bounds.md        both tables, for reading
      bounds/          the result of each case
    """  # noqa: D301
    with exits() as console, logged(console, verbose), Monitor(console) as monitor:
        asked = _read(study, output, png)
        if "bounds" not in asked.settings:
            raise ValueError(f"{study}: there is no table [bounds] with cases to compare")
        outcome = run_study(asked, command="bounds", watch=monitor)
    if outcome.comparison is not None:
        console.print(case_table(outcome.comparison))
    _say_where(console, outcome)


def _read(study: Path, output: Path | None, png: bool) -> Study:
    """The study, its figures as PNG too if asked for here or there."""
    asked = read_study(study, output)
    return replace(asked, png=png or asked.png)


@click.command()
@click.argument("what", metavar="STUDY.toml|MODEL.py:CLASS")
@click.option(
    "--record",
    "flights",
    multiple=True,
    metavar="RECORD",
    help="With a model: judge identifiability for this flight (SI, unless --unit says so).",
)
@UNIT
@COLUMN
@TIME
@click.option("--fixed", multiple=True, metavar="NAME", help="With a model: hold this parameter.")
@VERBOSE
def check(
    what: str,
    flights: tuple[str, ...],
    units: dict[str, str],
    renamed: dict[str, str],
    time: str,
    fixed: tuple[str, ...],
    verbose: bool,
) -> None:
    """Check a study file, its model and its records, or a model file, without estimating anything.

    Of a model (models/six_dof.py:SixDof) this prints the matrices with names and with numbers at
    the guess, the parameters, the eigenvalues, what the outputs do not see, and which parameters
    the excitation cannot tell apart: one 3-2-1-1 a control, or the records given.

    Of a study it ends in "The study is in order.", or in what to mend first and in exit code 2.
    """
    with exits() as console, logged(console, verbose):
        if what.endswith(".toml"):
            refuse_beside_study(
                record=flights, unit=units, column=renamed, time=time != TIME_COLUMN, fixed=fixed
            )
            if not _in_order(console, read_study(Path(what))):
                sys.exit(BAD_INPUT)
        else:
            if not flights and (units or renamed or time != TIME_COLUMN):
                raise ValueError("--unit, --column and --time are of records: add --record RECORD")
            model = load_model(what)()
            each: Any = {"time": time, "units": units}
            for kind in ("inputs", "outputs"):
                names = getattr(model, kind)
                each[kind] = {name: renamed.get(name, name) for name in names}
            records = [read_record(flight, **each) for flight in flights]
            text = Text(str(describe(model, records or None, fixed=fixed)))
            console.print(text, no_wrap=True, overflow="ignore", crop=False)


class Monitor(Watch):
    """Shows the stage that runs (iteration, cost, seconds) and a line for each that has ended."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._spinner = Spinner("dots")
        self._stage, self._since = "", 0.0
        self._last: Progress | None = None
        self._live = Live(
            console=console, refresh_per_second=8, transient=True, get_renderable=self._now
        )

    def __enter__(self) -> "Monitor":
        heading = f"{'stage':<{WIDE}}{'iterations':>11}{'cost':>14}{'seconds':>10}"
        self._console.print(Text(heading, style="bold"))
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stage = ""
        self._live.stop()

    def begin(self, stage: str) -> None:
        """Show that a stage runs."""
        check_interrupt()
        self._stage, self._since, self._last = stage, perf_counter(), None

    def progress(self, progress: Progress) -> None:
        """Show the iteration it is at."""
        check_interrupt()
        self._last = progress

    def end(self, timing: Timing) -> None:
        """Leave a line about it."""
        self._stage = ""
        line = _line(timing.stage, timing.iterations, timing.cost, timing.seconds)
        self._console.print(Text(line + ("  kept" if timing.kept else "")))

    def _now(self) -> RenderableType:
        if not self._stage:
            return Text("")
        seconds, last = perf_counter() - self._since, self._last
        line = _line(self._stage, None, None, seconds)
        if last is not None:
            line = _line(last.stage, last.iteration, last.cost, seconds)
        self._spinner.update(text=Text(line))
        return self._spinner


def _line(stage: str, iterations: int | None, cost: float | None, seconds: float) -> str:
    steps = "" if iterations is None else str(iterations)
    value = "" if cost is None else f"{cost:.6g}"
    return f"{stage:<{WIDE}}{steps:>11}{value:>14}{seconds:>10.2f}"


def _judge(console: Console, outcome: StudyOutcome) -> None:
    """Print what the report begins with: structure, verdict per output."""
    for said, good in outcome.headlines.items():
        console.print(Text(said, style={True: "green", False: "yellow", None: ""}[good]))
    if outcome.verdicts:
        headings = ("verdict", "fit %", "Theil", "RMS error", "noise", "unit")
        seen = f"validation records (an estimation has seen {', '.join(outcome.seen)})"
        title = f"On {seen if outcome.seen else 'unseen records'}"
        table = new_table(title, "output", *headings)
        for each in outcome.verdicts:
            figures = (f"{each.fit:.3g}", f"{each.theil:.2f}", f"{each.rms:.3g}")
            style = "yellow" if each.word == "poor" else None
            noise = f"{each.noise:.2g}"
            table.add_row(each.output, each.word, *figures, noise, Text(each.unit), style=style)
        console.print(table)


def _say_where(console: Console, outcome: StudyOutcome) -> None:
    """Print what to be careful of, in short, and where all of it stands."""
    for said in outcome.cautions:
        caution(console, brief(said))
    path = str(outcome.report.resolve())
    console.print(Text("Report: ").append(path, style="bold"), soft_wrap=True)


def printed_parameters(fit: AnyFit, of: str = "") -> Table:
    """Parameters of a fit for the terminal; * marks those on a bound."""
    headings = ("name", "value", "std. error", "Cramér-Rao", "lower", "upper", "unit")
    table = new_table(f"Parameters after {of}{fit.method}", *headings)
    for row in fit.parameters:
        error = "fixed" if row.fixed else f"{row.std_error:.2g} {prior(row)}".strip()
        table.add_row(
            row.name,
            f"{row.value:.4g}{'*' if row.active else ' '}",
            error,
            f"{row.cramer_rao:.2g}",
            f"{row.lower:g}",
            f"{row.upper:g}",
            Text(row.unit),
            style="yellow" if row.active else None,
        )
    return table


def case_table(comparison: BoundsComparison) -> Table:
    """Cases of a comparison for the terminal."""
    headings = ("cost", "increase", "predicted", "held", "validation RMS / std", "largest price")
    table = new_table(f"Cases by {comparison.estimator}", "case", *headings)
    for case in comparison.cases:
        if case.reason:
            table.add_row(Text(case.name), Text(f"failed: {case.reason}", style="red"))
            continue
        largest = max(case.shares, key=case.shares.__getitem__, default="")
        figures = [f"{case.cost:.7g}", f"{case.increase:.4g}", f"{case.predicted:.4g}"]
        figures += [str(case.held), f"{case.rms:.3g}"]
        table.add_row(Text(case.name), *figures, Text(largest))
    return table


def _in_order(console: Console, study: Study) -> bool:
    """Print what there is to say of a study and its records; whether nothing is to be mended."""
    structure = type(study.model)
    free = len(structure.parameter_names()) - len(study.fixed)
    console.print(Text(f"{study.title}: structure {structure.__name__}, {free} free parameters"))
    table = new_table("Records", "record", "role", "samples", "seconds", "interval")
    flights, again = read_flights(study)
    for role, records in flights.items():
        for record in records:
            numbers = (str(record.N), f"{record.duration:g}", f"{record.dt:.5g}")
            table.add_row(Text(record.name), role, *numbers)
    console.print(table)
    flown = flights.get("refinement", flights["identification"])
    steps = () if study.channels.hold else steps_told(flown, study.model.delays())
    both = *flights["identification"], *flights.get("refinement", ())
    estimated = list({digest(each.u, each.y): each for each in both}.values())
    untold = () if again.told() else _untold(study, estimated)
    unread = () if again.told() else _unread(study, flights.get("frequency", ()))
    own = {digest(each.u, each.y) for each in estimated}
    every = (each for records in flights.values() for each in records)
    rest = {d: each for each in every if (d := digest(each.u, each.y)) not in own}
    units = units_told(list(rest.values()))  # of the others it is a warning
    twins = twins_told(estimated)
    far = () if again.told() else unpredicted(study, flights.get("validation", ()))
    useless = idle(study, flights)
    for said in (*again.told(), *twins, *steps, *units, *unread, *untold, *far, *useless):
        caution(console, said)
    held = repeats_told([*estimated, *rest.values()], study.channels.outputs)  # a warning, too
    if again.told() or twins or unread or units or units_told(estimated) or held:
        console.print("Mend the records first.")
        return False
    if far and not untold:
        console.print("Mend the horizon first.")
        return False
    console.print("Mend the structure first." if untold else "The study is in order.")
    return not untold


def _unread(study: Study, flown: Sequence[Record]) -> tuple[str, ...]:
    """That losses leave nothing of the frequency response, which later stages would stumble on."""
    analysis = study.settings.get("frequency", SpectralAnalysis())
    holed = any(np.isnan(record.y).any() or len(record.gaps()) for record in flown)
    if not holed or analysis.reference:  # references need not be among these channels
        return ()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # identify tells these with the rest
            found = analysis.fit(flown)
        why = "" if np.isfinite(found.G).any() else "; ".join(found.flags) or "all points are NaN"
    except ValueError as error:
        why = str(error)
    return (f"No frequency response can be estimated: {why}.",) if why else ()


def _untold(study: Study, flown: Sequence[Record]) -> tuple[str, ...]:
    """What the records cannot tell of the structure's parameters, however good they are."""
    try:
        found = identifiability(study.model, flown, fixed=study.fixed, bounds=study.bounds)
    except ValueError as error:  # a guess that runs away from them
        return (str(error),)
    return () if found.identifiable else tuple(str(found).splitlines()[1:])
