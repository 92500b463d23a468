"""The stage that refines the match on records, by output error."""

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from casid.declaration import check_priors
from casid.errors import ConvergenceError, warn
from casid.fit import AnyFit, Fit
from casid.model import Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.records import steps_told
from casid.report.answer import doubted, not_believed
from casid.report.content import CHOSEN, Caution, Content, Section, enough, section
from casid.report.content import OUTPUT_ERROR as LABEL
from casid.report.evidence import few_data
from casid.report.intervals import SHAPES, TICKS
from casid.report.verdicts import held_by_bounds, uncertain
from casid.shooting.homogeneity import OPPOSED
from casid.shooting.output_error import OutputError
from casid.shooting.precision import OutputErrorNotes
from casid.shooting.priors import CONTRADICTS
from casid.shooting.selection import checked_covariance, select_records
from casid.shooting.strategies import Ways
from casid.stages.stage import Stage, Task
from casid.tables import placed
from casid.threads import one_thread

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
    if task.hold is None and any(record.hold == "foh" for record in task.records):
        for said in _of_steps(task, _better_as_steps(settings, found, task.records)):
            warn(said)
    return found


def _of_steps(task: Task, better: float) -> list[str]:
    """What to say of inputs that are read as straight lines because nothing else was stated."""
    seen = steps_told(task.records, task.model.delays())
    if better < CLEARLY:
        return [f"{said}; here the records are not clearly more likely with steps" for said in seen]
    half = 500 * max(record.dt for record in task.records)
    return [
        "inputs are read as straight lines between samples, as no hold was stated; the records are "
        f"e^{better:.0f} times as likely with steps, held until the next sample, with delays up to "
        f'{half:.3g} ms shorter: read them so, hold = "zoh" (read_csv, [channels] of a study), or '
        'state "foh" if the actuators do move in lines'
    ]


def _better_as_steps(
    settings: OutputError, fit: Fit[Any, OutputErrorNotes], records: Sequence[Record]
) -> float:
    """By how much the log-likelihood gains where inputs are held between samples, -inf if unknown.

    Steps are half a sample later than lines, so much shorter are delays; the rest is as it was, and
    prior values count on both sides. Measured responses count on none: those estimated from records
    that are read as lines speak for lines.
    """
    model, half = fit.model, max(record.dt for record in records) / 2
    late = {
        each.name: max(each.value - half, each.lower)
        for each in (fit[name] for name in fit.free_names)
        if replace(model, **{each.name: each.value + 1.0}).delays() != model.delays()
    }
    kept = [name for name in fit.free_names if name not in late][:1]  # one has to be free
    held = [name for name in model.parameter_names() if name not in kept]
    steps, read = [replace(record, hold="zoh") for record in records], replace(model, **late)
    names = sorted({*held} & {*fit.free_names} & {*(priors := settings.priors or {})})

    def cost(at: Any, flown: Sequence[Record]) -> float:  # noqa: ANN401 - model of whatever class
        off = [(getattr(at, name) - priors[name][0]) / priors[name][1] for name in names]
        plain = replace(settings, responses=())
        return _cost(plain, at, flown, held, fit) + float(np.square(off).sum()) / 2

    try:
        lines = cost(model, records) if settings.responses else fit.cost
        return lines - cost(read, steps)
    except (ValueError, ConvergenceError):  # nothing is told where it fails
        return -np.inf


@one_thread
def _cost(
    settings: OutputError,
    model: Model,
    records: Sequence[Record],
    held: Sequence[str],
    near: Fit[Any, OutputErrorNotes],
) -> float:
    """Negative log-likelihood at a fit's parameters but for those ``held`` at the model's.

    Only initial states, biases and R follow where they are all that may, without another fit.
    """
    if settings.domain != "time" or settings.process_noise is not False:
        return settings.fit(model, records, fixed=held, near=near).cost
    free, R = settings.free(model, held), checked_covariance(settings.R, len(model.outputs))
    biases, integration = bool(settings.biases), near.notes.integration
    chosen = select_records(free, records, biases)
    steps = integration.steps if integration else settings.steps
    return Ways(free, chosen, settings.solver, R, biases, near.interval, steps).cost_beside(near)


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
    known = (
        Caution(each, 3) for each in content.warnings if each.startswith((CONTRADICTS, OPPOSED))
    )
    said = (*known, *held_by_bounds(last), *few_data(last, content), *doubts)
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
