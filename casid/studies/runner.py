"""Run a study: every stage in turn, each result kept as soon as it is there, then the report."""

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from casid.bounds.compare import BoundsComparison
from casid.chain import Identification
from casid.consistency.flights import Repeats
from casid.errors import ConvergenceError, DataWarning, warn
from casid.files import write_text
from casid.fit import AnyFit, ParameterEstimate
from casid.folder import claimed
from casid.record import Record
from casid.report import Content, Timing, write_report
from casid.report.html import cautions
from casid.report.verdicts import Verdict, verdicts
from casid.stages.listing import sections
from casid.stages.stage import Role, run_stages
from casid.studies.contents import content
from casid.studies.keeping import Keeper, Watch
from casid.studies.responses import with_measured
from casid.studies.study import Study, read_flights, without_checks
from casid.tabulation import csv_text
from casid.threads import one_thread
from casid.validation import Validation

WRITTEN = (
    "report.html",
    "fit.json",
    "parameters.csv",
    "bounds.csv",
    "bounds_cases.csv",
    "bounds.md",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a study found, what to think of it, and where it lies.

    Parameters
    ----------
    identification : Identification
        The result of each stage.
    timings : tuple of Timing
        Effort of each stage.
    report : Path
        The page.
    verdicts : tuple of Verdict
        On each output of the unseen records; none without such records.
    cautions : tuple of str
        What makes the result less certain than it looks, what matters most first.
    """

    identification: Identification[Any]
    timings: tuple[Timing, ...]
    report: Path
    verdicts: tuple[Verdict, ...] = ()
    cautions: tuple[str, ...] = ()

    @property
    def validation(self) -> Validation:
        """Of all models on the unseen records."""
        found: Validation = self.identification.results["validation"]
        return found

    @property
    def comparison(self) -> BoundsComparison | None:
        """What the study's cases cost, if they were compared."""
        return self.identification.results.get("bounds")


@one_thread
def run_study(
    study: Study, *, fresh: bool = False, command: str = "", watch: Watch | None = None
) -> Outcome:
    """Run all stages of a study and write its report.

    Parameters
    ----------
    study : Study
        From `read_study`.
    fresh : bool
        Compute every stage again, whatever was kept.
    command : str
        Run the stages of this command too: "bounds" compares the study's cases.
    watch : Watch
        Told of every stage's begin, iterations and end.

    Returns
    -------
    Outcome
        The files are in ``study.output``: report.html, fit.json, parameters.csv, figures/*.svg and
        stages/*.json; figures/*.png too if ``study.png``.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        Bad input; a stage that did not converge: its best iterate and all stages before it are
        kept. If it is an optional one, on which nothing rests, all else is done first.
    """
    study.spare(*WRITTEN)
    watch = watch or Watch()
    started = time.perf_counter()
    watch.begin("records")
    (flights, again), said = _read(study)
    clock = [Timing(stage="records", seconds=time.perf_counter() - started)]
    watch.end(clock[0])
    with claimed(study.output):
        keeper = Keeper(study, watch, clock, fresh=fresh, command=command)
        keeper.warnings += said
        return _run(study, flights, again, keeper)


def _read(study: Study) -> tuple[tuple[Mapping[Role, Sequence[Record]], Repeats], list[str]]:
    """Flights, and what was warned of as they were read: that belongs in the report, too."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        try:
            found = read_flights(study)
        finally:
            said = list(dict.fromkeys(str(each.message) for each in caught))
    for each in said:
        warn(each)
    return found, said


def _run(
    study: Study, flights: Mapping[Role, Sequence[Record]], again: Repeats, keeper: Keeper
) -> Outcome:
    records = without_checks(study, flights)
    task = with_measured(study.task(records, flights), study.responses)
    found = run_stages(task, keep=keeper)
    does = {stage.name: stage.does for stage in study.stages}
    lasting = {stage.name for stage in study.stages if stage.kept}
    keeper.warnings += [f"The {does[name]} is missing. {e}" for name, e in found.failures.items()]
    last = found.results.get("chosen", found.results.get("output_error"))
    if last is not None:
        last.save(study.output / "fit.json")
        write_parameters(study.output / "parameters.csv", last)

    def write() -> tuple[Path, Content, tuple[str, ...]]:
        # Seconds of what is computed every time would make two pages of one result differ.
        clock = [timing for timing in keeper.clock if timing.stage in lasting]
        shown = content(study, records, again, found, clock, keeper.warnings)
        told = sections(study.stages, found.results, shown)
        return write_report(shown, told, study.output), shown, cautions(shown, told)

    report, shown, said = keeper.timed("report", write)
    for failure in found.failures.values():
        raise ConvergenceError(
            f"{failure}\nThe report is written without it: {report}", failure.best
        ) from failure
    named: Identification[Any] = Identification(results=found.results)
    judged = found.results.get("validation")
    return Outcome(
        identification=named,
        timings=tuple(keeper.clock),
        report=report,
        verdicts=() if judged is None else verdicts(judged, shown),
        cautions=said,
    )


def write_parameters(path: str | Path, fit: AnyFit) -> None:
    """Write the parameter table as CSV, one row a parameter."""
    columns = [f.name for f in fields(ParameterEstimate)]
    write_text(path, csv_text(columns, [list(asdict(row).values()) for row in fit.parameters]))
