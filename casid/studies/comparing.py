"""The comparison of bounds that a study file asks for."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from casid.bounds.compare import BoundsComparison, compare_bounds
from casid.chain import Identification, Options
from casid.files import write_text
from casid.fit import Fit
from casid.jobs.campaigns import Advance
from casid.nlp import SolverOptions
from casid.record import Record
from casid.studies.study import Role, Study


def compare_study(
    study: Study,
    records: Mapping[Role, Sequence[Record]],
    found: Identification,
    options: Options,
    *,
    executor: Executor | None = None,
    progress: Callable[[Advance], None] | None = None,
) -> BoundsComparison:
    """Compare a study's cases, from what its stages found; tables go to its folder.

    Each case is kept in ``bounds/`` when it is done; bounds.csv, bounds_cases.csv and bounds.md
    hold the tables.

    Raises
    ------
    ValueError
        A study without cases, or "derivid" without a measured response.
    """
    if not study.comparison:
        raise ValueError(f"{study.path}: there is no table [bounds] with cases to compare")
    data, start, settings = _task(study, records, found, options)
    comparison = compare_bounds(
        study.model, data, cases=study.comparison["cases"], start=start, fixed=study.fixed,
        bounds=study.bounds, estimator=study.comparison["estimator"],
        validation=records["validation"], folder=study.output / "bounds", executor=executor,
        progress=progress, **settings, **study.comparison["settings"],
    )  # fmt: skip
    comparison.to_csv(comparison_path(study))
    write_text(study.output / "bounds.md", comparison.to_markdown() + "\n")
    return comparison


def comparison_path(study: Study) -> Path:
    """The table that a finished comparison leaves."""
    return study.output / "bounds.csv"


def kept_comparison(
    study: Study, records: Mapping[Role, Sequence[Record]], found: Identification, options: Options
) -> BoundsComparison | None:
    """The study's comparison, if every case is kept as the study is now; nothing is fitted."""
    if not study.comparison:
        return None
    try:
        return compare_study(study, records, found, options, executor=_Idle())
    except (_NotKeptError, ValueError):  # ValueError: the cases no longer fit the study
        return None


class _NotKeptError(Exception):
    """A case would have to be fitted."""


class _Idle(Executor):
    """Refuses all work: what is kept needs none."""

    def submit(self, *_: Any, **__: Any) -> Future[Any]:  # noqa: ANN401 - of any work
        """Refuse."""
        raise _NotKeptError


def _task(
    study: Study, records: Mapping[Role, Sequence[Record]], found: Identification, options: Options
) -> tuple[Any, Fit, dict[str, Any]]:
    """Data, start and keyword arguments of the estimator."""
    estimator = study.comparison["estimator"]
    refinement = records.get("refinement") or records["identification"]
    quiet = {stage: replace(each, progress=None) for stage, each in options.solver.items()}
    own = dict(study.options.get(estimator, {}))
    own["options"] = quiet.get(estimator, SolverOptions())
    if estimator == "output_error":
        return refinement, found.output_error, own
    if estimator == "chain":
        chain = replace(options, solver=quiet)
        return records["identification"], found.quadratic, {
            "refinement": refinement, "black_box": found.black_box, "options": chain,
            "sweeps": records.get("frequency", ()),
        }  # fmt: skip
    measured = found.frequency_response
    if estimator == "match":
        joined = options.join and measured is not None
        return [found.black_box, measured] if joined else [found.black_box], found.quadratic, own
    if measured is None:
        raise ValueError(f"{study.path}: derivid needs records: write [records.frequency]")
    own["options"] = study.solver_options("derivid")
    return measured, found.quadratic, own
