"""How well models predict records they have not seen: λ stays, initial state and biases follow.

Measures as in M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", Fig. 11 (RMS divided by the largest among the models), and R. Jategaonkar, Flight Vehicle
System Identification, chapter 11 (Theil's coefficient, whiteness of the residuals).

A model is simulated over each record; where one grows too much over it, all are predicted piece by
piece, over a horizon that the result states (`casid.prediction`); a nonlinear one in totals.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array, BoolArray
from casid.checks import check_known
from casid.display import Shown, counted, listed
from casid.fit import AnyFit, Fit
from casid.goodness_of_fit import fit_percent, rms_error, theil_coefficient, whiteness
from casid.linear import StateSpace
from casid.model import Model
from casid.nonlinear.coverage import joined_spans, warn_beyond
from casid.nonlinear.model import NonlinearModel
from casid.prediction import (
    PER_UNKNOWN,
    Prediction,
    PredictionPlan,
    growth_rate,
    movement,
    predict,
    prediction_plan,
)
from casid.record import Record
from casid.records import Records, datum, same_channels, standard_deviations, stretches
from casid.shooting.simulation import predict_nonlinear
from casid.slow_sources import tell_repeats
from casid.subspace.pbsid import BlackBox
from casid.threads import one_thread

AnyModel = Model | AnyFit | BlackBox | StateSpace


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Validation(Shown):
    """Measures of every model on every record; each mapping goes from a model's name to an array.

    Parameters
    ----------
    models, records, outputs, inputs : tuple of str
        Names; of the channels, those of the records.
    rms : mapping to (records, ny) array
        Root mean square of the residual, in the unit of the output; infinite of a model that runs
        out of all numbers where it should predict, whose fit is -inf, Theil's coefficient 1 and
        whiteness 0.
    normalised : mapping to (records, ny) array
        The same divided by the largest among the models: the worst has 1.
    fit : mapping to (records, ny) array
        100 (1 - ‖y - ŷ‖ / ‖y - mean y‖) [%].
    theil : mapping to (records, ny) array
        Theil's inequality coefficient rms(y - ŷ) / (rms y + rms ŷ): 0 is perfect, 1 useless. Both
        are deviations, see `datum`: beside an airspeed of 30 m/s every error would look small.
    whiteness : mapping to (records, ny) array
        Share of the residual's autocorrelations at lags of 1 to 40 samples inside the 99 % band of
        a white sequence: about 0.99 when white, near 0 when the model has missed dynamics; says
        nothing of predictions, see ``horizon``. Missing samples are passed over.
    measured : tuple of Record
        The records.
    simulated : mapping to tuple of (N, ny) array
        Outputs of each model on each record, biases included.
    initial_states : mapping to tuple of (nx,) array
        Estimated state at the first sample; meaningless where a mode leaves no trace in the record.
    biases : mapping to (records, ny) array
        Estimated constant of each output, the mean over all predictions; of `unbiased` ones zero.
    horizon : tuple of float
        How far ahead models were predicted in each record [s], each time from a state estimated on
        the past alone, whose error colours all of the piece; infinite where they were simulated
        over all of it.
    begins : tuple of int
        Sample of each record at which predictions begin, 0 where it was simulated. An output that
        moves more before is `missed`: NaN for fit and Theil's coefficient.
    known : mapping to tuple of str
        Outputs that each model has.
    growth : mapping to float
        Rate [1/s] of each model's fastest growing mode; 0 of a stable one.
    closed_loop : bool
        Whether inputs ahead were taken for answers that keep outputs bounded.
    unbiased : tuple of str
        Outputs of which no model was given a constant.

    A model that lacks an output has NaN there, and so have all models before the first prediction.
    """

    models: tuple[str, ...]
    records: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: Mapping[str, Array]
    normalised: Mapping[str, Array]
    fit: Mapping[str, Array]
    theil: Mapping[str, Array]
    whiteness: Mapping[str, Array]
    measured: tuple[Record, ...]
    simulated: Mapping[str, tuple[Array, ...]]
    initial_states: Mapping[str, tuple[Array, ...]]
    biases: Mapping[str, Array]
    horizon: tuple[float, ...]
    begins: tuple[int, ...]
    known: Mapping[str, tuple[str, ...]]
    growth: Mapping[str, float]
    closed_loop: bool = False
    unbiased: tuple[str, ...] = ()

    def headline(self) -> str:
        """Models, records, mean fit over outputs and records."""
        known = {name: self.fit[name][~np.isnan(self.fit[name])] for name in self.models}
        fits = (f"{n} {x.mean():.3g} %" if len(x) else f"{n} none" for n, x in known.items())
        told = f"records {listed(self.records)}, outputs {listed(self.outputs, 10)}; mean fit: "
        return told + ", ".join(fits)

    @property
    def predicted(self) -> str:
        """How records were predicted and why, as sentences; "" if all were simulated."""
        far = sorted({each for each in self.horizon if np.isfinite(each)})
        if not far:
            return ""
        reach = f"{far[0]:.3g}" if len(far) == 1 else f"{far[0]:.3g} to {far[-1]:.3g}"
        growing = [f"{name} e-fold in {1 / r:.2g} s" for name, r in self.growth.items() if r]
        why = f": unstable models grow ({', '.join(growing)})" if growing else ""
        bounded = ", and from inputs ahead that keep outputs bounded" if self.closed_loop else ""
        return (
            f"{self.adrift}Predicted up to {reach} s ahead, each time from a state estimated from "
            f"past samples{bounded}, not simulated over the whole record{why}.{self.missed}"
        )

    @property
    def missed(self) -> str:
        """Outputs that move more before the first prediction than after it, as a sentence."""
        named = [
            f"{record.outputs[i]} of {record.name}"
            for record, begin in zip(self.measured, self.begins, strict=True)
            for i in np.flatnonzero(np.greater(*movement(record, begin)))
        ]
        return f" Not judged, as they moved before the predictions: {listed(named)}." * bool(named)

    @property
    def adrift(self) -> str:
        """Outputs that a growing model predicts worse than their means do, with the remedy."""
        grow = [name for name, rate in self.growth.items() if rate and not self.closed_loop]
        poor = [  # in all records together: where one rests, its mean is as good as any model
            any(measures(self, name, i)[1] < 0 for name in grow) for i in range(len(self.outputs))
        ]
        names = [name for name, each in zip(self.outputs, poor, strict=True) if each]
        why = "this growth is not real, or a controller answers it (then use closed_loop=True)"
        return f"Predictions of {listed(names)} are worse than their means: {why}. " * bool(names)


@one_thread
def validate(
    models: Mapping[str, AnyModel],
    records: Records,
    *,
    horizon: float | None = None,
    closed_loop: bool = False,
    biases: bool | Collection[str] | None = None,
) -> Validation:
    """Simulate or predict each model on each record and measure what is left.

    Initial state and biases are of least squares, outputs in standard deviations over all records
    given: the errors in a record depend on its company. Compare models on the same records.

    Parameters
    ----------
    models : mapping
        A name for each `Model`, `Fit`, `BlackBox` or `StateSpace`, continuous or discrete. A model
        takes its inputs from the records by name, and is judged on the outputs it has.
    records : Record or sequence of Record
        Best ones not used in the estimation. All with the same channels.
    horizon : float
        Predict so far ahead [s], each time from a state estimated on the past; infinite, simulate
        in any case. Unless given, a record is simulated if no model grows by more than ten e-folds
        over it; else all are predicted, a tenth of the record ahead or as long as the least
        unstable of those that grow takes for three e-folds.
    closed_loop : bool
        The records were flown by a controller, which kept outputs within what they do there: ahead
        they are expected at their means, within their covariances over all lags in the rest of the
        record, so that inputs ahead tell of disturbances ahead. Without, an unstable model makes
        of these whatever grows, true or not. With it growing modes that are not there are
        largely excused: judge modes without.
    biases : bool, or collection of str
        Whether a constant of each output, or of which, is estimated from every record, for all
        models alike. Unless given, of all but those that a fit among them was estimated without,
        ``OutputError(biases=False)``: an offset of the model is an error there.

    Raises
    ------
    ValueError
        No model or record, a model whose inputs the records lack, no output in common, a discrete
        model whose interval is not that of the records, a model with NaN in it, a record with less
        than three measurements for every initial state and bias, a horizon that does not fit. A
        `DataWarning`: a nonlinear structure is taken beyond its tables and the records of its fit.
    """
    if not models:
        raise ValueError('no models given; expected {"name": model, ...}')
    records = stretches(records)
    inputs, outputs = same_channels(records)
    scale = standard_deviations(records)[1]
    systems = {name: state_space(model) for name, model in models.items()}
    biased = _biased(biases, models, outputs)
    for name, system in systems.items():
        _check(name, system, records, biased)
    every = list(systems.values())
    tell_repeats(records, {name for system in every for name in system.outputs})
    far = [prediction_plan(every, record, horizon, closed_loop) for record in records]
    predictions = {
        name: [
            predicted(name, model, *each, scale, biased) for each in zip(records, far, strict=True)
        ]
        for name, model in models.items()
    }
    _tell_beyond(models, predictions)
    simulated = {name: tuple(p.y for p in ps) for name, ps in predictions.items()}
    begins = tuple(look.starts[0] + 1 if look.starts else 0 for look in far)
    known = {name: system.outputs for name, system in systems.items()}
    asked = {name: judged_samples(records, begins, own) for name, own in known.items()}
    return Validation(
        **_measured(records, begins, simulated, asked),
        models=tuple(models),
        records=tuple(record.name for record in records),
        inputs=inputs,
        outputs=outputs,
        measured=records,
        simulated=simulated,
        initial_states={name: tuple(p.x0 for p in ps) for name, ps in predictions.items()},
        biases={name: np.array([p.b for p in ps]) for name, ps in predictions.items()},
        horizon=tuple(look.horizon for look in far),
        begins=begins,
        known=known,
        growth={name: growth_rate(system) for name, system in systems.items()},
        closed_loop=closed_loop,
        unbiased=tuple(name for name in outputs if name not in biased),
    )


def _biased(
    wanted: bool | Collection[str] | None, models: Mapping[str, AnyModel], outputs: Sequence[str]
) -> Collection[str]:
    """Outputs that have a constant in every record, as said or as fits were estimated."""
    if wanted is None:
        without = {n for each in models.values() if isinstance(each, Fit) for n in each.unbiased}
        return tuple(name for name in outputs if name not in without)
    if isinstance(wanted, bool):
        return outputs if wanted else ()
    check_known("bias of unknown output", wanted, outputs)
    return wanted


def _check(
    name: str, system: StateSpace, records: Sequence[Record], biased: Collection[str]
) -> None:
    """Refuse a model that cannot be simulated on the records."""
    for letter in "ABCD":
        if not np.isfinite(getattr(system, letter)).all():
            raise ValueError(f"model {name!r}: {letter} is not finite; it cannot be simulated")
    record = records[0]
    if missing := [channel for channel in system.inputs if channel not in record.inputs]:
        raise ValueError(
            f"model {name!r} has input {missing[0]!r}, record {record.name!r} has inputs "
            f"{', '.join(record.inputs)}"
        )
    if not set(system.outputs) & set(record.outputs):
        raise ValueError(
            f"model {name!r} has outputs {', '.join(system.outputs)}, record {record.name!r} has "
            f"{', '.join(record.outputs)}: none in common"
        )
    for record in records:  # initial state and biases would follow whatever was measured
        shared = [i for i, output in enumerate(record.outputs) if output in system.outputs]
        measured = int(np.sum(np.isfinite(record.y[:, shared])))
        unknowns = system.nx + sum(record.outputs[i] in biased for i in shared)
        if measured < PER_UNKNOWN * unknowns:
            raise ValueError(
                f"model {name!r}, record {record.name!r}: {counted(measured, 'measurement')} for "
                f"{unknowns} initial states and biases say nothing about a model, "
                f"{PER_UNKNOWN * unknowns:.0f} or more are wanted; leave the record out"
            )


def predicted(
    name: str,
    model: AnyModel,
    record: Record,
    far: PredictionPlan,
    scale: Array,
    biased: Collection[str],
) -> Prediction:
    """A model's outputs over a record; ``scale`` (ny,) weighs those measured."""
    structure = model.model if isinstance(model, Fit) else model
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # the measures tell of what runs away
            if isinstance(structure, NonlinearModel):
                return predict_nonlinear(structure, record, scale, far, biased)
            return predict(state_space(model), record, scale, far, biased)
    except ValueError as error:
        raise ValueError(f"model {name!r}, record {record.name!r}: {error}") from error


def _tell_beyond(
    models: Mapping[str, AnyModel], predictions: Mapping[str, Sequence[Prediction]]
) -> None:
    """Warn of nonlinear models beyond their tables and the records of their fit."""
    for name, model in models.items():
        structure = model.model if isinstance(model, Fit) else model
        if isinstance(structure, NonlinearModel):
            flown = getattr(model.notes, "covered", None) if isinstance(model, Fit) else None
            visited = joined_spans([each.reached for each in predictions[name]])
            warn_beyond(structure, f"validation of {name!r}", visited, flown)


def state_space(model: AnyModel) -> StateSpace:
    """The linear system behind a structure, a fit or a black box."""
    if isinstance(model, StateSpace):
        return model
    if isinstance(model, Fit):
        return model.model.system()
    return model.system() if isinstance(model, Model) else model.system


def judged_samples(
    records: Sequence[Record], begins: Sequence[int], known: Sequence[str]
) -> tuple[BoolArray, ...]:
    """Samples of each record on which a model is judged, (N, ny): measured, of outputs it has.

    ``begins``: where predictions begin. A model without a number at one has not predicted it.
    """
    has = np.array([name in known for name in records[0].outputs])
    return tuple(
        np.isfinite(record.y) & has & (np.arange(record.N) >= begin)[:, None]
        for record, begin in zip(records, begins, strict=True)
    )


def _each(
    measure: Callable[[Array, Array], float],
    records: Sequence[Record],
    simulated: Sequence[Array],
    asked: Sequence[BoolArray],
) -> Array:
    """A measure of every record's and output's deviations where asked for, (records, ny)."""
    table = np.full((len(records), records[0].ny), np.nan)
    for i, (record, y_model, there) in enumerate(zip(records, simulated, asked, strict=True)):
        y, found = record.y - datum(record), y_model - datum(record)
        for j in np.flatnonzero(there.any(axis=0)):
            table[i, j] = measure(y[there[:, j], j], found[there[:, j], j])
    return table


def _measured(
    records: Sequence[Record],
    begins: Sequence[int],
    simulated: Mapping[str, Sequence[Array]],
    asked: Mapping[str, Sequence[BoolArray]],
) -> dict[str, Any]:
    """All measures by their names in `Validation`, each by model."""
    relative = {"fit": fit_percent, "theil": theil_coefficient}
    found = {
        what: {name: _each(measure, records, ys, asked[name]) for name, ys in simulated.items()}
        for what, measure in ({"rms": rms_error, "whiteness": whiteness} | relative).items()
    }
    lost = np.array([np.greater(*each) for each in map(movement, records, begins)])
    for name, rms in found["rms"].items():  # relative to what they miss, these would say nothing
        for what in relative:
            found[what][name][lost & np.isfinite(rms)] = np.nan
    return found | {"normalised": _normalised(found["rms"])}


def _normalised(rms: Mapping[str, Array]) -> dict[str, Array]:
    """RMS errors divided by the largest among the models; beside an infinite one others are 0."""
    worst = np.fmax.reduce(list(rms.values()))
    worst[worst == 0] = 1.0
    with np.errstate(invalid="ignore"):
        return {name: np.where(np.isinf(x), 1.0, x / worst) for name, x in rms.items()}


def measures(validation: Validation, model: str, i: int) -> tuple[float, float, float]:
    """RMS error, fit and Theil's coefficient of one output's deviations, all records together."""
    measured, begins = validation.measured, validation.begins
    asked = judged_samples(measured, begins, validation.known[model])
    both = [
        (record.y - datum(record), found - datum(record), there[:, i])
        for record, found, there in zip(measured, validation.simulated[model], asked, strict=True)
    ]
    y, y_model = (np.concatenate([one[k][one[2], i] for one in both]) for k in (0, 1))
    if not len(y):
        return np.nan, np.nan, np.nan
    rms = rms_error(y, y_model)
    before, after = np.sum(list(map(movement, measured, begins)), axis=0)[:, i]
    if np.isfinite(rms) and before > after:
        return rms, np.nan, np.nan
    return rms, fit_percent(y, y_model), theil_coefficient(y, y_model)
