"""The stage that fits measured responses in decibels and degrees, to compare with."""

from collections.abc import Iterable
from typing import Any

from casid.baseline.accuracy import DerividNotes
from casid.baseline.derivid import Derivid
from casid.declaration import check_priors
from casid.fit import Fit
from casid.free import free_parameters
from casid.report.content import BASELINE as LABEL
from casid.report.content import Content, Section, section
from casid.report.evidence import misfit
from casid.stages.stage import Stage, Task
from casid.tables import placed


def _check(settings: Derivid, task: Task) -> None:
    with placed("[derivid]"):
        free_parameters(task.model, **task.held, priors=settings.priors)
        check_priors(task.model, settings.priors, **task.held)


def _run(settings: Derivid, task: Task) -> Fit[Any, DerividNotes]:
    start = task.results["quadratic"].model
    return settings.fit(start, task.results["frequency"], **task.held)


def _show(found: Fit[Any, DerividNotes], content: Content) -> Iterable[Section]:  # noqa: ARG001
    yield section("baseline", "Frequency-domain fit", 20, found, cautions=tuple(misfit(found)))


BASELINE = Stage(
    name="derivid",
    does="frequency-domain fit",
    run=_run,
    table="derivid",
    settings=Derivid(),
    needs=("frequency", "quadratic"),
    linear=True,
    structured=True,
    optional=True,
    ahead=True,
    label=LABEL,
    start="quadratic",
    data=lambda _, task: task.results["frequency"],
    check=_check,
    show=_show,
)
