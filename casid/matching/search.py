"""The solves of one match in order, and what is checked of what a solver calls success.

Every way to a start is tried, the guess as it is among them. Each distinct minimum is solved for
in the quadratic norm; from there, in the H-infinity norm, peaks between the points are added until
the certificate over the band is near the grid's value. No result is worse than the guess.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.free import Free, violated
from casid.linear import StateSpace
from casid.matching.appraisal import EXACT, Appraisal, appraise, doubts, response_size
from casid.matching.comparison import Comparison
from casid.matching.descent import Condensed, check_effects, descend
from casid.matching.initial import starts
from casid.matching.programme import Optimum, Programme
from casid.nlp import SolverOptions

GAP = 0.01  # between grid value and bound over the band
HIGH = 0.5  # of the highest peak of the quadratic fit: what is added before the first solve
ROUNDS = 12  # of adding peaks to the grid
LARGE = 2500  # numbers a response and its states hold, above which one good start is enough
WORSE = 1e-4  # relative increase of a cost that is none


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchResult:
    """Where a programme ended: values (nf,), prices of bounds and constraints, how it got there."""

    values: Array
    multipliers: Array
    prices: Array
    cost: float
    success: bool
    status: str
    start: str
    appraisal: Appraisal


class MatchSearch:
    """The solves of one match; counts their iterations. Poles stay left of the line if stable."""

    def __init__(
        self, free: Free, comparison: Comparison, *, stable: bool, options: SolverOptions
    ) -> None:
        self.free, self.comparison, self.stable, self.options = free, comparison, stable, options
        self.iterations = 0
        self.negligible = EXACT * response_size(comparison)
        K, ny, nu = comparison.G.shape
        self.large = 2 * K * nu * (ny + len(free.model.states)) > LARGE

    def quadratic(self) -> list[MatchResult]:
        """Quadratic fits from all starts, best first; of a large one the first that converges."""
        check_effects(Condensed.of(self.free, self.comparison))
        problem = Condensed.of(self.free, self.comparison, guarded=self.stable)
        found: list[MatchResult] = []
        for start in starts(problem, large=self.large):
            found.append(self._solve("quadratic", start.name, start.values, self.comparison))
            if self.large and found[-1].success and found[-1].cost <= start.cost * (1 + WORSE):
                break
        size = np.linalg.norm(self.comparison.error(self.system(self.free.guess))) ** 2
        if self._beats(float(size) / len(self.comparison.s), min(found, key=_rank).cost):
            given = self._solve("quadratic", "guess", self.free.guess, self.comparison)
            found.append(given)
        return sorted(found, key=_rank)

    def hinf(self, fits: Sequence[MatchResult]) -> MatchResult:
        """The H-infinity fit from quadratic ones, certified over the band."""
        found: list[MatchResult] = []
        for k, fit in enumerate(fits):
            if not any(np.isclose(fit.cost, other.cost, rtol=1e-6) for other in fits[:k]):
                found.append(self._from(fit))
        best = self._certify(min(found, key=_rank))
        norm, given = self.comparison.norm, self.system(self.free.guess)
        if self._beats(norm(given), norm(best.appraisal.system)):
            values = self.free.guess
            known = appraise(self.system(values), self.comparison)
            start = replace(best, values=values, appraisal=known, start="guess")
            best = min(best, self._certify(self._from(start)), key=_rank)
        return best

    def _beats(self, cost: float, found: float) -> bool:
        """Whether the guess, of the given cost, is admissible and better than what was found."""
        if not cost < found * (1 - WORSE):
            return False
        return not self._unstable(self.free.guess) and not violated(self.free, self.free.guess)

    def _from(self, fit: MatchResult) -> MatchResult:
        """The H-infinity fit from another, its highest peaks on the grid."""
        return self._improve(fit, fit.appraisal.with_peaks(HIGH * fit.appraisal.upper))

    def _certify(self, found: MatchResult) -> MatchResult:
        """Add the peaks between the points and solve again until the bound is near the grid."""
        for _ in range(ROUNDS):
            if not found.success or self._close(found):
                return found
            norm = found.appraisal.grid_norm
            found = self._improve(found, found.appraisal.with_peaks(norm * (1 + 1e-3)))
        if not found.success or self._close(found):
            return found
        gap = f"{found.appraisal.upper / found.appraisal.grid_norm - 1:.1%}"
        status = f"the bound over the band stays {gap} above the grid; pass a finer omega"
        return replace(found, success=False, status=status)

    def _close(self, found: MatchResult) -> bool:
        """Whether the bound over the band is near the value on the grid."""
        appraisal = found.appraisal
        return appraisal.upper <= max(appraisal.grid_norm * (1 + GAP), self.negligible)

    def _improve(self, found: MatchResult, comparison: Comparison) -> MatchResult:
        """The H-infinity fit on a grid; an error that is rounding cannot be improved."""
        system = self.system(found.values)
        if comparison.norm(system) > self.negligible:
            return self._solve("hinf", found.start, found.values, comparison)
        appraisal, none = appraise(system, comparison), np.zeros_like(found.multipliers)
        prices = np.zeros_like(found.prices)
        cost = appraisal.grid_norm
        return replace(found, cost=cost, appraisal=appraisal, multipliers=none, prices=prices)

    def _solve(self, norm: str, start: str, values: Array, comparison: Comparison) -> MatchResult:
        """One programme; once more with the stability constraint if its solution needs it."""
        optimum = self._programme(norm, values, comparison, stable=False)
        if self._unstable(optimum.values) or (optimum.held and not optimum.success):
            outside = self._unstable(values)
            if outside:  # values near the given ones with all poles left of the line, if found
                guarded = Condensed.of(self.free, comparison, guarded=True)
                values = descend(guarded, optimum.values, steps=100, tolerance=1e-4).values
            optimum = self._programme(norm, values, comparison, stable=True)
        appraisal = appraise(self.system(optimum.values), comparison)
        doubt = doubts(self.free, optimum.values, self.free.guess, appraisal, stable=self.stable)
        status = optimum.status if doubt is None or not optimum.success else doubt
        if not optimum.success and (broken := violated(self.free, optimum.values)):
            status = f"{status}: {broken}"
        cost, unit = optimum.cost, 1.0
        if norm == "hinf":  # the programme minimises t, the cost is √t
            cost = appraisal.grid_norm
            unit = 1 / (2 * max(cost, self.negligible, 1e-300))
        return MatchResult(
            values=optimum.values,
            multipliers=optimum.multipliers * unit,
            prices=optimum.prices * unit,
            cost=cost,
            success=optimum.success and doubt is None,
            status=status,
            start=start,
            appraisal=appraisal,
        )

    def _programme(self, norm: str, values: Array, against: Comparison, *, stable: bool) -> Optimum:
        free = stable or not self.stable or self._unstable(values)
        line = None if free else self._line
        programme = Programme(self.free, against, norm, values, stable=stable, line=line)
        optimum = programme.solve(self.options, f"match {norm}")
        self.iterations += optimum.iterations
        return optimum

    def system(self, values: Array) -> StateSpace:
        """The structure at the free values."""
        return self.free.model.with_vector(self.free.full(values)).system()

    @property
    def _line(self) -> float | None:
        """Real part that no pole may exceed, a rounding right of the line."""
        line = self.comparison.line
        return None if line is None else line + 1e-6 * (1 + line)

    def _unstable(self, values: Array) -> bool:
        if not self.stable or self._line is None:
            return False
        return bool(self.system(values).poles().real.max() > self._line)


def _rank(found: MatchResult) -> tuple[bool, float]:
    """Order of results: solutions first, by increasing cost."""
    return not found.success, found.cost
