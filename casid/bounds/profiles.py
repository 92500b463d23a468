"""Profile of the cost: what holding one parameter, or two, at given values costs.

The profile over a parameter has its exact slope at every point, the multiplier of the tie that
holds it, so a few points give the confidence interval that the likelihood implies (D. M. Bates,
D. G. Watts, Nonlinear Regression Analysis and Its Applications, 1988, chapter 6). The Cramér-Rao
bound is its parabola at the estimate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.interpolate
import scipy.stats

from casid.arrays import Array
from casid.bounds.cases import CaseSpec
from casid.bounds.trials import Data, Fits
from casid.display import Shown
from casid.errors import ConvergenceError, ModelError
from casid.estimator import Estimator
from casid.fit import AnyFit, Fit
from casid.jobs.campaigns import Execution
from casid.jobs.store import Done
from casid.model import Bounds, Model
from casid.shooting.output_error import OutputError
from casid.shooting.precision import OutputErrorNotes
from casid.tabulation import csv_text, markdown_table

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
        The cost that the Cramér-Rao bound expects at the points; NaN without a likelihood.
    intervals, cramer_rao : mapping
        By parameter, (low, high) where the profile of the likelihood rises by half the χ² quantile
        with one degree of freedom, and estimate ± that many standard errors. A side is infinite
        where the values do not reach far enough, NaN without a likelihood.
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
    cramer_rao: Mapping[str, tuple[float, float]]

    def headline(self) -> str:
        """Estimates with their intervals."""
        each = (
            f"{name} = {self.fit[name].value:.4g} [{low:.4g}, {high:.4g}]"
            for name, (low, high) in self.intervals.items()
        )
        return f"{', '.join(each)} at {100 * self.level:.3g} %, {len(self.points)} points"

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
            limits = (self.fit[name].value, *self.intervals[name], *self.cramer_rao[name])
            rows.append([name, *(f"{x:.5g}" for x in limits)])
        heading = ("parameter", "estimate", "profile, low", "high", "Cramér-Rao, low", "high")
        return markdown_table(heading, rows)


def profile_parameters(
    model: Model,
    data: Data,
    *,
    values: Mapping[str, Sequence[float]],
    estimator: Estimator = OutputError(),
    level: float = 0.95,
    start: Model | AnyFit | None = None,
    fixed: Sequence[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> Profile:
    """Profile the cost over one parameter, or over a grid of two.

    Parameters
    ----------
    model, data, estimator, start, fixed, bounds, execution
        As in `compare_bounds`. Every point starts from the fit with nothing held.
    values : mapping
        What is held and where, ``{"Lp": [-3.0, -2.5]}``; of two parameters all combinations.
    level : float
        Confidence of the intervals.

    Raises
    ------
    ModelError, ConvergenceError
        No value, an unknown parameter, a value outside its bounds; the fit with nothing held fails.
    """
    names = tuple(values)
    if not 1 <= len(names) <= 2:
        raise ModelError(f"values name {len(names)} parameters, expected one or two")
    points = np.array(list(product(*values.values())), dtype=float).reshape(-1, len(names))
    if not len(points):
        raise ModelError(f"no values of {' and '.join(names)} given")
    specs: dict[str, CaseSpec] = {FREE: {}}
    for point in points:
        specs[_label(names, point)] = dict(zip(names, map(float, point), strict=True))
    many = Fits(model, data, estimator, fixed, bounds, execution)
    free, *held = many.cases(specs)
    first = many.job(free, start)
    guess = start.model if isinstance(start, Fit) else start
    done = many.run([first, *(many.job(case, guess, after=[first]) for case in held)])
    whole = done.pop(FREE)
    if whole.reason:
        raise ConvergenceError(f"profile_parameters: nothing held: {whole.reason}", whole.result)
    found = [done[_label(names, point)] for point in points]
    return _profile(names, points, whole.result, found, level)


def _label(names: Sequence[str], point: Array) -> str:
    return ", ".join(f"{name} = {x!r}" for name, x in zip(names, point.tolist(), strict=True))


def _profile(
    names: tuple[str, ...], points: Array, free: AnyFit, found: Sequence[Done], level: float
) -> Profile:
    fits = [None if each.reason else each.result for each in found]
    cost = np.array([np.nan if fit is None else fit.cost for fit in fits])
    unknown = np.full(len(names), np.nan)
    slope = np.array([unknown if fit is None else _slopes(fit, len(names)) for fit in fits])
    known, quantile = free.R is not None, float(scipy.stats.chi2.ppf(level, 1))
    intervals, expected = {}, {}
    for k, name in enumerate(names):
        estimate, error = free[name].value, free[name].cramer_rao
        intervals[name] = (np.nan, np.nan)
        if known:
            x, J, dJ = _lowest(points[:, k], cost, slope[:, k])
            intervals[name] = _interval((estimate, free.cost), (x, J, dJ), quantile / 2)
        half = float(np.sqrt(quantile)) * error
        expected[name] = (estimate - half, estimate + half)
    return Profile(
        names=names, points=points, cost=cost, slope=slope,
        reasons=tuple(each.reason for each in found), fit=free, level=level,
        parabola=_parabola(free, names, points), intervals=intervals, cramer_rao=expected,
    )  # fmt: skip


def _slopes(fit: AnyFit, count: int) -> Array:
    """Prices of the ties that hold the point: the last relations of its case."""
    return np.array([row.multiplier for row in fit.constraints[-count:]])


def _lowest(x: Array, J: Array, dJ: Array) -> tuple[Array, Array, Array]:
    """At every value of one axis the lowest cost over the other, in increasing order."""
    rows = []
    for value in np.unique(x[np.isfinite(J)]):
        at = np.flatnonzero((x == value) & np.isfinite(J))
        rows.append(at[np.argmin(J[at])])
    return x[rows], J[rows], dJ[rows]


def _interval(
    best: tuple[float, float], known: tuple[Array, Array, Array], rise: float
) -> tuple[float, float]:
    """Where the cubic through the points, with their slopes, has risen by ``rise``."""
    estimate, least = best
    x, J, dJ = known
    apart = np.abs(x - estimate) > 1e-9 * (1 + abs(estimate))
    order = np.argsort(np.append(x[apart], estimate))
    x, J = np.append(x[apart], estimate)[order], np.append(J[apart], least)[order]
    dJ = np.append(dJ[apart], 0.0)[order]
    if len(x) < 2:
        return -np.inf, np.inf
    curve = scipy.interpolate.CubicHermiteSpline(x, J - least - rise, dJ)
    crossings = np.asarray(curve.roots(extrapolate=False))
    below, above = crossings[crossings < estimate], crossings[crossings > estimate]
    return float(below.max(initial=-np.inf)), float(above.min(initial=np.inf))


def _parabola(free: AnyFit, names: Sequence[str], points: Array) -> Array:
    """Cost of the points by the Cramér-Rao bound: ½ dᵀ C⁻¹ d above the least."""
    if not isinstance(free.notes, OutputErrorNotes) or not set(names) <= set(free.free_names):
        return np.full(len(points), np.nan)
    index = [free.free_names.index(name) for name in names]
    C = free.notes.cramer_rao[np.ix_(index, index)]
    d = points - np.array([free[name].value for name in names])
    return np.asarray(free.cost + 0.5 * np.einsum("ni,ij,nj->n", d, np.linalg.pinv(C), d))
