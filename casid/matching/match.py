"""Match a structure to a black box and to frequency responses, in the quadratic or H-infinity norm.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 3.3: min over λ of ‖Ĝ(s) − G(s; λ)‖ on the shifted line (8)-(10). The programmes are those
of `casid.matching.lifted`; here are the order of the solves, the certificate over the band and the
checks of what a solver calls success.
"""

import logging
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.errors import ConvergenceError, ModelError
from casid.fit import AnyFit, Fit, constraint_table, held_directions, parameter_table
from casid.linear import StateSpace
from casid.matching.appraisal import (
    EXACT,
    Appraisal,
    MatchNotes,
    appraise,
    doubts,
    response_size,
)
from casid.matching.comparison import Comparison, Target, Weight, compare
from casid.matching.descent import Condensed, descend
from casid.matching.initial import starts
from casid.matching.lifted import Lifted, lift
from casid.model import Bounds, Free, M, free_parameters
from casid.nlp import Solution, SolverOptions, solve

LOG = logging.getLogger("casid")

NORMS = ("quadratic", "hinf")
GAP = 0.01  # between grid value and bound over the band
HIGH = 0.5  # of the highest peak of the quadratic fit: what is added before the first solve
ROUNDS = 12  # of adding peaks to the grid
# A quadratic programme starts next to its solution, which its barrier must not blur.
NEAR: dict[str, dict[str, float | str]] = {
    "quadratic": {"mu_init": 1e-7, "bound_push": 1e-8, "bound_frac": 1e-8, "tol": 1e-11,
                  "acceptable_tol": 1e-8, "acceptable_iter": 3},
    "hinf": {"mu_init": 1e-2, "bound_mult_init_method": "mu-based"},
}  # fmt: skip
LARGE = 2500  # numbers a response and its states hold, above which one good start is enough


@dataclass(frozen=True, eq=False, kw_only=True)
class Match:
    """Match of a structure to targets, as an estimator.

    Parameters
    ----------
    norm : {"hinf", "quadratic"}
        The largest singular value of the weighted error over grid and band, or the mean over the
        grid of its squared Frobenius norm.
    omega : (K,) array
        Grid [rad/s]; 40 points over the black box's band unless given.
    shift : float
        σ >= 0 [1/s], right of all poles of the black box: frequencies below about σ are blurred.
        The default is the least that leaves a margin of a tenth of the rightmost pole's modulus.
    weight : None, "relative", array, or a sequence of one a target
        On top of the default scaling by standard deviations, std(u)/std(y), an array that
        broadcasts to (K, ny, nu), zeros being masks, linear in ω between the grid's points.
        "relative" divides every output's error by the size of its response at that frequency.
    source_weight : sequence of float
        Factor on the error of each target, one unless given.
    stable_shift : bool
        Keep the structure's poles left of the line s = σ + jω.
    solver : SolverOptions
        Limits and tolerance of every solve.
    """

    norm: str = "hinf"
    omega: Array | None = None
    shift: float | None = None
    weight: Weight | Sequence[Weight] = None
    source_weight: Sequence[float] | None = None
    stable_shift: bool = True
    solver: SolverOptions = SolverOptions()

    def fit(
        self,
        model: M,
        data: Target | Sequence[Target],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,  # noqa: ARG002 - its model is the start already
    ) -> Fit[M, MatchNotes]:
        """The parameters with which a structure comes nearest to targets; see `match`."""
        if self.norm not in NORMS:
            raise ValueError(f"norm={self.norm!r}: expected one of {', '.join(map(repr, NORMS))}")
        begin = time.perf_counter()
        targets = list(data) if isinstance(data, Sequence) else [data]
        free = free_parameters(model, fixed, bounds)
        comparison = compare(
            model, targets, omega=self.omega, shift=self.shift, weight=self.weight,
            source_weight=self.source_weight,
        )  # fmt: skip
        matcher = _Matcher(free, comparison, self.stable_shift, self.solver)
        fits = matcher.quadratic()
        state = matcher.hinf(fits) if self.norm == "hinf" else fits[0]
        fit = matcher.fit(state, self.norm, model, time.perf_counter() - begin)
        LOG.info("%s: cost %.6g, %d iterations, %.2f s", fit.method, fit.cost, fit.iterations,
                 fit.seconds)  # fmt: skip
        if not fit.success:
            raise ConvergenceError(f"match {self.norm}: {fit.status}", best=fit)
        return fit


def match(
    model: M,
    target: Target | Sequence[Target],
    *,
    norm: str = "hinf",
    omega: Array | None = None,
    shift: float | None = None,
    weight: Weight | Sequence[Weight] = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    solver: SolverOptions = SolverOptions(),
) -> Fit[M, MatchNotes]:
    """The parameters with which a structure comes nearest to a target's response.

    Parameters
    ----------
    model : Model
        Structure and guess; its channels are found in the target by name.
    target : BlackBox, FrequencyResponse or a sequence of both
        What to match. Measured responses enter at their own points of s = jω, weighted by
        coherence (pairs below 0.6 are left out), black boxes on s = σ + jω.
    norm, omega, shift, weight, solver
        As in `Match`, which has the rarer settings too.
    fixed, bounds
        Parameters held, and bounds {name: (lower, upper)} instead of the model file's.

    Returns
    -------
    Fit
        ``cost`` is the norm (H-infinity) or the mean square (quadratic). ``certificate`` bounds
        the norm over the band. ``notes`` holds singular values over the band, the frequency and
        channels of the optimum, and what each target contributes.

    Raises
    ------
    ValueError, ModelError
        A channel no target has, a grid outside the band, a shift left of a pole, wrong bounds.
    ConvergenceError
        No solution that passes the checks; ``best`` is the best iterate as a `Fit`.
    """
    matching = Match(norm=norm, omega=omega, shift=shift, weight=weight, solver=solver)
    return matching.fit(model, target, fixed=fixed, bounds=bounds)


@dataclass(frozen=True, eq=False, kw_only=True)
class _State:
    """Where a match stands: values (nf,), prices of bounds and constraints, how it got there."""

    values: Array
    multipliers: Array
    prices: Array
    cost: float
    success: bool
    status: str
    start: str
    appraisal: Appraisal


class _Matcher:
    """The solves of one match; counts their iterations."""

    def __init__(
        self, free: Free, comparison: Comparison, stable: bool, options: SolverOptions
    ) -> None:
        self.free, self.comparison, self.stable, self.options = free, comparison, stable, options
        self.iterations = 0
        self.negligible = EXACT * response_size(comparison)
        K, ny, nu = comparison.G.shape
        self.large = 2 * K * nu * (ny + len(free.model.states)) > LARGE

    def quadratic(self) -> list[_State]:
        """Quadratic fits from all starts, best first; of a large one the first that converges."""
        found: list[_State] = []
        problem = Condensed(self.free, self.comparison)
        _check_effects(problem, self.free)
        problem = problem.guarded() if self.stable else problem
        for start in starts(self.free, problem, large=self.large):
            found.append(self._solve("quadratic", start.name, start.values, self.comparison))
            if self.large and found[-1].success:
                break
        return sorted(found, key=lambda state: (not state.success, state.cost))

    def hinf(self, fits: Sequence[_State]) -> _State:
        """The H-infinity fit from quadratic ones, certified over the band."""
        found: list[_State] = []
        for k, fit in enumerate(fits):
            if not any(np.isclose(fit.cost, other.cost, rtol=1e-6) for other in fits[:k]):
                grid = fit.appraisal.with_peaks(HIGH * fit.appraisal.upper)
                found.append(self._improve(fit, grid))
        return self._certify(min(found, key=lambda state: (not state.success, state.cost)))

    def _certify(self, state: _State) -> _State:
        """Add the peaks between the points and solve again until the bound is near the grid."""
        for _ in range(ROUNDS):
            upper, norm = state.appraisal.upper, state.appraisal.grid_norm
            if not state.success or upper <= max(norm * (1 + GAP), self.negligible):
                return state
            state = self._improve(state, state.appraisal.with_peaks(norm * (1 + 1e-3)))
        gap = f"{state.appraisal.upper / state.appraisal.grid_norm - 1:.1%}"
        status = f"the bound over the band stays {gap} above the grid; pass a finer omega"
        return replace(state, success=False, status=status)

    def _improve(self, state: _State, comparison: Comparison) -> _State:
        """The H-infinity fit on a grid; an error that is rounding cannot be improved."""
        system = self.system(state.values)
        if comparison.norm(system) > self.negligible:
            return self._solve("hinf", state.start, state.values, comparison)
        appraisal = appraise(system, comparison)
        return replace(
            state,
            cost=appraisal.grid_norm,
            appraisal=appraisal,
            multipliers=np.zeros_like(state.multipliers),
            prices=np.zeros_like(state.prices),
        )

    def _solve(self, norm: str, start: str, values: Array, comparison: Comparison) -> _State:
        """One programme; once more with the stability constraint if its solution needs it."""
        lifted, solution = self._programme(norm, values, comparison, stable=False)
        found = lifted.parameters(solution.x)
        if self._unstable(found):
            stable = self._stabilised(comparison, found) if self._unstable(values) else values
            lifted, solution = self._programme(norm, stable, comparison, stable=True)
            found = lifted.parameters(solution.x)
        scale, unit = self.free.scale[self.free.index], lifted.unit**2
        appraisal = appraise(self.system(found), comparison)
        doubt = doubts(self.free, found, self.free.guess, appraisal, stable=self.stable)
        cost = solution.f * unit
        if norm == "hinf":  # the programme minimises t, the cost is √t
            cost = appraisal.grid_norm
            unit /= 2 * max(cost, self.negligible, 1e-300)
        return _State(
            values=found,
            multipliers=-solution.multipliers_x[: len(scale)] / scale * unit,
            prices=-solution.multipliers_g[lifted.ties] * unit,
            cost=cost,
            success=solution.success and doubt is None,
            status=solution.status if doubt is None or not solution.success else doubt,
            start=start,
            appraisal=appraisal,
        )

    def _programme(
        self, norm: str, values: Array, comparison: Comparison, *, stable: bool
    ) -> tuple[Lifted, Solution]:
        lifted = lift(self.free, comparison, norm, values, stable=stable)
        options = replace(self.options, ipopt=NEAR[norm] | dict(self.options.ipopt))
        solution = solve(lifted.problem, options, stage=f"match {norm}")
        self.iterations += solution.iterations
        return lifted, solution

    def system(self, values: Array) -> StateSpace:
        """The structure at the free values."""
        return self.free.model.with_vector(self.free.full(values)).system()

    def _unstable(self, values: Array) -> bool:
        line = self.comparison.line
        if not self.stable or line is None:
            return False
        return bool(self.system(values).poles().real.max() > line + 1e-6 * (1 + line))

    def _stabilised(self, comparison: Comparison, values: Array) -> Array:
        """Values near the given ones with all poles left of the line, if some are found."""
        problem = Condensed(self.free, comparison).guarded()
        return descend(problem, values, steps=100, tolerance=1e-4).values

    def fit(self, state: _State, norm: str, guess: M, seconds: float) -> Fit[M, MatchNotes]:
        """The result, its certificate and its tables."""
        free, values = self.free, state.values
        model = guess.with_vector(free.full(values))
        parameters = parameter_table(free, values, state.multipliers, guess=guess)
        return Fit(
            model=model,
            parameters=parameters,
            cost=state.cost,
            status=state.status,
            success=state.success,
            iterations=self.iterations,
            seconds=seconds,
            method=f"match {norm}",
            notes=state.appraisal.notes(state.start),
            constraints=constraint_table(model, state.prices),
            held=held_directions(free, values, parameters),
            certificate=state.appraisal.certificate(),
            free_names=free.names,
        )


def _check_effects(problem: Condensed, free: Free) -> None:
    idle = problem.idle()
    if len(idle):
        raise ModelError(
            f"{free.names[idle[0]]} has no effect on any weighted response: the target cannot "
            "identify it; fix it, or weigh an output that depends on it"
        )
