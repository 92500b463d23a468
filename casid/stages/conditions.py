"""The stage that shows a nonlinear structure over the speeds of its records."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np

from casid import report
from casid.display import listed
from casid.envelope import Envelope, envelope, flight_condition
from casid.errors import ConvergenceError, ModelError, warn
from casid.model import Model
from casid.nonlinear.balance import unbalanced
from casid.nonlinear.conditions import Trim
from casid.nonlinear.coverage import SPEEDS
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.tables import spline
from casid.record import Record
from casid.report.content import Caution, Content, Section, section
from casid.stages.refinement import OUTPUT_ERROR
from casid.stages.stage import Stage, Task

TOGETHER = 0.05  # of the largest speed: records whose speeds differ less share a condition
TOLD = 3  # entries off, in a caution
OFF = (
    "Fits to the records of one speed differ from the one model by more than the errors of both "
    "allow: {}. A trim, unit or gain of the records there is wrong, or how the structure depends "
    "on speed; standard errors include neither."
)
POINTS = 12  # speeds at which curves are drawn


@dataclass(frozen=True, kw_only=True)
class OverSpeed:
    """What is shown over speed.

    Parameters
    ----------
    entries : tuple of str
        Derivatives, ``"q by lon"``.
    held : tuple of str
        Parameters, or patterns of their names as ``"*_V"``, that local fits to the records of one
        speed hold; without any there are no local fits.
    """

    entries: tuple[str, ...] = ()
    held: tuple[str, ...] = ()

    def pairs(self) -> list[tuple[str, str]]:
        """State and channel of each entry."""
        parts = [each.split(" by ") for each in self.entries]
        for each, part in zip(self.entries, parts, strict=True):
            if len(part) != 2:
                raise ValueError(f'entries: {each!r}, expected such as "q by lon"')
        return [(state.strip(), channel.strip()) for state, channel in parts]


def flight_conditions(
    model: NonlinearModel, records: Sequence[Record]
) -> list[tuple[Trim, tuple[Record, ...]]]:
    """Flight conditions by speed, each with its records; their trims are means.

    ModelError: a record without a speed.
    """
    flown = [(flight_condition(model, record), record) for record in records]
    for trim, record in flown:
        if not np.isfinite(trim.speed):
            raise ModelError(
                f"record {record.name!r} has no airspeed, {' or '.join(SPEEDS)}: measure it, or "
                "say it in the trim of its role"
            )
    flown.sort(key=lambda each: each[0].speed)
    apart = TOGETHER * max(abs(trim.speed) for trim, _ in flown)
    groups = [[flown[0]]]
    for each in flown[1:]:
        if each[0].speed - groups[-1][0][0].speed > apart:  # of the slowest, lest they be a chain
            groups.append([])
        groups[-1].append(each)
    return [(_mean([trim for trim, _ in some]), tuple(r for _, r in some)) for some in groups]


def _mean(trims: Sequence[Trim]) -> Trim:
    """The mean of trims of one condition."""
    names = [name for name in trims[0].values if all(name in each.values for each in trims)]
    values = {name: float(np.mean([each.values[name] for each in trims])) for name in names}
    speed = float(np.mean([each.speed for each in trims]))
    return Trim(name=f"{speed:.4g} m/s", values=values, speed=speed)


def _between(trims: Sequence[Trim]) -> list[Trim]:
    """Trims along the natural splines through those of the conditions."""
    if len(trims) < 2:
        return list(trims)
    knots = [each.speed for each in trims]
    along = np.linspace(knots[0], knots[-1], POINTS)
    names = [name for name in trims[0].values if all(name in each.values for each in trims)]
    curves = {name: [each.values[name] for each in trims] for name in names}
    return [
        Trim(
            name=f"{V:.4g} m/s",
            values={name: float(spline(V, knots, curve)) for name, curve in curves.items()},
            speed=float(V),
        )
        for V in along
    ]


def _check(settings: OverSpeed, task: Task) -> None:
    if not isinstance(task.model, NonlinearModel):
        raise ModelError(
            f"[envelope] {type(task.model).__name__} is linear, the same at every speed; give a "
            "nonlinear structure, or leave the table out"
        )
    if not settings.entries:
        raise ValueError('[envelope] entries are missing: name derivatives, ["q by lon"]')
    channels = *task.model.states, *task.model.inputs
    for state, by in settings.pairs():
        if state not in task.model.states or by not in channels:
            raise ValueError(f"[envelope] entries: no derivative of {state!r} by {by!r}")
    for pattern in settings.held:
        if not any(fnmatchcase(name, pattern) for name in task.model.parameter_names()):
            raise ValueError(f"[envelope] held: no parameter is called {pattern!r}")
    free = set(task.model.parameter_names()) - set(task.fixed)
    if settings.held and not free - set(_held(settings, task.model)):
        raise ValueError(
            f"[envelope] held = {list(settings.held)} leaves local fits nothing to estimate: name "
            "what records of one speed cannot tell, or leave it out"
        )


def _held(settings: OverSpeed, model: Model) -> list[str]:
    """Parameters that local fits hold."""
    names = model.parameter_names()
    return [n for n in names if any(fnmatchcase(n, pattern) for pattern in settings.held)]


def _run(settings: OverSpeed, task: Task) -> Envelope:
    fit = task.results["output_error"]
    found, local = flight_conditions(fit.model, task.records), {}
    if held := _held(settings, task.model):
        estimator = task.settings.get(OUTPUT_ERROR.table, OUTPUT_ERROR.settings)
        own: Any = {"fixed": (*task.fixed, *held), "bounds": task.bounds}
        for trim, records in found:
            try:
                local[trim] = estimator.fit(fit.model, records, **own)
            except (ValueError, ConvergenceError) as error:
                warn(f"[envelope] the local fit at {trim.name} is left out: {error}")
    return envelope(fit, _between([trim for trim, _ in found]), settings.pairs(), local=local)


def _show(found: Envelope, content: Content) -> Iterable[Section]:
    low, high = found.speed[0], found.speed[-1]
    lead = f"It is shown from {low:.3g} to {high:.3g} m/s, the speeds of its records."
    draw = partial(report.envelopes.draw_envelope, found)
    said = [Caution(unbalanced(content.model, found.doubts), 6)] if found.doubts else []
    if found.apart:
        more = f", and {len(found.apart) - TOLD} more" if len(found.apart) > TOLD else ""
        said.insert(0, Caution(OFF.format(listed(found.apart[:TOLD]) + more), 3))
    yield section("envelope", "Over speed", 35, found, draw=draw, lead=lead, cautions=said)


CONDITIONS = Stage(
    name="envelope",
    does="derivatives and modes over speed",
    run=_run,
    table="envelope",
    settings=OverSpeed(),
    role=OUTPUT_ERROR.role,
    needs=("output_error",),
    structured=True,
    optional=True,
    kept=False,
    check=_check,
    show=_show,
)
