"""Profile of the cost: what holding one parameter, or two, at given values costs.

The profile over a parameter has its exact slope at every point, the multiplier of the tie that
holds it, so a few fits find the confidence interval that the likelihood implies (D. M. Bates,
D. G. Watts, Nonlinear Regression Analysis and Its Applications, 1988, chapter 6): signed roots of
twice the rise are nearly straight lines. The Cramér-Rao bound is the parabola at the estimate.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy

from casid.arrays import Array
from casid.bounds.cases import Case
from casid.bounds.pooled_warnings import tell
from casid.bounds.robust import weights
from casid.bounds.trials import Data, Fits
from casid.checks import check_level
from casid.display import Shown, counted
from casid.errors import ConvergenceError, ModelError
from casid.estimator import Estimator
from casid.fit import AnyFit, Fit
from casid.jobs.campaigns import Execution
from casid.model import Bounds, Model
from casid.shooting.output_error import OutputError
from casid.shooting.precision import OutputErrorNotes
from casid.tabulation import csv_text, markdown_table

ROUNDS = 12  # fits for an end, at most
SETTLED = 1e-2  # of the root's goal: what is left is taken along the tangent
LEAP = 3.0  # times the distance from the estimate: the longest step
TIED = 1e-9  # relative eigenvalue of a covariance below which its parameters are tied
BESIDE = 1e-6  # relative distance of a point from a tie that is none
FREE = "free"  # name of the job with nothing held


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Profile(Shown):
    """Least cost with some parameters held.

    Parameters
    ----------
    names : tuple of str
        The parameters held: one or two.
    points : (n, names) array
        Where they were held.
    cost : (n,) array
        Least cost there; NaN where the fit failed.
    slope : (n, names) array
        Its derivatives by the values held.
    reasons : tuple of str
        Why each point failed; empty for those that did not.
    fit : Fit
        With nothing held.
    level : float
        Confidence of the intervals.
    parabola : (n,) array
        The cost that the Cramér-Rao bound expects at the points; NaN without a likelihood, beside
        a tie, and where the estimate is on a bound.
    intervals : mapping
        By parameter, (low, high) where the cost, least over all others, has risen by half the χ²
        quantile with one degree of freedom, times what the variance of the estimate is of its
        Cramér-Rao bound; or the parameter's own bound before that. NaN without a likelihood,
        infinite where no fit succeeds that far out.
    standard, cramer_rao : mapping
        Estimate ± quantile times ``std_error``, and times the Cramér-Rao bound.
    """

    names: tuple[str, ...]
    points: Array
    cost: Array
    slope: Array
    reasons: tuple[str, ...]
    fit: AnyFit
    level: float
    parabola: Array
    intervals: Mapping[str, tuple[float, float]]
    standard: Mapping[str, tuple[float, float]]
    cramer_rao: Mapping[str, tuple[float, float]]

    def headline(self) -> str:
        """Estimates with their intervals."""
        each = (
            f"{name} = {self.fit[name].value:.4g} [{low:.4g}, {high:.4g}]"
            for name, (low, high) in self.intervals.items()
        )
        return (
            f"{', '.join(each)} at {100 * self.level:.3g} %, {counted(len(self.points), 'point')}"
        )

    def to_csv(self) -> str:
        """One row a point."""
        columns = [*self.names, "cost", *(f"slope_{name}" for name in self.names), "parabola"]
        rows = np.column_stack([self.points, self.cost, self.slope, self.parabola]).tolist()
        return csv_text(
            [*columns, "reason"],
            [[*row, reason] for row, reason in zip(rows, self.reasons, strict=True)],
        )

    def to_markdown(self) -> str:
        """The intervals."""
        rows = []
        for name in self.names:
            limits = (self.intervals[name], self.standard[name], self.cramer_rao[name])
            cells = [f"{low:.5g} to {high:.5g}" for low, high in limits]
            rows.append([name, f"{self.fit[name].value:.5g}", *cells])
        heading = ("parameter", "estimate", "by profile", "by standard error", "by Cramér-Rao")
        return markdown_table(heading, rows)


def profile_parameters(
    model: Model,
    data: Data,
    *,
    values: Mapping[str, Sequence[float]],
    estimator: Estimator = OutputError(),
    level: float = 0.95,
    start: Model | AnyFit | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> Profile:
    """Profile the cost over one parameter, or over a grid of two.

    Parameters
    ----------
    model, data, estimator, start, fixed, bounds, execution
        As in `compare_bounds`. Every point starts from the fit with nothing held.
    values : mapping
        What is held and where, ``{"Lp": [-3.0, -2.5]}``; of two parameters all combinations. The
        intervals do not depend on it: their ends are found by fits that hold one parameter.
    level : float
        Confidence of the intervals.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        A level outside 0 to 1;
        no value, an unknown parameter, a value outside its bounds; the fit with nothing held fails.
    """
    check_level(level, "confidence")
    names, points = _combined(values)
    labels = [_label(names, point) for point in points]
    at = [dict(zip(names, point, strict=True)) for point in points.tolist()]
    many = Fits(model, data, estimator, fixed, bounds, execution)
    free, *held = many.cases({FREE: {}} | dict(zip(labels, at, strict=True)))
    first = many.job(free, start)
    guess = start.model if isinstance(start, Fit) else start
    points_of = [many.job(case, guess, after=[first], asked=False) for case in held]
    done = many.run([first, *points_of])
    whole = done.pop(FREE)
    tell({FREE: whole.warnings})  # of the points it is what holding them there makes of the fit
    if whole.reason:
        raise ConvergenceError(f"profile_parameters: nothing held: {whole.reason}", whole.result)
    found = [done[label] for label in labels]
    fits: list[AnyFit | None] = [None if each.reason else each.result for each in found]
    quantile = float(np.sqrt(scipy.special.chdtri(1, 1 - level)))
    return Profile(
        names=names,
        points=points,
        cost=np.array([np.nan if fit is None else fit.cost for fit in fits]),
        slope=np.array([_slopes(*each, names) for each in zip(fits, held, strict=True)]),
        reasons=tuple(each.reason for each in found),
        fit=whole.result,
        level=level,
        parabola=_parabola(whole.result, names, points),
        intervals={name: _interval(many, whole.result, name, quantile) for name in names},
        standard=_around(whole.result, names, "std_error", quantile),
        cramer_rao=_around(whole.result, names, "cramer_rao", quantile),
    )


def _combined(values: Mapping[str, Sequence[float]]) -> tuple[tuple[str, ...], Array]:
    """The one or two parameters, and all combinations (n, 1 or 2) of their values."""
    names = tuple(values)
    if not 1 <= len(names) <= 2:
        raise ModelError(f"values name {len(names)} parameters, expected one or two")
    points = np.array(list(product(*values.values())), dtype=float).reshape(-1, len(names))
    if not len(points):
        raise ModelError(f"no values of {' and '.join(names)} given")
    for name, own in values.items():
        if twice := [x for x in own if list(own).count(x) > 1]:
            raise ModelError(f"values of {name} have {twice[0]:g} twice; leave one out")
    return names, points


def _around(
    fit: AnyFit, names: Sequence[str], error: str, quantile: float
) -> dict[str, tuple[float, float]]:
    """Values less and more by so many of their errors of a kind."""
    ends = {name: quantile * getattr(fit[name], error) for name in names}
    return {name: (fit[name].value - half, fit[name].value + half) for name, half in ends.items()}


def _label(names: Sequence[str], point: Array) -> str:
    return ", ".join(f"{name} = {x!r}" for name, x in zip(names, point.tolist(), strict=True))


def _slopes(fit: AnyFit | None, case: Case, names: Sequence[str]) -> Array:
    """Prices of the ties that hold the point; its case may hold what they leave without effect."""
    if fit is None:
        return np.full(len(names), np.nan)
    rows = zip(case.relations, fit.constraints[-len(case.relations) :], strict=True)
    prices = {relation.names: row.multiplier for relation, row in rows}
    return np.array([prices[name,] for name in names])


def _interval(many: Fits, free: AnyFit, name: str, quantile: float) -> tuple[float, float]:
    """Where the cost, least over all other parameters, has risen by half the quantile squared."""
    if free.R is None:
        return np.nan, np.nan
    w = weights(free, np.eye(len(free.free_names))[[free.free_names.index(name)]])
    goal = quantile * float(np.sqrt(w.sum() if len(w) else 1.0))
    return _end(many, free, name, -goal), _end(many, free, name, goal)


def _end(many: Fits, free: AnyFit, name: str, goal: float) -> float:
    """One end, by Newton's steps along the root z of twice the rise, its sign that of the goal."""
    row = free[name]
    side, limit = np.sign(goal), row.upper if goal > 0 else row.lower
    first = row.cramer_rao if row.cramer_rao > 0 else row.insensitivity
    near, far, x = row.value, side * np.inf, row.value + goal * first
    for _ in range(ROUNDS):
        x = float(min(x * side, limit * side) * side)
        if x == near:  # already on its bound
            return x
        (case,) = many.cases({f"{name} = {x!r}": {name: x}})
        done = many.run([many.job(case, free, asked=False)])[case.name]
        if done.reason:
            far, x = x, (near + x) / 2
            continue
        z = side * float(np.sqrt(max(2 * (done.result.cost - free.cost), 0.0)))
        step = z * (goal - z) / float(_slopes(done.result, case, [name])[0])
        if abs(goal - z) <= SETTLED * abs(goal) or (x == limit and abs(z) < abs(goal)):
            return x if x == limit else x + step
        near, far = (x, far) if abs(z) < abs(goal) else (near, x)
        longest = LEAP * abs(x - row.value)
        x += float(np.clip(step, -longest, longest))
        if not min(near, far) < x < max(near, far):
            x = (near + far) / 2
    return float(side * np.inf)


def _parabola(free: AnyFit, names: Sequence[str], points: Array) -> Array:
    """Cost of the points by the Cramér-Rao bound, ½ dᵀ C⁻¹ d above the least.

    NaN where there is none: beside a tie, and of a parameter on a bound, whose slope it lacks.
    """
    unknown = np.full(len(points), np.nan)
    if not isinstance(free.notes, OutputErrorNotes) or not set(names) <= set(free.free_names):
        return unknown
    index = [free.free_names.index(name) for name in names]
    size = np.sqrt(np.diag(free.notes.cramer_rao)[index])
    if not np.all(size > 0):
        return unknown
    C = free.notes.cramer_rao[np.ix_(index, index)] / np.outer(size, size)
    d = (points - np.array([free[name].value for name in names])) / size
    inverse = np.linalg.pinv(C, rcond=TIED, hermitian=True)
    beside = np.abs(d - d @ inverse @ C).max(axis=1) > BESIDE * np.abs(d).max(axis=1)
    rise = 0.5 * np.einsum("ni,ij,nj->n", d, inverse, d)
    return np.where(beside, np.nan, free.cost + rise)
