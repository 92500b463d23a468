"""What is known beside the measurements, of parameters, initial states and output biases.

    ½ Σ (λ − λ₀)²/σ² + ½ Σ over records of (x₀ − m)²/σ² and of b²/σ²

adds to the negative log-likelihood (R. V. Jategaonkar, Flight Vehicle System Identification, 2nd
ed., section 4.16): the mode of the posterior. A bias that is to be none is held by a σ far below
what any record tells of it, 1e-8 of its channel.
"""

from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np

from casid import declaration
from casid.arrays import Array
from casid.errors import ModelError, warn
from casid.fit import AnyFit
from casid.free import Free
from casid.model import Initial, M, Model
from casid.nonlinear.model import NonlinearModel
from casid.record import Record
from casid.sensors import own_states
from casid.shooting.likelihood import Noise
from casid.shooting.sensitivity import Point

CONTRADICTED = 3.5  # standard deviations between a prior and the records, of the largest of many
CONTRADICTS = "the records contradict"  # how what is told of it begins
NARROWED = 1e-6  # of a prior's variance: what records that say nothing narrow it by
TRIM = "trim"  # instead of a value: that of each record's trim
HELD = 0.01  # σ of a bias that is held, in units of the noise's floor


class Knowledge:
    """Prior values as terms of the cost; number of its record by interval in ``record`` (J,).

    ``mean`` (records, nx) is what is stated of initial states, 0 where nothing is.
    """

    def __init__(
        self, free: Free, noise: Noise, record: np.ndarray, records: Sequence[Record]
    ) -> None:
        self._free = free
        self._firsts = np.searchsorted(record, np.arange(len(records)))
        states, outputs = free.model.states, free.model.outputs
        self.mean, self._weight = np.zeros((len(records), len(states))), np.zeros(len(states))
        for name, (mean, std) in free.initial.items():
            i = states.index(name)
            own = [each.trim[_of_trim(name)] if mean == TRIM else mean for each in records]
            self.mean[:, i], self._weight[i] = own, std**-2.0
        held = np.array([name in free.unbiased for name in outputs])
        self._bias = np.where(held, (HELD * noise.floor) ** -2.0, 0.0)

    def cost(self, point: Point) -> float:
        """The terms at a point."""
        off, _ = self._free.prior_residuals(point.lam[: len(self._free.index)])
        away = point.nodes[self._firsts] - self.mean
        total = off @ off + np.sum(self._weight * away**2) + np.sum(self._bias * point.bias**2)
        return float(total) / 2

    def add(self, records: Array, nodes: Array, point: Point) -> None:
        """Add Hessian and gradient to `casid.shooting.sensitivity.Sums`' records and nodes."""
        n, nx, ny = len(self._free.index), len(self._weight), len(self._bias)
        off, pull = self._free.prior_residuals(point.lam[:n])
        state = np.arange(nx)
        bias = len(point.lam) + nx + np.arange(ny)
        records[0, :n, :n] += pull.T @ pull
        records[0, :n, -1] += pull.T @ off
        each = zip(records, self._firsts, self.mean, point.bias, strict=True)
        for record, first, mean, b in each:
            nodes[first, state, len(point.lam) + state] += self._weight
            nodes[first, :, -1] += self._weight * (point.nodes[first] - mean)
            record[bias, bias] += self._bias
            record[bias, -1] += self._bias * b


def with_knowledge(
    free: Free,
    initial: Initial | None,
    biases: bool | Collection[str],
    state_biases: Collection[str],
) -> Free:
    """Free parameters with what else is known and unknown; ValueError for unknown names."""
    model = free.model
    for name, pair in (initial or {}).items():
        _known("initial", name, model.states)
        given: Any = pair  # whatever the user wrote
        own = isinstance(given, Sequence) and len(given) == 2 and given[0] == TRIM
        declaration.check_prior(f"initial state {name}", (0.0, pair[1]) if own else pair)
        if own and not isinstance(model, NonlinearModel):
            raise ModelError(
                f"initial state {name}: a linear structure's states count from the trim, which is "
                f"0 there; write (0.0, {pair[1]})"
            )
    chosen = model.outputs if isinstance(biases, bool) else tuple(biases)
    for name in chosen:
        _known("biases", name, model.outputs)
    for name in state_biases:
        _known("state_biases", name, own_states(model.states, model.outputs))
    return replace(
        free,
        model=wider(model, tuple(state_biases)),
        initial=dict(initial or {}),
        unbiased=tuple(name for name in model.outputs if name not in chosen),
    )


def in_totals(record: Record, initial: Initial) -> Record:
    """The record in total values, and the trims that initial states are said to have.

    ValueError: it does not say such a trim.
    """
    trim = dict(record.total().trim)
    for name in (name for name, (mean, _) in initial.items() if mean == TRIM):
        if name not in record.trim:
            remedy = f"replace(record, trim={{{name!r}: value}})"
            if name in record.outputs:
                remedy = 'detrend it (record.detrend("first")), or give the value itself'
            raise ValueError(
                f"initial state {name} is that of the trim, of which record {record.name!r} "
                f"does not say {name}: {remedy}"
            )
        trim[_of_trim(name)] = record.trim[name]
    return replace(record.total(), trim=trim)


def _of_trim(name: str) -> str:
    return f"{name} of the trim"  # the plain name is what total values lack


def _known(argument: str, name: str, names: tuple[str, ...]) -> None:
    if name not in names:
        raise ModelError(f"{argument} names {name!r}, expected of {', '.join(names)}")


def bias_states(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the states that are the biases of states."""
    return tuple(f"{name}_bias" for name in names)


def wider(model: M, names: tuple[str, ...]) -> M:
    """The model with a constant of each record in the equations of the states named.

    These are states of their own, behind the model's: `bias_states`.
    """
    if not names:
        return model
    cls: Any = type(model)
    parts = (_nonlinear if hasattr(cls, "derivatives") else _linear)(cls, names)
    parts |= {"constant_states": bias_states(names), "__annotations__": {}}
    wider: Any = type(cls.__name__, (cls,), parts | {"__module__": cls.__module__})
    return cast(M, wider(**_values(model)))


def _linear(cls: Any, names: tuple[str, ...]) -> dict[str, Any]:  # noqa: ANN401
    """What a linear structure with constants writes anew."""
    own = own_states(cls.states, cls.outputs)
    m = len(names)
    unit = [[float(state == name) for name in names] for state in own]

    def A(self: Model) -> Any:  # noqa: ANN401
        return [[*row, *more] for row, more in zip(cls.A(self), unit, strict=True)] + [
            [0.0] * (len(own) + m)
        ] * m

    def B(self: Model) -> Any:  # noqa: ANN401
        return [*cls.B(self), *[[0.0] * len(cls.inputs)] * m]

    def C(self: Model) -> Any:  # noqa: ANN401
        return [[*row, *[0.0] * (len(own) + m - len(row))] for row in cls.C(self)]

    return {"A": A, "B": B, "C": C, "states": (*own, *bias_states(names))}


def _nonlinear(cls: Any, names: tuple[str, ...]) -> dict[str, Any]:  # noqa: ANN401
    """What a nonlinear structure with constants writes anew; its own methods see its own states."""
    added = dict(zip(names, bias_states(names), strict=True))

    def derivatives(self: Model, x: Any, u: Any) -> Any:  # noqa: ANN401
        f = zip(cls.states, cls(**_values(self)).derivatives(x, u), strict=True)
        moved = [rate + getattr(x, added[name]) if name in added else rate for name, rate in f]
        return [*moved, *[0.0] * len(names)]

    def measurements(self: Model, x: Any, u: Any) -> Any:  # noqa: ANN401
        return cls(**_values(self)).measurements(x, u)

    states = (*cls.states, *added.values())
    return {"derivatives": derivatives, "measurements": measurements, "states": states}


def _values(model: Model) -> dict[str, Any]:
    """Fields of a structure by name."""
    return {each.name: getattr(model, each.name) for each in fields(cast(Any, model))}


def warn_contradicted(free: Free, fit: AnyFit) -> None:
    """Tell of priors that the records contradict.

    If both are right, estimate less prior value has the variance by which the records narrow the
    prior's, σ² less the estimate's (D. R. Cox, D. V. Hinkley, Theoretical Statistics, 1974, 10.5).
    """
    for name, (mean, std) in free.priors.items():
        row = fit[name]
        narrowed = np.nan_to_num(std**2 - row.cramer_rao**2, nan=std**2, neginf=std**2)
        off = abs(row.value - mean) / np.sqrt(max(narrowed, NARROWED * std**2))
        if off > CONTRADICTED:
            warn(
                f"{CONTRADICTS} the prior {name} = {mean:.4g} ± {std:.2g}: the estimate "
                f"{row.value:.4g} lies {off:.1f} standard deviations from it, and all "
                "parameters' errors assume that both are right: check where the prior comes "
                "from, widen it or leave it out"
            )
