"""The stage that fits measured responses in decibels and degrees, to compare with."""

from collections.abc import Iterable
from typing import Any

from casid.baseline.accuracy import DerividNotes
from casid.baseline.derivid import Derivid
from casid.bounds.replaceable import told_by
from casid.declaration import check_priors
from casid.fit import Fit
from casid.free import free_parameters
from casid.records import still
from casid.report.content import BASELINE as LABEL
from casid.report.content import Content, Section, section
from casid.report.evidence import misfit
from casid.stages.stage import Stage, Task
from casid.tables import placed


def _check(settings: Derivid, task: Task) -> None:
    with placed("[derivid]"):
        free_parameters(task.model, **task.held, priors=settings.priors)
        check_priors(task.model, settings.priors, **task.held)


def _examine(settings: Derivid, task: Task) -> None:
    """Refuse free parameters of inputs alone that no record of the response moves."""
    idle = still(task.roles["frequency"], task.model.inputs)
    known = settings.priors or {}
    names = [name for name in told_by(task.model, idle, **task.held) if name not in known]
    if not names:
        return
    held = ", ".join(f'"{name}"' for name in names)
    raise ValueError(
        f"[derivid]: no record of [records.frequency] moves {', '.join(idle)}, and no response "
        f"tells {', '.join(names)}: add a sweep that moves {', '.join(idle)}, leave the table "
        f"[derivid] out, or hold these in all stages ([model] fixed = [{held}])"
    )


def _run(settings: Derivid, task: Task) -> Fit[Any, DerividNotes]:
    start = task.results["quadratic"].model
    with placed("[derivid]:"):
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
    examine=_examine,
    show=_show,
)
