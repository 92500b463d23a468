"""The stage that compares what bounds cost: one fit a case."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from casid import report
from casid.bounds.cases import read_cases
from casid.bounds.compare import BoundsComparison, compare_bounds
from casid.estimator import Estimator
from casid.fit import AnyFit
from casid.report.content import Content, Section, section
from casid.stages.chain import CHAIN, Chain
from casid.stages.stage import Stage, Task, lacking, records_of, runnable
from casid.textfile import write_texts

WHOLE = "chain"


@dataclass(frozen=True, eq=False, kw_only=True)
class Cases:
    """What is compared."""

    estimator: str = "output_error"  # table of its stage, or chain for all of them
    norm: str | None = None  # of a match
    cases: Mapping[str, Any] = field(default_factory=dict)  # as casid.bounds.cases reads them


def _check(settings: Cases, task: Task) -> None:
    """Refuse what is no estimator and cases that are not understood."""
    known = [WHOLE, *dict.fromkeys(each.table for each in task.stages if each.data is not None)]
    if settings.estimator not in known:
        raise ValueError(
            f"[bounds] estimator = {settings.estimator!r}, expected one of {', '.join(known)}"
        )
    stage = _stage(settings, task)
    if stage is not None and any(name not in runnable(task) for name in stage.needs):
        raise ValueError(
            f"[bounds] by {settings.estimator}: {lacking(stage, task, runnable(task))}"
        )
    if settings.norm is not None and "norm" not in (() if stage is None else stage.given):
        raise ValueError(f"[bounds] {settings.estimator} has no norm; leave it out")
    if not settings.cases:
        raise ValueError("[bounds] there is no table [bounds.cases] with cases to compare")
    for name, case in settings.cases.items():
        if not isinstance(case, Mapping | Sequence):
            raise ValueError(  # noqa: TRY004 - bad input
                f"[bounds.cases] {name} = {case!r}, expected a table, relations or text"
            )
    read_cases(task.model, settings.cases, tuple(task.fixed), task.bounds)


def _stage(settings: Cases, task: Task) -> Stage | None:
    """The last stage of the estimator's table; None for all stages together."""
    known = (each for each in task.stages[::-1] if each.data is not None)
    return next((each for each in known if each.table == settings.estimator), None)


def _run(settings: Cases, task: Task) -> BoundsComparison:
    estimator, data, start = _estimation(settings, task)
    found = compare_bounds(
        task.model,
        data,
        cases=settings.cases,
        start=start,
        fixed=tuple(task.fixed),
        bounds=task.bounds,
        estimator=estimator,
        validation=task.records,
        execution=task.execution,
    )
    if task.execution.folder is not None:
        folder = Path(task.execution.folder)
        page = {folder.with_suffix(".md"): found.to_markdown() + "\n"}
        write_texts({**found.csv_files(folder.with_suffix(".csv")), **page})
    return found


def _estimation(settings: Cases, task: Task) -> tuple[Estimator, Any, AnyFit]:
    """Estimator, data and start of all cases."""
    roles, results = task.roles, task.results
    stage = _stage(settings, task)
    if stage is None:
        tables = {each.table for each in CHAIN}
        chain = Chain(
            settings={name: own for name, own in task.settings.items() if name in tables},
            black_box=results["pbsid"],
            refinement=tuple(roles.get("refinement", ())),
            sweeps=tuple(roles.get("frequency", ())),
        )
        return chain, tuple(roles["identification"]), results["quadratic"]
    estimator = task.settings.get(stage.table, stage.settings)
    if settings.norm is not None:
        estimator = replace(estimator, norm=settings.norm)
    take = cast(Callable[[Any, Task], Any], stage.data)
    data = take(estimator, replace(task, records=records_of(stage, roles)))
    return estimator, data, results[stage.start]


def _show(found: BoundsComparison, content: Content) -> Iterable[Section]:  # noqa: ARG001
    most = max((case.increase for case in found.cases if np.isfinite(case.increase)), default=0.0)
    more: Any = {"values": {"dearest": most}, "draw": partial(report.drawings.draw_bounds, found)}
    yield section("bounds", "Comparison of bounds", 30, found, **more)


COMPARISON = Stage(
    name="bounds",
    does="comparison of bounds",
    run=_run,
    table="bounds",
    settings=Cases(),
    role=("validation",),
    needs=("output_error",),
    optional=True,
    kept=False,
    command="bounds",
    check=_check,
    show=_show,
)
