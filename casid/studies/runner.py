"""Run a study: every stage in turn, each result kept as soon as it is there, then the report."""

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from casid import report as pages
from casid.bounds.compare import BoundsComparison
from casid.chain import Identification
from casid.consistency.reused_flights import Repeats
from casid.errors import ConvergenceError, DataWarning, warn
from casid.fit import AnyFit, ParameterEstimate
from casid.folder import Place, at_once, claimed
from casid.record import Record
from casid.report.content import Content, Section, Timing, cautions, contradicted, enough
from casid.report.verdicts import Verdict, verdicts
from casid.stages.listing import sections
from casid.stages.stage import Role, StageResults, run_stages
from casid.studies.contents import content
from casid.studies.keeping import Holding, Keeper, Watch
from casid.studies.responses import with_measured
from casid.studies.study import Study, read_flights, without_checks
from casid.studies.written import (
    WRITTEN,
    Written,
    delete_earlier,
    digests,
    keep_written,
    made,
    origin,
    read_written,
)
from casid.tabulation import csv_text
from casid.textfile import write_text
from casid.threads import one_thread
from casid.validation import Validation

TOLD = ("verdicts", "cautions", "headlines", "seen")  # of what was written, as it was


@dataclass(frozen=True, eq=False, kw_only=True)
class StudyOutcome:
    """What a study found, what to think of it, and where it lies.

    Parameters
    ----------
    timings : tuple of Timing
        Effort of each stage.
    report : Path
        The page.
    verdicts : tuple of Verdict
        On each output of the unseen records; none without such records.
    cautions : tuple of str
        What makes the result less certain than it looks, what matters most first.
    headlines : mapping
        What was found out about structure and last step in a sentence each, and whether it is good
        news.
    seen : tuple of str
        Validation records that an estimation has seen: verdicts on them are no proof.
    found : callable
        Returns the results of the stages, which are read when asked for if all were kept.
    """

    timings: tuple[Timing, ...]
    report: Path
    verdicts: tuple[Verdict, ...] = ()
    cautions: tuple[str, ...] = ()
    headlines: Mapping[str, bool | None] = field(default_factory=dict)
    seen: tuple[str, ...] = ()
    found: Callable[[], Mapping[str, Any]]

    @cached_property
    def identification(self) -> Identification[Any]:
        """The result of each stage."""
        return Identification(results=self.found())

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
) -> StudyOutcome:
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
    if not fresh and not command and (outcome := _as_written(study, watch)):
        return outcome
    started = time.perf_counter()
    watch.begin("records")
    begun_from = origin(study)  # a file may change while the study runs
    flown, said = _read(study)
    clock = [Timing(stage="records", seconds=time.perf_counter() - started)]
    watch.end(clock[0])
    with claimed(study.output):
        keeper = Keeper(study, watch, clock, fresh=fresh, command=command)
        keeper.warnings += [*said, *study.notes]
        before = made(study)
        outcome = _run(study, *flown, keeper)
        own = delete_earlier(study, before)
        written = {key: getattr(outcome, key) for key in ("timings", *TOLD)}
        files = digests(study)
        keep_written(
            study, begun_from, Written(files=files, made=own, warnings=tuple(said), **written)
        )
        return outcome


def _as_written(study: Study, watch: Watch) -> StudyOutcome | None:
    """What an earlier run found and wrote, if all of it still holds: nothing is read but files."""
    started = time.perf_counter()
    written = read_written(study)
    if written is None:
        return None
    for each in written.warnings:
        warn(each)
    clock = [replace(timing, kept=True) for timing in written.timings]
    clock[0] = Timing(stage="records", seconds=time.perf_counter() - started)  # compared by digest
    for timing in clock:
        watch.end(timing)
    told: Any = {key: getattr(written, key) for key in TOLD}
    report = study.output / "report.html"
    return StudyOutcome(timings=tuple(clock), report=report, found=partial(_again, study), **told)


def _again(study: Study) -> Mapping[str, Any]:
    """Results of the stages, as they are kept."""
    (flights, _), _ = _read(study)
    keeper = Keeper(study, Watch(), [], fresh=False, command="")
    return _stages(study, without_checks(study, flights), flights, keeper).results


def kept_fit(study: Study) -> AnyFit | None:
    """The fit that was kept of just these records and settings; None without one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # told where the records serve
        flights, _ = read_flights(study)
    keeper = Holding(study, Watch(), [], fresh=False, command="")
    return _last(_stages(study, without_checks(study, flights), flights, keeper).results)


def _last(results: Mapping[str, Any]) -> AnyFit | None:
    """The fit of the last step."""
    found: AnyFit | None = results.get("chosen", results.get("output_error"))
    return found


def _stages(
    study: Study,
    records: Mapping[Role, Sequence[Record]],
    flights: Mapping[Role, Sequence[Record]],
    keeper: Keeper,
) -> StageResults:
    task = with_measured(study.task(records, flights), study.responses)
    with keeper.processes:
        return run_stages(task, keep=keeper, begin=keeper.begin)


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
) -> StudyOutcome:
    records = without_checks(study, flights)
    try:
        found = _stages(study, records, flights, keeper)
    except ConvergenceError as error:
        raise ConvergenceError(f"{error}{_earlier(study)}", error.best) from error
    except ValueError as error:
        error.add_note(_earlier(study).strip())
        raise
    does = {stage.name: stage.does for stage in study.stages}
    lasting = {stage.name for stage in study.stages if stage.kept}
    keeper.warnings += [f"The {does[name]} is missing. {e}" for name, e in found.failures.items()]
    last = _last(found.results)

    def write(place: Place) -> tuple[Path, Content, tuple[Section, ...]]:
        # Seconds of what is computed every time would make two pages of one result differ.
        clock = [timing for timing in keeper.clock if timing.stage in lasting]
        shown = content(study, records, again, found, clock, keeper.warnings)
        told = sections(study.stages, found.results, shown)
        return pages.write_report(shown, told, study.output, place), shown, tuple(told)

    with at_once() as place:
        report, shown, told = keeper.timed("report", partial(write, place))
        if last is not None:
            last.save(place(study.output / "fit.json"))
            write_parameters(place(study.output / "parameters.csv"), last)
    for failure in found.failures.values():
        raise ConvergenceError(
            f"{failure}\nThe report is written without it: {report}", failure.best
        ) from failure
    judged = found.results.get("validation")
    return StudyOutcome(
        timings=tuple(keeper.clock),
        report=report,
        verdicts=() if judged is None else verdicts(judged, shown),
        cautions=cautions(shown, told),
        headlines=_headlines(found.results, doubted=contradicted(told)),
        seen=tuple(again.seen),
        found=lambda: found.results,
    )


def _earlier(study: Study) -> str:
    """Which files of an earlier run lie in the folder of results, and of when; "" without any."""
    files = [file for name in WRITTEN if (file := study.output / name).exists()]
    if not files:
        return ""
    last = time.localtime(max(file.stat().st_mtime for file in files))
    names = ", ".join(file.name for file in files)
    return (
        f"\n{names} and figures in {study.output} are not of this run but of the last one that "
        f"ended, {time.strftime('%Y-%m-%d %H:%M', last)}."
    )


def _headlines(results: Mapping[str, Any], *, doubted: bool) -> dict[str, bool | None]:
    """Whether the structure is enough, if nothing contradicts that, and which step was chosen."""
    said = {"sufficiency": enough(results), "choice": None}
    if doubted and said["sufficiency"]:
        del said["sufficiency"]
    return {results[name].headline(): good for name, good in said.items() if name in results}


def write_parameters(path: str | Path, fit: AnyFit) -> None:
    """Write the parameter table as CSV, one row a parameter."""
    columns = [f.name for f in fields(ParameterEstimate)]
    write_text(path, csv_text(columns, [list(asdict(row).values()) for row in fit.parameters]))
