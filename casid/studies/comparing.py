"""The comparison of bounds that a study file asks for."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from casid.bounds.compare import BoundsComparison, compare_bounds
from casid.chain import Chain, Identification
from casid.files import write_text
from casid.fit import AnyFit
from casid.jobs.campaigns import Advance
from casid.record import Record
from casid.studies.study import Role, Study


def compare_study(
    study: Study,
    records: Mapping[Role, Sequence[Record]],
    found: Identification[Any],
    chain: Chain,
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
    data, start, settings = _task(study, records, found, chain)
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
    study: Study, records: Mapping[Role, Sequence[Record]], found: Identification[Any], chain: Chain
) -> BoundsComparison | None:
    """The study's comparison, if every case is kept as the study is now; nothing is fitted."""
    if not study.comparison:
        return None
    try:
        return compare_study(study, records, found, chain, executor=_Idle())
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
    study: Study, records: Mapping[Role, Sequence[Record]], found: Identification[Any], chain: Chain
) -> tuple[Any, AnyFit, dict[str, Any]]:
    """Data, start and keyword arguments of the estimator."""
    estimator = study.comparison["estimator"]
    refinement = records.get("refinement") or records["identification"]
    own = dict(study.options.get(estimator, {})) | {"solver": study.solver_options(estimator)}
    if estimator == "output_error":
        return refinement, found.output_error, own
    if estimator == "chain":
        quiet = replace(
            chain,
            match=replace(chain.match, solver=study.solver_options("match")),
            output_error=replace(chain.output_error, solver=study.solver_options("output_error")),
            black_box=found.black_box,
            refinement=refinement,
            sweeps=records.get("frequency", ()),
        )
        settings = {each.name: getattr(quiet, each.name) for each in fields(quiet)}
        return records["identification"], found.quadratic, settings
    measured = found.frequency_response
    if estimator == "match":
        joined = chain.join and measured is not None
        return [found.black_box, measured] if joined else [found.black_box], found.quadratic, own
    if measured is None:
        raise ValueError(f"{study.path}: derivid needs records: write [records.frequency]")
    return measured, found.quadratic, own
