"""Flight conditions and the linear structures of a nonlinear one there."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import lru_cache
from typing import Any, cast

import casadi as ca
import numpy as np

from casid.checks import hint
from casid.errors import ModelError
from casid.model import Constraint, Model, Rows, parameter
from casid.nonlinear.expressions import Nonlinear, balances, linearised, reference_point, resting
from casid.sensors import Scalar
from casid.values import storable

BALANCE = 1e-6  # |dx/dt| of an equation without unknowns that still counts as trimmed


@storable
@dataclass(frozen=True, eq=True, kw_only=True)
class Trim:
    """A flight condition: states and inputs about which a nonlinear structure is linearised.

    Parameters
    ----------
    values : mapping
        Total value of each state and input, as measured (a record's ``trim``) or solved for; the
        structure's reference where not named. Those of outputs do not count.
    name : str
        What tables call the condition.
    unknown : tuple of str
        States and inputs that are estimated with the parameters, from these values on, so that
        dx/dt = 0, of states that some equation depends on: a trim that is not measured.
    speed : float
        Where tables and figures over airspeed place the condition [m/s]; NaN places it nowhere.
    moves : mapping
        ``{"theta": {"Xu": (slope, value)}}``: what was solved for moves, to first order, by its
        slope with a parameter's distance from the value that it had then; so do matrices there,
        and the errors of what is read from them.
    """

    values: Mapping[str, float]
    name: str = ""
    unknown: tuple[str, ...] = ()
    speed: float = np.nan
    moves: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", {k: _total(k, v) for k, v in self.values.items()})
        object.__setattr__(self, "unknown", tuple(self.unknown))

    def __hash__(self) -> int:
        return hash(self._key())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Trim) and self._key() == other._key()

    def _key(self) -> tuple[Any, ...]:
        speed = self.speed if np.isfinite(self.speed) else None
        moves = [(name, tuple(sorted(own.items()))) for name, own in sorted(self.moves.items())]
        values = tuple(sorted(self.values.items()))
        return self.name, self.unknown, speed, values, tuple(moves)


def _total(name: str, value: Any) -> float:  # noqa: ANN401 - whatever the user has
    """Value of a trim's channel; ValueError, with its name, for what is no number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(
            f"trim: {name} = {value!r} is no number; give one total value in the structure's "
            "units, and a trim for every further one"
        ) from None


def linearisation(model: Nonlinear, conditions: Sequence[Trim]) -> Model:
    """The linear structure at one flight condition, or at several side by side.

    Several have the channels of each under names of their own, ``p@60 kn``. ModelError: an unknown
    that is no state or input, a balance that nothing unknown can bring about, two conditions of one
    name.
    """
    names = [each.name for each in conditions]
    known = {*model.states, *model.inputs}
    if wrong := [(each.name, n) for each in conditions for n in each.unknown if n not in known]:
        raise ModelError(
            f"trim {wrong[0][0]!r}: unknown {wrong[0][1]!r} is no state or input of "
            f"{type(model).__name__}"
        )
    if len(conditions) > 1 and (len(set(names)) < len(names) or "" in names):
        raise ModelError(f"conditions are named {', '.join(map(repr, names))}; give each its own")
    airframe: Nonlinear = type(model)
    cls = _class(airframe, tuple(conditions))
    usual = itertools.chain(*(map(float, part) for part in model.operating_point()))
    start = dict(zip((*model.states, *model.inputs), usual, strict=True))
    unknown = {
        unknown_name(name, number, conditions): float({**start, **each.values}[name])
        for number, each in enumerate(conditions)
        for name in each.unknown
    }
    return cls(**{f.name: getattr(model, f.name) for f in fields(model)}, **unknown)


def check_named(model: Nonlinear, values: Mapping[str, float]) -> None:
    """Refuse a trim with names that are no channel, ValueError; those of outputs do not count."""
    known = (*model.states, *model.inputs)
    if unknown := [name for name in values if name not in {*known, *model.outputs}]:
        raise ValueError(
            f"trim names {unknown[0]!r}, which is no channel of {type(model).__name__}; "
            f"{hint(unknown[0], known)}; of a record's trim give these only"
        )


def at_condition(name: str, condition: Trim, conditions: Sequence[Trim]) -> str:
    """Name of a channel at one of several conditions."""
    return name if len(conditions) == 1 else f"{name}@{condition.name}"


def by_condition(names: Sequence[str]) -> dict[str, list[int]]:
    """Places of channels by the condition in their names, "" where that is the only one."""
    found: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        found.setdefault(name.partition("@")[2], []).append(place)
    return found


def told_at(condition: str) -> str:
    """How messages about one of several conditions begin; "" without a name."""
    return f"condition {condition!r}: " * bool(condition)


@lru_cache(maxsize=64)
def _class(airframe: Nonlinear, conditions: tuple[Trim, ...]) -> type[Model]:
    """The class of linear structures of an airframe at flight conditions."""
    channels = {
        kind: tuple(at_condition(n, c, conditions) for c in conditions for n in own)
        for kind, own in (
            ("states", airframe.states), ("inputs", airframe.inputs), ("outputs", airframe.outputs)
        )
    }  # fmt: skip
    notes: dict[str, Any] = {}
    body: dict[str, Any] = dict(channels)
    for each in fields(airframe):
        if each.default is MISSING:
            raise ModelError(f"{airframe.__name__}.{each.name} has no default; give it one")
        notes[each.name] = each.type
        body[each.name] = field(default=each.default, metadata=each.metadata)
    for number, condition in enumerate(conditions):
        for name in condition.unknown:
            key, unit = unknown_name(name, number, conditions), airframe.units.get(name, "-")
            notes[key] = Scalar
            body[key] = parameter(default=condition.values.get(name, 0.0), unit=unit)
    body |= _methods(airframe, conditions)
    body |= {"__annotations__": notes, "__module__": airframe.__module__}
    body["derived"] = True  # by differentiation: rows may vanish at one condition
    body["__doc__"] = f"{airframe.__name__}, linearised."
    return cast("type[Model]", type(f"{airframe.__name__}Linear", (Model,), body))


def _methods(airframe: Nonlinear, conditions: tuple[Trim, ...]) -> dict[str, Any]:
    """What a linear structure writes: matrices, delays, constraints."""

    def matrix(number: int) -> Callable[[Any], Rows]:
        def rows(self: Any) -> Rows:  # noqa: ANN401
            model = _own(self, airframe)
            points = [point(self, model, n, conditions) for n in range(len(conditions))]
            return _diagonal([linearised(model, *each)[number] for each in points])

        return rows

    def delays(self: Any) -> dict[str, Scalar]:  # noqa: ANN401
        own = _own(self, airframe).delays()
        pairs = [(n, tau, c) for c in conditions for n, tau in own.items()]
        return {at_condition(n, c, conditions): tau for n, tau, c in pairs}

    def constraints(self: Any) -> list[Constraint]:  # noqa: ANN401
        model, found = _own(self, airframe), []
        for n, condition in enumerate(conditions):
            if condition.unknown:
                f = ca.vertsplit(balances(model, *point(self, model, n, conditions)))
                found += [
                    Constraint(
                        f"trim {condition.name!r}: d{name}/dt",
                        float(f[i]) if f[i].is_constant() else f[i],
                    )
                    for i, name in _balanced(self, airframe, conditions, n)
                ]
        return [*model.constraints(), *found]

    def reduce(self: Any) -> Any:  # noqa: ANN401
        return _restored, (airframe, conditions, vars(self).copy())

    letters = {letter: matrix(number) for number, letter in enumerate("ABCD")}
    return letters | {"delays": delays, "constraints": constraints, "__reduce__": reduce}


def _own(linear: Any, airframe: Nonlinear) -> Any:  # noqa: ANN401
    """The nonlinear structure with the values or symbols of a linear one."""
    return airframe(**{each.name: getattr(linear, each.name) for each in fields(airframe)})


def point(
    linear: Model, model: Nonlinear, number: int, conditions: Sequence[Trim]
) -> tuple[list[Any], list[Any]]:
    """States and inputs of one condition; its unknowns are parameters of the linear structure."""
    names, condition = (*model.states, *model.inputs), conditions[number]
    values = dict(zip(names, itertools.chain(*reference_point(model)), strict=True))
    values |= {name: value for name, value in condition.values.items() if name in values}
    for name, own in condition.moves.items():
        for by, (slope, origin) in own.items():
            values[name] = values[name] + slope * (getattr(model, by) - origin)
    for name in condition.unknown:
        values[name] = getattr(linear, unknown_name(name, number, conditions))
    found = [values[name] for name in names]
    return found[: len(model.states)], found[len(model.states) :]


def _balanced(
    linear: Model, airframe: Nonlinear, conditions: tuple[Trim, ...], number: int
) -> list[tuple[int, str]]:
    """Equations of one condition that its unknowns or the parameters have to balance.

    Whatever the parameters are, but with the structure's own constants; of states that rest.
    """
    lam = ca.SX.sym("lam", len(linear.parameter_names()))
    linear = linear.with_vector(lam)
    model = _own(linear, airframe)
    f = ca.vertsplit(balances(model, *point(linear, model, number, conditions)))
    found, rests = [], resting(model.equations())
    for i, (name, value) in enumerate(zip(airframe.states, f, strict=True)):
        if not rests[i]:
            continue
        if ca.depends_on(value, lam):
            found.append((i, name))
        elif not abs(float(value)) < BALANCE:
            raise ModelError(
                f"trim {conditions[number].name!r}: d{name}/dt is {float(value):.3g} whatever the "
                "parameters and the unknowns are; give other values or make one of them unknown"
            )
    return found


def _diagonal(blocks: Sequence[Rows]) -> Rows:
    """Rows of a block-diagonal matrix."""
    width, before = sum(len(block[0]) for block in blocks), 0
    rows: list[Sequence[Scalar]] = []
    for block in blocks:
        rows += [[*[0] * before, *row, *[0] * (width - before - len(row))] for row in block]
        before += len(block[0])
    return rows


def _restored(
    airframe: Nonlinear, conditions: tuple[Trim, ...], values: Mapping[str, Any]
) -> Model:
    return _class(airframe, conditions)(**values)


def unknown_name(name: str, number: int, conditions: Sequence[Trim]) -> str:
    """Name of the parameter that stands for an unknown of a trim."""
    return f"{name}_trim" + f"_{number + 1}" * (len(conditions) > 1)
