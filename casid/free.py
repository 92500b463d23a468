"""The free parameters of one estimation: their bounds, scales, and what is known of them before."""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np

from casid import declaration
from casid.arrays import Array, BoolArray
from casid.checks import check_known
from casid.errors import ModelError
from casid.model import NO_DELAY, Bounds, Initial, Model, Priors

NEAR = 1e-7  # of a parameter's scale, beyond a bound: on it, as far as a solver keeps to it


class Evidence(Protocol):
    """Measurements of the parameters beside an estimator's own data."""

    def residuals(self, values: Array) -> tuple[Array, Array]:
        """Independent residuals (m,) of unit variance at free values, and derivatives (m, nf)."""
        ...

    def scatter(self, values: Array) -> Array:
        """Covariance (nf, nf) of the gradient of half the sum of their squares."""
        ...


@dataclass(frozen=True, eq=False)
class Free:
    """The free parameters of one estimation; fixed ones are numbers and no variables."""

    model: Model  # the guess; fixed parameters keep its values
    index: np.ndarray  # (nf,) positions of the free parameters in λ
    lower: Array  # (n_λ,) bounds of all parameters
    upper: Array  # (n_λ,)
    scale: Array  # (n_λ,) typical magnitudes
    priors: Priors = field(default_factory=dict)  # of free parameters
    initial: Initial = field(default_factory=dict)  # of every record's initial states
    unbiased: tuple[str, ...] = ()  # outputs without a bias, where the others have one
    evidence: Evidence | None = None  # other measurements of the free parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        names = self.model.parameter_names()
        return tuple(names[i] for i in self.index)

    @property
    def guess(self) -> Array:
        """Guess of the free parameters, (nf,), moved onto its bounds where it violates them."""
        return np.asarray(np.clip(self.model.vector(), self.lower, self.upper)[self.index])

    def allows(self, values: Array) -> bool:
        """Whether free values (nf,) are within the bounds, as far as a solver keeps to them."""
        low, high, near = self.lower[self.index], self.upper[self.index], self.scale[self.index]
        return bool(((low - NEAR * near <= values) & (values <= high + NEAR * near)).all())

    def prior_residuals(self, values: Array) -> tuple[Array, Array]:
        """(λ − λ₀)/σ of all priors at free values (nf,), and the derivatives (priors, nf).

        Behind them the residuals of other evidence, in standard deviations too.
        """
        if not self.priors and self.evidence is None:
            return np.zeros(0), np.zeros((0, len(self.index)))
        rows = np.array([self.names.index(name) for name in self.priors], dtype=int)
        mean, std = np.array(list(self.priors.values())).reshape(-1, 2).T
        off, pull = (values[rows] - mean) / std, np.eye(len(self.index))[rows] / std[:, None]
        if self.evidence is None:
            return off, pull
        more, slopes = self.evidence.residuals(values)
        return np.concatenate([off, more]), np.vstack([pull, slopes])

    def prior_scatter(self, values: Array) -> Array:
        """Covariance (nf, nf) of the gradient of ½ Σ of the squares of `prior_residuals`."""
        pull = replace(self, evidence=None).prior_residuals(values)[1]
        own = pull.T @ pull
        return own if self.evidence is None else own + self.evidence.scatter(values)

    def constraint_slopes(self, values: Array) -> Array:
        """Derivatives of the model's constraints by the free parameters at free values, (m, nf)."""
        lam = ca.SX.sym("lam", len(self.index))
        c = self.model.matrices()(self.full(lam))[5]
        slopes = ca.Function("slopes", [lam], [ca.jacobian(c, lam)])
        return np.asarray(slopes(values).full())

    @cached_property
    def constraint_sizes(self) -> Array:
        """What typical moves of the parameters change of the model's constraints, (m,).

        Their units: a constraint says the same in whatever multiple its file has it.
        """
        slopes = self.constraint_slopes(self.guess) * self.scale[self.index]
        size = np.abs(slopes).sum(axis=1)
        return np.where((size > 0) & np.isfinite(size), size, 1.0)

    @cached_property
    def constraint_limits(self) -> Array:
        """Lower and upper limits of the model's constraints in those units, (2, m)."""
        sides = [(float(each.lower), float(each.upper)) for each in self.model.constraints()]
        return np.asarray(np.array(sides).reshape(-1, 2).T / self.constraint_sizes)

    def full(self, free: Any) -> Any:  # noqa: ANN401 - MX, SX or array in, the same out
        """λ (n_λ,) from the free values (nf,), numbers or symbols."""
        fixed = self.model.vector()
        if isinstance(free, np.ndarray):
            fixed[self.index] = free
            return fixed
        entries = list(map(ca.DM, fixed))
        for position, i in enumerate(self.index):
            entries[i] = free[position]
        return ca.vertcat(*entries)


def free_parameters(
    model: Model,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    priors: Priors | None = None,
) -> Free:
    """Which parameters are free in which bounds, equal ones fixing; ModelError if none can be."""
    bounds, priors = dict(bounds or {}), dict(priors or {})
    _check_choice(model, fixed, {**bounds, **priors})
    infos = model.infos()
    limits = {name: bounds.get(name, (info.lower, info.upper)) for name, info in infos.items()}
    for name, pair in limits.items():
        declaration.check_pair(name, pair)
    lower, upper = (np.array([pair[i] for pair in limits.values()], dtype=float) for i in (0, 1))
    held = np.array([name in fixed for name in infos], dtype=bool)
    guess = model.vector()
    for i, name in enumerate(infos):  # equal bounds fix the value, whatever the guess says
        if lower[i] == upper[i] and name not in fixed:
            guess[i], held[i] = lower[i], True
    index = np.flatnonzero(~held)
    if not infos:
        raise ModelError(f"{type(model).__name__} has no parameters: there is nothing to estimate")
    if not len(index):
        raise ModelError("every parameter is fixed: nothing is left to estimate; free one")
    model = model.with_vector(guess)
    _check_delays(model, np.where(held, guess, lower), np.where(held, guess, upper))
    given = [info.scale for info in infos.values()]
    widths = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    typical = np.maximum(np.abs(guess), 0.1 * widths)
    scale = np.array(
        [s or (value if value > 0 else 1.0) for s, value in zip(given, typical, strict=True)]
    )
    _check_held(model, held, lower - NEAR * scale, upper + NEAR * scale)
    names = list(infos)
    for name, pair in priors.items():
        declaration.check_prior(name, pair, scale[names.index(name)], declaration.WEIGHED)
    known = {names[i]: priors[names[i]] for i in index if names[i] in priors}
    return Free(model, index, lower, upper, scale, known)


def violated(free: Free, values: Array) -> str | None:
    """Say which constraint of the structure does not hold at free values; None if all do."""
    model = free.model.with_vector(free.full(values))
    pairs = zip(model.constraints(), free.model.constraints(), strict=True)
    for (item, wanted), size in zip(pairs, free.constraint_sizes.tolist(), strict=True):
        value = float(item.value)
        slack = 1e-6 * max(size, abs(value))
        if not float(wanted.lower) - slack <= value <= float(wanted.upper) + slack:
            return (
                f"constraint {item.name!r} is {value:.4g}, wanted between {wanted.lower:.4g} and "
                f"{wanted.upper:.4g}; loosen it, or a bound that contradicts it; of a trim, make "
                "another state or input unknown"
            )
    return None


def _check_held(model: Model, held: BoolArray, lower: Array, upper: Array) -> None:
    """Refuse a fixed value outside its bounds (n_λ,): a table would show both."""
    values, names = model.vector(), model.parameter_names()
    for i in np.flatnonzero(held & ~((lower <= values) & (values <= upper))):
        raise ModelError(
            f"{names[i]} is fixed at {values[i]:g}, outside its bounds [{lower[i]:.6g}, "
            f"{upper[i]:.6g}]: give it a value within them, move the bounds, or free it"
        )


def _check_delays(model: Model, lower: Array, upper: Array) -> None:
    """Refuse bounds (n_λ,) between which a delay may be negative."""
    # Where a delay is not linear in the parameters, or constraints between them may keep it
    # positive, it is looked at in the guess alone.
    lam, at = ca.SX.sym("lam", len(lower)), model.vector()
    tau, c = model.matrices()(lam)[4:]
    slopes = ca.jacobian(tau, lam)
    values, J = (part.full() for part in ca.Function("delays", [lam], [tau, slopes])(at))
    tied = ca.jacobian(c, lam).sparsity().get_triplet()[1]
    names = model.parameter_names()
    for j, (delay, row) in enumerate(zip(values.ravel(), J, strict=True)):
        moved, least = np.flatnonzero(row), float(delay)
        kept = len(moved) > 1 and not set(tied).isdisjoint(moved)
        if not kept and not ca.depends_on(slopes[j, :], lam):
            lowest = np.where(row > 0, lower, upper)[moved]
            least += float(row[moved] @ (lowest - at[moved]))
        if least < -NO_DELAY:
            by = ", ".join(names[i] for i in moved)
            may = f"may be {least:g} s between the bounds of {by}" if by else f"is {least:g} s"
            remedy = ": bound it there" if by else ", that of other clocks is for Record.shift"
            raise ModelError(
                f"{type(model).__name__}.delays: that of {model.inputs[j]!r} {may}; a delay is 0 s "
                f"or more{remedy}"
            )


def _check_choice(model: Model, fixed: Collection[str], bounds: Bounds) -> None:
    if isinstance(model, type):
        raise ModelError(
            f"{model.__name__} is a class, expected a model: call it, {model.__name__}()"
        )
    if isinstance(fixed, str):
        raise ModelError(f"fixed={fixed!r}: expected a collection of names, ({fixed!r},)")
    said = f"{type(model).__name__} has no parameter"
    check_known(said, (*fixed, *bounds), model.parameter_names(), ModelError)


def delay_parameters(free: Free) -> tuple[list[int], list[int]]:
    """Free parameters that are a delay themselves, and inputs whose delay is composed of others."""
    lam = ca.SX.sym("lam", len(free.index))
    slope = ca.jacobian(free.model.matrices()(free.full(lam))[4], lam)
    bare, composed = [], []
    for j in range(slope.shape[0]):
        row = slope[j, :]
        which = row.sparsity().get_triplet()[1]
        if len(which) == 1 and row[0, which[0]].is_one():
            bare.append(int(which[0]))
        elif row.nnz():
            composed.append(j)
    return bare, composed
