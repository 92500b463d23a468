"""Run a study: every stage in turn, each result kept as soon as it is there, then the report."""

import logging
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

from casid.baseline.derivid import Derivid
from casid.bounds.compare import BoundsComparison
from casid.chain import Chain, Identification, identify
from casid.errors import ConvergenceError, DataWarning
from casid.files import write_text
from casid.fit import AnyFit, Fit, ParameterEstimate
from casid.folder import claimed
from casid.jobs.campaigns import Advance
from casid.jobs.store import Entry, Result, Store, source_digest
from casid.matching.match import Match
from casid.nlp import Progress
from casid.record import Record
from casid.report import (
    BASELINE,
    BLACK_BOX,
    MATCH,
    OUTPUT_ERROR,
    Timing,
    write_report,
)
from casid.shooting.output_error import OutputError
from casid.studies.comparing import compare_study, comparison_path, kept_comparison
from casid.studies.contents import content
from casid.studies.study import Role, Study, read_records
from casid.validation import AnyModel, Validation, validate
from casid.values import digest

T = TypeVar("T")
LOG = logging.getLogger("casid")
STALE = (
    "The comparison of bounds in the folder of results is of an earlier state of the study and is "
    "not shown; casid bounds makes it anew."
)

# What a stage takes from: the stages before it, the role of its records, its table of options.
NEEDS: Mapping[str, tuple[tuple[str, ...], Role | None, str]] = {
    "pbsid": ((), "identification", "pbsid"),
    "frequency": ((), "frequency", "frequency"),
    "quadratic": (("pbsid", "frequency"), None, "match"),
    "hinf": (("quadratic",), None, "match"),
    "output_error": (("hinf",), "refinement", "output_error"),
    "derivid": (("frequency", "quadratic"), None, "derivid"),
}
STRUCTURED = ("quadratic", "hinf", "output_error", "derivid")


class Watch(Protocol):
    """Who is told how a study goes on."""

    def begin(self, stage: str) -> None:
        """Note that a stage begins."""

    def progress(self, progress: Progress) -> None:
        """Note an iteration within a stage."""

    def end(self, timing: Timing) -> None:
        """Note that a stage has ended."""


class Silent:
    """A watch that looks away."""

    def begin(self, stage: str) -> None:
        """Do nothing."""

    def progress(self, progress: Progress) -> None:
        """Do nothing."""

    def end(self, timing: Timing) -> None:
        """Do nothing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a study found and where it lies."""

    identification: Identification[Any]
    validation: Validation
    timings: tuple[Timing, ...]
    report: Path
    comparison: BoundsComparison | None = None


def run_study(
    study: Study, *, fresh: bool = False, compare: bool = False, watch: Watch | None = None
) -> Outcome:
    """Run all stages of a study and write its report.

    Parameters
    ----------
    study : Study
        From `read_study`.
    fresh : bool
        Compute every stage again, whatever was kept.
    compare : bool
        Compare the study's cases too (`casid.studies.comparing`).
    watch : Watch
        Told of every stage's begin, iterations and end.

    Returns
    -------
    Outcome
        The files are in ``study.output``: report.html, fit.json, parameters.csv, figures/*.png and
        stages/*.json.

    Raises
    ------
    ConvergenceError
        A stage did not converge; its best iterate and all stages before it are kept. If it is the
        frequency-domain fit, on which nothing rests, all else is done first.
    ValueError, ModelError
        Bad input.
    """
    watch = watch or Silent()
    started = time.perf_counter()
    watch.begin("records")
    records = read_records(study)
    clock = [Timing(stage="records", seconds=time.perf_counter() - started)]
    watch.end(clock[0])
    with claimed(study.output):
        stages = _Stages(study, records, fresh, watch, clock)
        return _run(study, records, stages, watch, compare=compare)


def _run(
    study: Study,
    records: Mapping[Role, Sequence[Record]],
    stages: "_Stages",
    watch: Watch,
    *,
    compare: bool,
) -> Outcome:
    found = _identify(study, records, stages, watch)
    baseline, failure = _baseline(study, found, stages, watch)
    models: dict[str, AnyModel] = {
        BLACK_BOX: found.black_box,
        MATCH: found.hinf,
        OUTPUT_ERROR: found.output_error,
    }
    if baseline is not None:
        models[BASELINE] = baseline
    validation = stages.timed("validation", lambda: validate(models, records["validation"]))
    comparison = _comparison(study, records, found, stages, watch, compare=compare)
    report = stages.timed(
        "report",
        lambda: write_report(
            content(
                study, records, found, baseline=baseline, validation=validation,
                comparison=comparison, timings=stages.clock, warnings=stages.warnings,
            ),
            study.output,
        ),
    )  # fmt: skip
    if failure is not None:
        raise ConvergenceError(
            f"{failure}\nThe report is written without it: {report}", failure.best
        ) from failure
    return Outcome(
        identification=found, validation=validation, timings=tuple(stages.clock), report=report,
        comparison=comparison,
    )  # fmt: skip


def _identify(
    study: Study, records: Mapping[Role, Sequence[Record]], stages: "_Stages", watch: Watch
) -> Identification[Any]:
    """What the chain finds, its model in files of its own."""
    found = identify(
        study.model,
        records["identification"],
        refinement=records.get("refinement"),
        sweeps=records.get("frequency", ()),
        fixed=study.fixed,
        bounds=study.bounds,
        chain=_chain(study, watch),
        stage=stages,
    )
    found.output_error.save(study.output / "fit.json")
    write_parameters(study.output / "parameters.csv", found.output_error)
    return found


def _comparison(
    study: Study,
    records: Mapping[Role, Sequence[Record]],
    found: Identification[Any],
    stages: "_Stages",
    watch: Watch,
    *,
    compare: bool,
) -> BoundsComparison | None:
    """The study's cases compared, if that is asked for; else what an earlier run found of them."""
    chain = _chain(study, watch)

    def progress(advance: Advance) -> None:
        watch.end(Timing(stage=advance.name, seconds=advance.seconds))
        watch.begin(f"bounds, {advance.done} of {advance.total}, {advance.left} left")

    if compare:
        return stages.timed(
            "bounds", lambda: compare_study(study, records, found, chain, progress=progress)
        )
    if not comparison_path(study).exists():
        return None
    comparison = kept_comparison(study, records, found, chain)
    if comparison is None:
        LOG.warning(STALE)
        stages.warnings.append(STALE)
    return comparison


def write_parameters(path: str | Path, fit: AnyFit) -> None:
    """Write the parameter table as CSV, one row a parameter."""
    columns = [f.name for f in fields(ParameterEstimate)]
    lines = [",".join(columns)]
    for row in fit.parameters:
        values = asdict(row)
        lines.append(",".join(_cell(values[column]) for column in columns))
    write_text(path, "\n".join(lines) + "\n")


def _cell(value: Any) -> str:  # noqa: ANN401 - a field of a row
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else str(value)


class _Stages:
    """Runs stages: takes those that were kept, keeps those that are new, reports on both."""

    def __init__(
        self,
        study: Study,
        records: Mapping[Role, Sequence[Record]],
        fresh: bool,
        watch: Watch,
        clock: list[Timing],
    ) -> None:
        self._study, self._records, self._fresh = study, records, fresh
        self._watch, self.clock = watch, clock
        self.warnings: list[str] = []
        self._store = Store(study.output / "stages", type(study.model))
        self._keys: dict[str, str] = {}
        self._source = source_digest()

    def __call__(self, name: str, compute: Callable[[], T]) -> T:
        """Return the kept result of a stage, or compute and keep it."""
        key = self._keys[name] = self._key(name)
        kept = None if self._fresh else self._store.get(name, key)
        if kept is not None:
            result, entry = kept
            self.warnings += entry.warnings
            self._note(name, entry.seconds, result, kept=True)
            return cast(T, result)  # the key says it is that stage's
        self._watch.begin(name)
        start = time.perf_counter()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", DataWarning)
            computed = self._computed(name, compute)
        seconds = time.perf_counter() - start
        said = tuple(dict.fromkeys(str(each.message) for each in caught))
        self.warnings += said
        self._store.put(name, cast(Result, computed), Entry(key, seconds, said))
        self._note(name, seconds, computed)
        return computed

    def _computed(self, name: str, compute: Callable[[], T]) -> T:
        try:
            return compute()
        except ConvergenceError as error:
            if not isinstance(error.best, Fit):
                raise
            best = self._store.path(f"{name}_best")
            error.best.save(best)
            raise ConvergenceError(
                f"{error}\nThe best iterate is kept in {best} (Fit.load reads it, and its values "
                "may serve as [model.values]), and so is every stage before.", error.best
            ) from error  # fmt: skip

    def timed(self, name: str, compute: Callable[[], T]) -> T:
        """Compute a step that is not kept."""
        self._watch.begin(name)
        start = time.perf_counter()
        result = compute()
        self._note(name, time.perf_counter() - start, result)
        return result

    def _note(self, name: str, seconds: float, result: object, *, kept: bool = False) -> None:
        timing = Timing(stage=name, seconds=seconds, kept=kept)
        if isinstance(result, Fit):
            timing = replace(timing, iterations=result.iterations, cost=result.cost)
        self.clock.append(timing)
        self._watch.end(timing)

    def _key(self, name: str) -> str:
        study = self._study
        before, role, table = NEEDS[name]
        if role == "refinement" and role not in self._records:
            role = "identification"
        parts: list[Any] = [self._source, [self._keys.get(stage, "") for stage in before]]
        parts += [study.options.get(table, {}), study.solver.get(table, {})]
        if role is not None:
            parts.append(self._records[role])
        if name in STRUCTURED:
            parts += [study.model_file.read_text(encoding="utf-8"), asdict(study.model)]
            parts += [study.fixed, study.bounds, study.targets]
        return digest(*parts)


def _chain(study: Study, watch: Watch) -> Chain:
    given = study.options
    match, refine = (
        replace(study.solver_options(stage), progress=watch.progress)
        for stage in ("match", "output_error")
    )
    return Chain(
        pbsid=given.get("pbsid", {}),
        frequency=given.get("frequency", {}),
        match=Match(**given.get("match", {}), solver=match),
        output_error=OutputError(**given.get("output_error", {}), solver=refine),
        join=len(study.targets) > 1,
    )


def _baseline(
    study: Study, found: Identification[Any], stages: _Stages, watch: Watch
) -> tuple[AnyFit | None, ConvergenceError | None]:
    """The frequency-domain fit, if the study has a table for it and a measured response.

    Nothing rests on it: what the study found is shown even if it fails.
    """
    measured = found.frequency_response
    if "derivid" not in study.options or measured is None:
        return None, None
    options = replace(study.solver_options("derivid"), progress=watch.progress)

    def compute() -> AnyFit:
        estimator = Derivid(**study.options["derivid"], solver=options)
        return estimator.fit(
            found.quadratic.model, measured, fixed=study.fixed, bounds=study.bounds
        )

    try:
        return stages("derivid", compute), None
    except ConvergenceError as error:
        stages.warnings.append(f"The frequency-domain fit is missing. {error}")
        return None, error
