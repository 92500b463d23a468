"""The same fit from many starts."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.bounds.pooled_warnings import tell
from casid.bounds.trials import Data, Fits
from casid.display import Cells, Tabled, counted
from casid.errors import ConvergenceError
from casid.estimator import Estimator
from casid.fit import AnyFit
from casid.free import free_parameters
from casid.jobs.campaigns import Execution
from casid.model import Bounds, Model
from casid.shooting.output_error import OutputError
from casid.tabulation import csv_text

SAME = 1e-6  # relative difference of costs that are the same minimum


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Multistart(Tabled):
    """Minima found from many starts.

    Parameters
    ----------
    starts : tuple of Model
        The first is the one given.
    costs : (n,) array
        NaN where the fit failed.
    reasons : tuple of str
        Why, empty otherwise.
    fit : Fit
        The best.
    """

    starts: tuple[Model, ...]
    costs: Array
    reasons: tuple[str, ...]
    fit: AnyFit

    def headline(self) -> str:
        """The best fit, and how many starts ended there."""
        many = counted(len(self.starts), "start")
        return f"{self.agreeing} of {many} ended in the best minimum: {self.fit.headline()}"

    def cells(self) -> Cells:
        """Heading, and one row a start: where it began, what it came to."""
        names = self.fit.free_names
        rows = []
        for start, cost, reason in zip(self.starts, self.costs, self.reasons, strict=True):
            began = [f"{float(getattr(start, name)):.4g}" for name in names]
            rows.append([*began, f"failed: {reason}" if reason else f"{cost:.8g}"])
        return (*names, "cost"), rows

    @property
    def agreeing(self) -> int:
        """How many starts ended in the best minimum."""
        gap = self.costs - self.fit.cost
        return int(np.sum(gap <= SAME * (1 + abs(self.fit.cost))))

    def to_csv(self) -> str:
        """One row a start."""
        names = self.fit.free_names
        rows = [
            [*(float(getattr(start, name)) for name in names), float(cost), reason]
            for start, cost, reason in zip(self.starts, self.costs, self.reasons, strict=True)
        ]
        return csv_text([*names, "cost", "reason"], rows)


def multistart(
    model: Model,
    data: Data,
    *,
    starts: int = 10,
    spread: float = 0.5,
    seed: int = 0,
    estimator: Estimator = OutputError(),
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    execution: Execution = Execution(),
) -> Multistart:
    """Fit from many starts and keep the best.

    Parameters
    ----------
    model, data, estimator, fixed, bounds, execution
        As in `compare_bounds`.
    starts : int
        How many; the first is the model's own values.
    spread : float
        Standard deviation of the others about them, of each parameter's typical magnitude.
    seed : int
        Of the draws.

    Raises
    ------
    ValueError, ConvergenceError
        No start, a negative spread; no start led to a minimum.
    """
    if starts < 1:
        raise ValueError(f"starts={starts}: expected 1 or more")
    if not spread >= 0:
        raise ValueError(f"spread={spread}: expected 0 or more")
    many = Fits(model, data, estimator, fixed, bounds, execution)
    (case,) = many.cases({"start": {}})
    free = free_parameters(model, fixed, bounds)
    inside = free.index
    models = [free.model.with_vector(free.full(free.guess))]
    for k in range(1, starts):
        rng = np.random.default_rng([seed, k])
        moved = free.guess + spread * free.scale[inside] * rng.standard_normal(len(inside))
        moved = np.clip(moved, free.lower[inside], free.upper[inside])
        models.append(free.model.with_vector(free.full(moved)))
    jobs = [many.job(case, each, name=f"start {k}") for k, each in enumerate(models)]
    done = many.run(jobs)
    found = list(done.values())
    good = [each for each in found if not each.reason]
    best = min(good, key=lambda each: float(each.result.cost), default=found[0])
    tell({"best": best.warnings})
    if not good:
        raise ConvergenceError(f"multistart: none of {starts} starts converged: {found[0].reason}")
    return Multistart(
        starts=tuple(models),
        costs=np.array([np.nan if each.reason else each.result.cost for each in found]),
        reasons=tuple(each.reason for each in found),
        fit=best.result,
    )
