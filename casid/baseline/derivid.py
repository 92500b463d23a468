"""Fit a structure to measured frequency responses in decibels and degrees.

The frequency-domain baseline of rotorcraft identification: cost, coherence weighting, accuracy
figures and guidelines are those of M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System
Identification, 2nd ed. (*T&R*), chapters 12 and 13; the programmes are in
`casid.baseline.magphase`.
"""

import logging
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.baseline.accuracy import (
    DerividNotes,
    PairCost,
    StartCost,
    accuracy,
    accuracy_row,
    scatter,
)
from casid.baseline.equations import equation_start
from casid.baseline.magphase import (
    Programme,
    Target,
    delay_parameters,
    programme,
    tie_multipliers,
)
from casid.baseline.mismatch import DB, DEG, GOOD, PHASE, residuals
from casid.baseline.pairs import Pairs, select, thin
from casid.errors import ConvergenceError, ModelError
from casid.evaluation import MatrixFunction
from casid.fit import (
    AnyFit,
    Fit,
    constraint_table,
    held_directions,
    holding,
    parameter_table,
)
from casid.frequency.estimation import FrequencyResponse
from casid.model import Bounds, Free, M, Model, free_parameters
from casid.nlp import Solution, SolverOptions, solve

LOG = logging.getLogger("casid")

ROUGH = 1e-5  # tolerance of the relative fit
SAME = 1e-2  # relative difference of the parameters of relative fits that are the same
AGREES = 1e-4  # between J as IPOPT has it and J of the model found, relative to 1 + J


@dataclass(frozen=True, eq=False, kw_only=True)
class Derivid:
    """Fit of a structure to measured responses in dB and degrees, as an estimator.

    Parameters
    ----------
    pairs : sequence of (output, input), or mapping of these to (low, high) rad/s or None
        The pairs to fit, at all measured points of their range whatever the coherence, which still
        weighs them. Unless given: all pairs with five points of sufficient coherence, at those.
    coherence : float
        What is sufficient, in [0, 1).
    n_omega : int
        Number of frequencies: the measured ones nearest to this many log-spaced points.
    band : (float, float)
        Frequencies to fit [rad/s]; all that were measured unless given.
    starts : int
        Number of starting points: one computed from the measurement, the caller's guess, and
        random ones about the first. Beside a fit ``near`` the first two are enough.
    seed : int
        Of the random ones.
    solver : SolverOptions
        Limits and tolerance of every solve.
    """

    pairs: Pairs | None = None
    coherence: float = 0.6
    n_omega: int = 20
    band: tuple[float, float] | None = None
    starts: int = 5
    seed: int = 0
    solver: SolverOptions = SolverOptions()

    def fit(
        self,
        model: M,
        data: FrequencyResponse | Sequence[FrequencyResponse],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,
    ) -> Fit[M, DerividNotes]:
        """The parameters with which a structure fits a measured response best; see `derivid`."""
        began = time.perf_counter()
        if self.starts < 1 or self.n_omega < 2 or not 0 <= self.coherence < 1:
            raise ValueError(
                f"starts={self.starts}, n_omega={self.n_omega}, coherence={self.coherence}: "
                "expected at least 1, at least 2 and a coherence in [0, 1)"
            )
        frf = _one_response(data)
        free = _nonnegative_delays(free_parameters(model, fixed, bounds))
        measured = thin(frf if self.band is None else frf.between(*self.band), self.n_omega)
        target, used = select(model, measured, self.pairs, self.coherence)
        search = _Search(free, target, self.solver)
        _check_influence(search)
        starts = self.starts if near is None else min(2, self.starts)
        for number, (name, values, X) in enumerate(_starting_points(search, starts, self.seed)):
            search.run(f"{number + 1} ({name})", values, X)
        fit = _result(search, model, measured, used, time.perf_counter() - began)
        if not fit.success:
            raise ConvergenceError(
                f"derivid: none of {starts} starts converged ({fit.status}); the best iterate, "
                f"with J = {fit.cost:.4g}, is in .best",
                fit,
            )
        return fit


def derivid(
    model: M,
    target: FrequencyResponse | Sequence[FrequencyResponse],
    *,
    pairs: Pairs | None = None,
    n_omega: int = 20,
    band: tuple[float, float] | None = None,
    starts: int = 5,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    solver: SolverOptions = SolverOptions(),
) -> Fit[M, DerividNotes]:
    """The parameters with which a structure fits measured responses best in dB and degrees.

    Parameters
    ----------
    model : Model
        Structure and guess; its channels are found in the response by name.
    target : FrequencyResponse
        What to fit; several are merged first (`merge_responses`).
    pairs, n_omega, band, starts, solver
        As in `Derivid`, which has the rarer settings too.
    fixed, bounds
        Parameters held, and bounds {name: (lower, upper)} instead of the model file's. Delays are
        kept at >= 0 in any case.

    Returns
    -------
    Fit
        ``cost`` is the sum of J over pairs. ``std_error`` is √(H⁻¹)ᵢᵢ and ``insensitivity``
        1/√Hᵢᵢ, H the Gauss-Newton Hessian of the cost; parameters on a bound count as known.

    Raises
    ------
    ValueError
        A pair that was not measured, an empty band, bad arguments.
    ModelError
        A parameter on which no pair depends, wrong bounds.
    ConvergenceError
        No start converged; ``best`` is the best iterate.
    """
    estimator = Derivid(pairs=pairs, n_omega=n_omega, band=band, starts=starts, solver=solver)
    return estimator.fit(model, target, fixed=fixed, bounds=bounds)


def _one_response(data: FrequencyResponse | Sequence[FrequencyResponse]) -> FrequencyResponse:
    """The one response of the data.

    Raises
    ------
    ValueError
        Several, or something else.
    """
    several = list(data) if isinstance(data, Sequence) else [data]
    if len(several) != 1:
        raise ValueError(
            f"derivid fits one frequency response, not {len(several)}; merge them first"
        )
    if not isinstance(several[0], FrequencyResponse):
        raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
            f"the target is a {type(several[0]).__name__}: derivid fits a measured "
            "FrequencyResponse; a black box is what `match` takes"
        )
    return several[0]


def _nonnegative_delays(free: Free) -> Free:
    lower = free.lower.copy()
    at = free.index[delay_parameters(free)[0]]
    lower[at] = np.maximum(lower[at], 0.0)
    if (bad := np.flatnonzero(lower > free.upper)).size:
        name = free.model.parameter_names()[bad[0]]
        raise ModelError(f"{name} is a delay with upper bound {free.upper[bad[0]]:g} < 0; raise it")
    return replace(free, lower=lower)


# ---- starting points ---------------------------------------------------------------------------


def _starting_points(
    search: "_Search", count: int, seed: int
) -> list[tuple[str, Array, ComplexArray | None]]:
    """Names, free parameters and states' responses, most promising first."""
    free, target = search.free, search.target
    rng = np.random.default_rng(seed)
    found: list[tuple[str, Array, ComplexArray | None]] = [("guess", free.guess, None)]
    start = equation_start(free, target, search.matrices)
    if start is not None:
        found.insert(0, ("equations", *start))
    centre, scale = found[0][1], free.scale[free.index]
    lower, upper = free.lower[free.index], free.upper[free.index]
    while len(found) < count:
        spread = np.hypot(0.5 * centre, 0.05 * scale)
        drawn = centre + spread * rng.standard_normal(len(centre))
        found.append(("random", np.clip(drawn, lower, upper), None))
    return found[:count]


# ---- search ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _State:
    """Where one start ended."""

    values: Array
    multipliers: Array
    prices: Array
    cost: float
    success: bool
    status: str


class _Search:
    """Solves from many starts with the same two programmes, and remembers the best."""

    def __init__(self, free: Free, target: Target, options: SolverOptions) -> None:
        self.free, self.target, self.options = free, target, options
        self.matrices = MatrixFunction(free)
        self.best = _State(
            values=free.guess, multipliers=np.zeros(len(free.index)), cost=np.inf, success=False,
            status="not started", prices=np.zeros(len(free.model.constraints())),
        )  # fmt: skip
        self.rows: list[StartCost] = []
        self.iterations = 0
        self._visited: list[tuple[Array, _State]] = []
        self._programmes: dict[bool, Programme] = {}

    def run(self, name: str, values: Array, X: ComplexArray | None) -> None:
        """Relative fit from a start, then that in dB and degrees from there, if it is a new one."""
        began, iterations = time.perf_counter(), self.iterations
        near, X, _ = self._solve(f"derivid, start {name}, relative", values, X, logarithmic=False)
        state = self._known(near)
        if state is None:
            values, _, solution = self._solve(f"derivid, start {name}", near, X, logarithmic=True)
            state = self._state(values, solution)
            self._visited.append((near, state))
        self.rows.append(
            StartCost(
                start=name,
                J=state.cost,
                success=state.success,
                status=state.status,
                iterations=self.iterations - iterations,
                seconds=time.perf_counter() - began,
            )
        )
        if (not state.success, state.cost) < (not self.best.success, self.best.cost):
            self.best = state

    def _known(self, near: Array) -> _State | None:
        """Where an earlier start ended whose relative fit was this one."""
        scale = np.maximum(np.abs(near), 1e-3 * self.free.scale[self.free.index])
        for there, state in self._visited:
            if state.success and (np.abs(near - there) <= SAME * scale).all():
                return state
        return None

    def _solve(
        self, stage: str, values: Array, X: ComplexArray | None, *, logarithmic: bool
    ) -> tuple[Array, ComplexArray, Solution]:
        X = self._states(values) if X is None else X
        built = self._programme(X, logarithmic=logarithmic)
        problem = replace(built.problem, x0=built.pack(values, X))
        options = self.options
        if not logarithmic:  # a start for what follows need not be exact
            options = replace(options, tolerance=max(options.tolerance, ROUGH))
        solution = solve(problem, options, stage=stage)
        self.iterations += solution.iterations
        return *built.unpack(solution.x), solution

    def cost(self, values: Array) -> Array:
        """J of every pair, (ny, nu)."""
        G = self.matrices(values).response(1j * self.target.omega)
        return np.asarray(np.sum(residuals(G, self.target.G, self.target.weight) ** 2, axis=(0, 1)))

    def _states(self, values: Array) -> ComplexArray:
        system = self.free.model.with_vector(self.free.full(values)).system()
        s = 1j * self.target.omega[:, None, None]
        return np.asarray(
            np.linalg.solve(s * np.eye(system.nx) - system.A, system.B * self.target.input_scale)
        )

    def _programme(self, X: ComplexArray, *, logarithmic: bool) -> Programme:
        if logarithmic not in self._programmes:
            size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
            scale = np.maximum(size, 1e-6 * size.max() or 1.0)
            self._programmes[logarithmic] = programme(
                self.free, self.target, scale, logarithmic=logarithmic
            )
        return self._programmes[logarithmic]

    def _state(self, values: Array, solution: Solution) -> _State:
        """The cost is computed anew: what IPOPT calls a success is checked against it."""
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(self.cost(values).sum())
        held = np.isfinite(cost) and abs(cost - solution.f) <= AGREES * (1 + cost)
        success = solution.success and bool(held)
        status = solution.status
        if solution.success and not held:
            status = f"solved, but the model's own cost there is {cost:.6g}, not {solution.f:.6g}"
        scale = self.free.scale[self.free.index]
        multipliers = -solution.multipliers_x[: len(values)] / scale
        return _State(
            values=values, multipliers=multipliers, cost=cost if np.isfinite(cost) else np.inf,
            success=success, status=status, prices=-tie_multipliers(self.free, solution),
        )  # fmt: skip


def _check_influence(search: _Search) -> None:
    """Every parameter must move some pair that is fitted, at the guess or near it."""
    free, target = search.free, search.target
    rng = np.random.default_rng(0)
    scale = free.scale[free.index]
    moves = np.zeros(len(scale), dtype=bool)
    for _ in range(2):
        values = free.guess + 0.1 * scale * rng.standard_normal(len(scale))
        slope = search.matrices(values).response_slopes(1j * target.omega)[1] * (target.weight > 0)
        moves |= np.abs(slope).max(axis=(1, 2, 3)) > 0
    if not moves.all():
        name = free.names[int(np.argmin(moves))]
        raise ModelError(
            f"no pair that is fitted depends on {name}; fix it (fixed={{{name!r}}}) or add a pair "
            "that does"
        )


# ---- accuracy and report -----------------------------------------------------------------------


def _result(
    search: _Search, model: M, frf: FrequencyResponse, used: BoolArray, seconds: float
) -> Fit[M, DerividNotes]:
    free, best = search.free, search.best
    solved = model.with_vector(free.full(best.values))
    table = parameter_table(free, best.values, best.multipliers, guess=model)
    active = np.array([table[i].active for i in free.index])
    jacobian, noise = _residual_slopes(search, frf, used)
    held = holding(free, best.values, np.zeros_like(active))
    std, insensitivity, covariance = accuracy(jacobian, active, held)
    spread = scatter(jacobian, covariance, noise)
    parameters = parameter_table(
        free, best.values, best.multipliers, std_error=std, insensitivity=insensitivity, guess=model
    )
    pairs = _pair_rows(search, used, frf)
    figures = zip(free.names, best.values, std, insensitivity, spread, strict=True)
    return Fit(
        model=solved,
        parameters=parameters,
        cost=best.cost,
        status=best.status,
        success=best.success,
        iterations=search.iterations,
        seconds=seconds,
        method="derivid",
        notes=DerividNotes(
            pairs=pairs,
            average=float(np.mean([row.J for row in pairs])),
            table=tuple(accuracy_row(*row) for row in figures),
            starts=tuple(search.rows),
        ),
        constraints=constraint_table(solved, best.prices),
        held=held_directions(free, best.values, parameters),
        covariance=covariance,
        free_names=free.names,
    )


def _residual_slopes(
    search: _Search, frf: FrequencyResponse, used: BoolArray
) -> tuple[Array, Array]:
    """dr/dλ of the cost Σ r² at the best parameters, and the residuals' own random errors."""
    target = search.target
    G, slope = search.matrices(search.best.values).response_slopes(1j * target.omega)
    root = np.sqrt(target.weight)
    relative = slope / np.where(G == 0, 1, G) * root  # of ln G, weighted
    error = root * _random_errors(search.free.model, frf)
    units = (DB, np.sqrt(PHASE) * DEG)
    rows = [
        unit * part[:, used].T
        for unit, part in zip(units, (relative.real, relative.imag), strict=True)
    ]
    return np.vstack(rows), np.concatenate([unit * error[used] for unit in units])


def _pair_rows(search: _Search, used: BoolArray, frf: FrequencyResponse) -> tuple[PairCost, ...]:
    J = search.cost(search.best.values)
    rows = []
    for i, output in enumerate(search.free.model.outputs):
        for j, name in enumerate(search.free.model.inputs):
            at = np.flatnonzero(used[:, i, j])
            if len(at):
                rows.append(
                    PairCost(
                        output=output,
                        input=name,
                        J=float(J[i, j]),
                        points=len(at),
                        band=(float(frf.omega[at[0]]), float(frf.omega[at[-1]])),
                        misses=("J",) if J[i, j] > GOOD else (),
                    )
                )
    return tuple(rows)


def _random_errors(model: Model, frf: FrequencyResponse) -> Array:
    """Random error of every pair in the model's channels, NaN where unknown, (K, ny, nu)."""
    error = np.full((len(frf.omega), len(model.outputs), len(model.inputs)), np.nan)
    for i, output in enumerate(model.outputs):
        for j, name in enumerate(model.inputs):
            if output in frf.outputs and name in frf.inputs:
                error[:, i, j] = frf.random_error[:, *frf.index(output, name)]
    return error
