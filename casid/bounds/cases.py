"""Cases of a comparison: what each of them says of a structure's parameters.

A case is a mapping from parameters to what they may be, and a list of relations between them::

    {}                                             the bounds of the model file
    {"Lp": "< 0", "Mq": "< 0"}                     signs
    {"Lp": "±20 %", "Mq": "-1.2 ± 0.3"}            around the guess, around a number
    {"*": "±20 %", "Lv": "free"}                   all parameters with a guess other than zero
    {"Lp": -3.0, "Mq": "fixed", "Nr": [-2, 0]}     a value, the guess, bounds
    {"constraints": ["Nlat = 0.05 Llat", "Lp <= 2 Mq"]}

A list of relations, or one text for all parameters, is a case too. What a case says tightens the
bounds of the model file; a pair of bounds and "free" replace them.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import scipy

from casid.arrays import Array
from casid.bounds.relations import Relation, check_possible, parse_relation
from casid.checks import check_known
from casid.declaration import check_pair
from casid.errors import ModelError, warn
from casid.fit import AnyFit
from casid.free import delay_parameters, free_parameters
from casid.model import Bounds, Constraint, Model
from casid.nonlinear.model import NonlinearModel
from casid.shooting.precision import OutputErrorNotes
from casid.tables import placed

CaseSpec: TypeAlias = Mapping[str, Any] | Sequence[str] | str

NUMBER = r"[-+−]?\s*(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
AROUND = re.compile(
    rf"\s*(?P<centre>{NUMBER})?\s*(?:±|\+/?-)\s*(?P<width>{NUMBER})\s*(?P<unit>%?)\s*"
)
RELATIONS = "constraints"  # the key of a case's relations
ALL = "*"  # the key of all parameters
STIFF = 1e4  # weight of relations against distance
DEPENDENT = 1e-9  # length of what is left of a unit row that follows from others
SINGULAR = 1e12  # condition of a covariance that cannot be inverted
WIDTH = 1e-9  # of a tie, for a solver that wants an interior


@dataclass(frozen=True)
class Case:
    """What one case says, checked and worked out for one structure."""

    name: str
    bounds: Mapping[str, tuple[float, float]]  # of all parameters that are not fixed everywhere
    relations: tuple[Relation, ...]  # ties, fixed values and inequalities

    def within(self, other: "Case") -> bool:
        """Whether all this case allows is allowed by the other, as far as their wording shows."""
        for name in self.bounds:
            (low, high), (lower, upper) = self.range(name), other.bounds[name]
            if not lower <= low <= high <= upper:
                return False
        return all(self._implies(relation) for relation in other.relations)

    def range(self, name: str) -> tuple[float, float]:
        """What a parameter may be: its bounds, or its fixed value twice."""
        values = [r.lower for r in self.relations if r.names == (name,)]
        return (values[0], values[0]) if values else self.bounds[name]

    def _implies(self, relation: Relation) -> bool:
        return any(
            own.names == relation.names
            and own.coefficients == relation.coefficients
            and relation.lower <= own.lower
            and own.upper <= relation.upper
            for own in self.relations
        )


def read_cases(
    model: Model,
    specs: Mapping[str, CaseSpec],
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
) -> tuple[Case, ...]:
    """Cases from what a user wrote; ``fixed`` and ``bounds`` hold in all of them.

    The model is the guess that "±20 %" and "fixed" refer to. ModelError: an unknown parameter, a
    text that is not understood, bounds that exclude each other.
    """
    if not specs:
        raise ModelError('no cases given; expected {"free": {}, "signs": {"Lp": "< 0"}, ...}')
    free = free_parameters(model, fixed, bounds)
    limits = {
        name: (float(free.lower[i]), float(free.upper[i]))
        for name, i in zip(free.names, free.index, strict=True)
    }
    delays = {free.names[i] for i in delay_parameters(free)[0]}
    return tuple(
        _Writer(free.model, name, limits, delays).read(spec) for name, spec in specs.items()
    )


class _Writer:
    """Collects what one case says."""

    def __init__(self, model: Model, name: str, limits: Bounds, delays: Collection[str]) -> None:
        self.model, self.name, self.delays = model, name, delays
        self.bounds, self.relations = dict(limits), list[Relation]()

    def read(self, spec: CaseSpec) -> Case:
        with placed(f"case {self.name!r}:"):
            given, texts = self._parts(spec)
            everyone = given.pop(ALL, None)
            for parameter in () if everyone is None else self.bounds:
                if parameter not in given and getattr(self.model, parameter) != 0:
                    self._one(parameter, everyone)
            for parameter, content in given.items():
                self._known(parameter)
                self._one(parameter, content)
            for text in texts:
                self._relation(text)
            check_independent(self.relations)
            check_possible(self.relations, self.bounds)
            self._hold_what_does_nothing()
        return Case(self.name, self.bounds, tuple(self.relations))

    def _hold_what_does_nothing(self) -> None:
        """Hold parameters that the fixed values leave without effect: nothing else would."""
        held = {r.names[0]: r.lower for r in self.relations if len(r.names) == 1}
        free = {*self.bounds} - {name for relation in self.relations for name in relation.names}
        if not held or isinstance(self.model, NonlinearModel):  # which one flight condition misses
            return
        idle = without_effect(self.model, held, {*self.bounds}, free)
        for name in idle:
            value = float(np.clip(getattr(self.model, name), *self.bounds[name]))
            self._narrow(name, value, value)
        if idle:
            warn(
                f"case {self.name!r}: with the values it fixes {', '.join(idle)} has no effect and "
                "the records do not determine it: held at its guess, without a standard error"
            )

    def _parts(self, spec: CaseSpec) -> tuple[dict[str, Any], list[str]]:
        if isinstance(spec, str):
            return {ALL: spec}, []
        if not isinstance(spec, Mapping):
            return {}, self._texts(spec)
        given = dict(spec)
        return given, self._texts(given.pop(RELATIONS, []))

    def _texts(self, content: Any) -> list[str]:  # noqa: ANN401 - what a user wrote
        texts = [content] if isinstance(content, str) else list(content)
        for text in texts:
            if not isinstance(text, str):
                raise ModelError(f'{text!r} is no relation; expected "Nlat = 0.05 Llat"')
        return texts

    def _known(self, parameter: str) -> None:
        if parameter in self.bounds:
            return
        if parameter in self.model.parameter_names():
            raise ModelError(f"{parameter} is fixed in all cases; take it out of fixed")
        said = f"{type(self.model).__name__} has no parameter"
        check_known(said, [parameter], self.model.parameter_names(), ModelError)

    def _one(self, parameter: str, content: Any) -> None:  # noqa: ANN401 - what a user wrote
        guess = float(getattr(self.model, parameter))
        number = isinstance(content, int | float)
        if (
            isinstance(content, bool)
            or not (number or isinstance(content, str | list | tuple))
            or (number and not abs(content) < np.inf)
        ):
            raise ModelError(f"{parameter} = {content!r} is not understood; {HELP}")
        if number:
            self._relation(f"{parameter} = {float(content)!r}")
        elif not isinstance(content, str):
            self._replace(parameter, content)
        elif content.strip() == "fixed":
            self._relation(f"{parameter} = {guess!r}")
        elif content.strip() == "free":
            self.bounds[parameter] = (0.0 if parameter in self.delays else -np.inf, np.inf)
        elif around := AROUND.fullmatch(content):
            self._tighten(parameter, *self._interval(parameter, guess, around))
        elif content.strip()[:1] in "<>=≤≥":
            self._relation(f"{parameter} {content.strip()}")
        else:
            raise ModelError(f"{parameter} = {content!r} is not understood; {HELP}")

    def _interval(self, parameter: str, guess: float, around: re.Match[str]) -> tuple[float, float]:
        centre = guess if around["centre"] is None else _number(around["centre"])
        width = _number(around["width"])
        if around["unit"]:
            width *= abs(centre) / 100
            if centre == 0:
                raise ModelError(
                    f"{parameter} = {around[0]!r} is relative to a guess of zero; give the guess a "
                    'value, or write "±0.1" in the unit of the parameter'
                )
        return centre - width, centre + width

    def _replace(self, parameter: str, pair: Sequence[Any]) -> None:
        check_pair(parameter, pair)
        self._narrow(parameter, *map(float, pair))

    def _tighten(self, parameter: str, low: float, high: float) -> None:
        lower, upper = Case(self.name, self.bounds, tuple(self.relations)).range(parameter)
        if not max(low, lower) <= min(high, upper):
            said = f"= {low:g}" if low == high else f"in [{low:g}, {high:g}]"
            known = f"value {lower:g}" if lower == upper else f"bounds [{lower:g}, {upper:g}]"
            raise ModelError(f"{parameter} {said} contradicts its {known}")
        self._narrow(parameter, max(low, lower), min(high, upper))

    def _narrow(self, parameter: str, low: float, high: float) -> None:
        """Set bounds; equal ones are a fixed value, which has a price."""
        if low == high:
            fixed = Relation(f"{parameter} = {low:g}", (parameter,), (1.0,), low, low)
            self.relations += [] if fixed in self.relations else [fixed]
        else:
            self.bounds[parameter] = (low, high)

    def _relation(self, text: str) -> None:
        relation = parse_relation(text)
        for name in relation.names:
            self._known(name)
        first, *others = relation.names
        if others:
            self.relations.append(relation)
        elif relation.tie:
            self._tighten(first, relation.lower, relation.lower)
        else:
            self._tighten(first, relation.lower, relation.upper)


HELP = (
    'expected a number, "fixed", "free", [lower, upper], "< 0", "±20 %", "-3 ± 0.5" or '
    '"= 0.05 Llat"'
)


def check_independent(relations: Sequence[Relation]) -> None:
    """Refuse a tie that others imply, whose price would be arbitrary, or contradict."""
    ties = [relation for relation in relations if relation.tie]
    names = tuple(dict.fromkeys(name for tie in ties for name in tie.names))
    rows = np.array([tie.row(names) for tie in ties]).reshape(len(ties), len(names))
    sizes = np.linalg.norm(rows, axis=1)
    rows, values = rows / sizes[:, None], np.array([tie.lower for tie in ties]) / sizes
    for k in range(1, len(ties)):
        by = np.linalg.lstsq(rows[:k].T, rows[k], rcond=None)[0]
        if np.linalg.norm(rows[k] - by @ rows[:k]) <= DEPENDENT:
            others = ", ".join(repr(ties[i].text) for i in np.flatnonzero(np.abs(by) > DEPENDENT))
            size = max(1.0, np.abs(values[: k + 1]).max())
            agree = abs(values[k] - by @ values[:k]) <= DEPENDENT * size
            what = "follows from" if agree else "contradicts"
            raise ModelError(f"{ties[k].text!r} {what} {others}; leave one of them out")


def without_effect(
    model: Model, held: Mapping[str, float], moving: Collection[str], among: Collection[str]
) -> list[str]:
    """Which among the moving parameters change nothing in the structure, some held at values."""
    names = model.parameter_names()
    lam, guess = ca.SX.sym("lam", len(names)), model.vector()
    at = [
        lam[i] if name in moving and name not in held else ca.SX(held.get(name, guess[i]))
        for i, name in enumerate(names)
    ]
    A, B, C, D, tau, c = map(ca.sparsify, model.matrices()(ca.vertcat(*at)))
    heard = [j for j in range(tau.shape[0]) if B[:, j].nnz() or D[:, j].nnz()]
    said = ca.vertcat(*(ca.vec(each) for each in (A, B, C, D, tau[heard], c)))
    matters = ca.which_depends(said, lam, 1, False)
    return [name for name, some in zip(names, matters, strict=True) if name in among and not some]


def _number(text: str) -> float:
    return float(text.replace("−", "-").replace(" ", ""))


def constrained(model: Model, case: Case) -> Model:
    """A model whose structure has the case's relations beside its own.

    Every estimator keeps what `Model.constraints` says.
    """
    if not case.relations:
        return model
    cls = type(model)
    names = model.parameter_names()

    def constraints(self: Model) -> Sequence[Constraint]:
        values = {name: getattr(self, name) for name in names}
        return (
            *cls.constraints(self),
            *(Constraint(r.text, r.value(values), r.lower, r.upper) for r in case.relations),
        )

    body = {"constraints": constraints, "__module__": cls.__module__, "__doc__": cls.__doc__}
    derived: type[Model] = type(cls.__name__, (cls,), body)
    return derived(**_values(model))


def as_user_class(model: Model, cls: type[Model]) -> Model:
    """The model as an instance of the user's own class."""
    return cls(**_values(model))


def _values(model: Model) -> dict[str, Any]:
    return {f.name: getattr(model, f.name) for f in fields(model)}


def feasible(model: Model, case: Case, near: AnyFit | None = None) -> Model:
    """The point of a case next to a model: bounded least squares.

    Relations that contradict each other are met as well as can be. ``near`` is the fit at the
    model's values, under wider bounds. Distance then is its information, so that the point is the
    optimum of the case to second order. Without one, parameters count by size.
    """
    names = model.parameter_names()
    scale = free_parameters(model, (), dict(case.bounds)).scale
    x0 = model.vector() / scale
    moving = np.array([name in case.bounds for name in names])
    limits = np.array([case.bounds.get(name, (0.0, 0.0)) for name in names])[moving]
    rows = np.array([relation.row(names) for relation in case.relations]).reshape(-1, len(names))
    rows = rows * scale
    sizes = np.abs(rows).max(axis=1, initial=1e-300)
    rows = rows / sizes[:, None]
    sides = np.array([(each.lower, each.upper) for each in case.relations]).reshape(-1, 2)
    sides = sides / sizes[:, None] - (rows[:, ~moving] @ x0[~moving])[:, None]
    metric = _metric(near, names, scale)[np.ix_(moving, moving)]
    within = limits / scale[moving, None]
    found = _nearest(x0[moving], metric, within, rows[:, moving], sides) * scale[moving]
    moved = model.vector()
    moved[moving] = np.clip(found, *limits.T)
    return model.with_vector(moved)


def _metric(near: AnyFit | None, names: Sequence[str], scale: Array) -> Array:
    """Root M of the information, MᵀM in units of the scale, as far as the fit knows it."""
    metric = np.eye(len(names))
    if near is None or not isinstance(near.notes, OutputErrorNotes):
        return metric
    inside = [k for k, name in enumerate(near.free_names) if not near[name].active]
    at = np.ix_(*[[names.index(near.free_names[k]) for k in inside]] * 2)
    covariance = near.notes.cramer_rao[np.ix_(inside, inside)] / np.outer(scale, scale)[at]
    if np.isfinite(covariance).all() and np.linalg.cond(covariance) < SINGULAR:  # no ties
        metric[at] = np.linalg.inv(np.linalg.cholesky(covariance))
    return metric


def _nearest(x0: Array, metric: Array, limits: Array, rows: Array, sides: Array) -> Array:
    """The x next to x0 within its limits (n, 2), with rows @ x within its sides (m, 2)."""
    # The values of the rows are variables of their own, held to the rows by a stiff residual.
    n, m = len(x0), len(rows)
    stiff = STIFF * np.abs(metric).max()
    left = np.block([[metric, np.zeros((n, m))], [stiff * rows, -stiff * np.eye(m)]])
    right = np.concatenate([metric @ x0, np.zeros(m)])
    lower, upper = np.vstack([limits, sides]).T
    room = WIDTH * np.maximum(1.0, np.abs(np.where(np.isfinite(lower), lower, 0.0)))
    wide = np.maximum(upper, lower + room)
    return np.asarray(scipy.optimize.lsq_linear(left, right, (lower, wide), method="bvls").x[:n])
