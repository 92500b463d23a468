"""The stage that refines the match on records, by output error."""

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any

from casid.declaration import check_priors
from casid.errors import ConvergenceError, warn
from casid.fit import AnyFit, Fit
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import steps_told
from casid.report.answer import doubted, not_believed
from casid.report.content import CHOSEN, Content, Section, enough, section
from casid.report.content import OUTPUT_ERROR as LABEL
from casid.report.evidence import few_data
from casid.report.intervals import SHAPES, TICKS
from casid.report.verdicts import held_by_bounds, uncertain, unsolved
from casid.shooting.output_error import OutputError
from casid.shooting.precision import OutputErrorNotes
from casid.stages.stage import Stage, Task
from casid.tables import placed

CLEARLY = 10.0  # of the logarithm of a likelihood: other inputs between samples explain records


def _records(settings: OutputError, task: Task) -> tuple[Record, ...]:  # noqa: ARG001
    return task.records


def _check(settings: OutputError, task: Task) -> None:
    with placed("[output_error]"):
        settings.free(task.model, **task.held)
        check_priors(task.model, settings.priors, **task.held)


def _run(settings: OutputError, task: Task) -> Fit[Any, OutputErrorNotes]:
    matched = task.results.get("hinf")
    found = settings.fit(matched.model if matched else task.model, task.records, **task.held)
    for said in steps_told(task.records, task.model.delays()):
        warn(f"{said}{_read_as_steps(settings, found, task.records)}")
    return found


def _read_as_steps(
    settings: OutputError, fit: Fit[Any, OutputErrorNotes], records: Iterable[Record]
) -> str:
    """Whether inputs held between the samples explain records better, delays alone refitted."""
    model, late = fit.model, {}
    for name in fit.free_names:
        if replace(model, **{name: fit[name].value + 1.0}).delays() != model.delays():
            late[name] = fit[name].value - max(record.dt for record in records) / 2
    start, steps = replace(model, **late), [replace(record, hold="zoh") for record in records]
    rest = [name for name in model.parameter_names() if name not in late]
    try:
        other = settings.fit(start, steps, fixed=rest, near=fit) if late else fit
    except (ValueError, ConvergenceError):  # nothing is told where it fails
        return ""
    better = fit.cost - other.cost
    if better > CLEARLY:
        return f"; here the records are e^{better:.0f} times as likely with steps: read them so"
    return "; here the records are not clearly more likely with steps" * bool(late)


def _show(found: Fit[Any, OutputErrorNotes], content: Content) -> Iterable[Section]:
    last: AnyFit = content.results.get("chosen", found)  # what fit.json holds
    label = CHOSEN if "chosen" in content.results else LABEL
    model, infos = last.model, type(last.model).infos()
    plain = (f.name for f in fields(model) if f.name not in infos)
    values = {
        "others": {name: fit for name, fit in content.fits.items() if name != label},
        "doubted": doubted(content, last),
        "label": label,
        "shapes": SHAPES,
        "ticks": TICKS,
        "trim": {name: getattr(model, name) for name in plain},
    }
    free = len(last.free_names) or len(last.parameters)
    lead = f"Its {free} free parameters were refined by output error."
    if last is not found:
        lead = f"Its {free} free parameters are those of the {label}, {last.method}."
    if isinstance(model, NonlinearModel) and "hinf" not in content.results:
        lead = (
            f"Its {free} free parameters were estimated by output error on total values; black box "
            "and match are of one flight condition and were left out."
        )
    doubts = uncertain(last, lacking=enough(content.results) is False)
    said = (*unsolved(last), *held_by_bounds(last), *few_data(last, content), *doubts)
    more: Any = {"answer": not_believed(content, last), "lead": lead, "cautions": said}
    yield section("parameters", "Parameters", 10, last, values=values, **more)


OUTPUT_ERROR = Stage(
    name="output_error",
    does="output error",
    run=_run,
    table="output_error",
    settings=OutputError(),
    role=("refinement", "identification"),
    uses=("hinf",),
    structured=True,
    label=LABEL,
    start="output_error",
    data=_records,
    check=_check,
    show=_show,
)
