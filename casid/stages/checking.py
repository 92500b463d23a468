"""The stages that show states measured beside the outputs, with the model's: check channels.

No estimate sees them, so they test what a model says of the states that its outputs hide.
"""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from casid import report
from casid.arrays import Array
from casid.errors import DataWarning
from casid.fit import Fit
from casid.frequency.estimation import SpectralAnalysis
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.nonlinear.model import NonlinearModel
from casid.prediction import PredictionPlan, predict, prediction_plan
from casid.record import Record
from casid.records import standard_deviations
from casid.report.content import Content, Section, section
from casid.samples import known_mean
from casid.shooting.simulation import predict_nonlinear
from casid.stages.stage import LeftOutError, Stage, Task
from casid.validation import Validation, measures, state_space


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredStates:
    """States of every fit beside what was measured of them.

    Parameters
    ----------
    states : tuple of str
        Those measured by check channels.
    shown : Validation
        The validation with the states in place of the outputs.
    table : mapping
        RMS error, fit [%] and Theil's coefficient of each state and model, all records together.
    """

    states: tuple[str, ...]
    shown: Validation
    table: Mapping[tuple[str, str], tuple[float, float, float]]


def _states(task: Task) -> tuple[str, ...]:
    """States that no output shows and a check channel does; `LeftOutError` if there are none."""
    known = next((records[0].outputs for records in task.checks.values()), ())
    hidden = [name for name in task.model.states if name not in task.model.outputs]
    states = tuple(name for name in hidden if name in known)
    if not states:
        raise LeftOutError
    return states


def _spectra(settings: object, task: Task) -> FrequencyResponse:  # noqa: ARG001 - it has none
    names = _states(task)
    own: SpectralAnalysis = replace(
        task.settings.get("frequency", SpectralAnalysis()), reference=()
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # the stage of the outputs says the same
        return own.fit([record.select(outputs=names) for record in task.checks["frequency"]])


def _compared(settings: object, task: Task) -> MeasuredStates:  # noqa: ARG001 - it has none
    states, found = _states(task), task.results["validation"]
    flights = [record.select(outputs=states) for record in task.checks["validation"]]
    fits = {name: each for name, each in task.models.items() if isinstance(each, Fit)}
    systems = [state_space(each) for each in task.models.values()]
    pairs = list(zip(found.measured, flights, strict=True))
    far = [
        prediction_plan(systems, pair[0], horizon, found.closed_loop)
        for pair, horizon in zip(pairs, found.horizon, strict=True)
    ]
    scale = standard_deviations(found.measured)[1]  # as the validation weighs
    simulated = {
        name: tuple(_simulated(fit, *pair, scale, a) for pair, a in zip(pairs, far, strict=True))
        for name, fit in fits.items()
    }
    shown = replace(
        found,
        models=tuple(fits),
        outputs=states,
        measured=tuple(flights),
        simulated=simulated,
        known=dict.fromkeys(fits, states),
    )
    table = {
        (state, name): measures(shown, name, i) for i, state in enumerate(states) for name in fits
    }
    return MeasuredStates(states=states, shown=shown, table=table)


def _simulated(
    fit: Fit[Any, Any], record: Record, flight: Record, scale: Array, far: PredictionPlan
) -> Array:
    """States (N, n) as the validation had them, constant biases against the measured removed."""
    if isinstance(fit.model, NonlinearModel):
        places = [fit.model.states.index(name) for name in flight.outputs]
        y = predict_nonlinear(fit.model, record, scale, far).states[:, places]
    else:
        y = _linear_states(state_space(fit), record, flight, scale, far)
    return np.asarray(y + known_mean(flight.y - y))


def _linear_states(
    system: StateSpace, record: Record, flight: Record, scale: Array, far: PredictionPlan
) -> Array:
    """States (N, n) of a linear model, as outputs that nothing measures beside its own."""
    extra = report.drawings.with_states(system, flight.outputs)
    both = replace(
        system,
        C=np.vstack([system.C, extra.C]),
        D=np.vstack([system.D, extra.D]),
        outputs=(*system.outputs, *flight.outputs),
    )
    unseen = np.full(flight.y.shape, np.nan)  # only the outputs tell where the state begins
    names = (*record.outputs, *flight.outputs)
    whole = replace(record, y=np.hstack([record.y, unseen]), outputs=names)
    return predict(both, whole, np.r_[scale, np.ones(flight.ny)], far).y[:, record.ny :]


def _show(found: MeasuredStates, content: Content) -> Iterable[Section]:
    draw = partial(report.drawings.draw_histories, found.shown, content.units)
    values = {"units": content.units}
    yield section("states", "Measured states", 65, found, values=values, draw=draw)


CHECKED = Stage(
    name="checked",
    does="measured response of states",
    run=_spectra,
    role=("frequency",),
    needs=("frequency",),
    kept=False,
    ahead=True,
)
STATES = Stage(
    name="states",
    does="measured states beside the model's",
    run=_compared,
    role=("validation",),
    needs=("validation",),
    kept=False,
    show=_show,
)
