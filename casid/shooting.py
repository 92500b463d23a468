"""Output-error (maximum-likelihood) estimation by multiple shooting.

    y_k = C x_k + D u(t_k - τ) + b + v_k,   v_k ~ N(0, R) white

Every record is cut into intervals whose initial states are variables tied by continuity
constraints, so an unstable model and a poor start do no harm (Bock 1987); IPOPT with the
generalised Gauss-Newton Hessian minimises ½ Σ rᵀR⁻¹r, and R is re-estimated between solves until
it settles (relaxed maximum likelihood: Jategaonkar, Flight Vehicle System Identification, ch. 4).
Bergamasco & Lovera, section 3.4, use output error as the last step of the chain.
"""

import logging
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from casid.arrays import Array
from casid.errors import ConvergenceError
from casid.fit import Fit, parameter_table
from casid.intervals import lay_out
from casid.likelihood import CovarianceKind, Noise
from casid.model import Bounds, Free, Model, free_parameters
from casid.nlp import Solution, SolverOptions, solve
from casid.programme import Programme, Scales
from casid.record import Record
from casid.sensitivity import Evaluator, Point
from casid.uncertainty import eliminate

LOG = logging.getLogger("casid")

ROUNDS = 12  # of solves
ROUGH = 1e-4  # tolerance of the first, whose R is that of the start
SETTLED = 4.0  # factor by which a variance may fall in the last round: the scales still fit
FLOOR = 1e-6  # standard deviation of a residual is at least this share of the channel's
GROWTH = 1.0  # e-folds the fastest unstable mode may grow over an interval
LONGEST, SHORTEST = 5.0, 0.5  # of intervals chosen here [s]
SURPRISE = 0.5  # share of the input's effect that the starting model is trusted to miss

IPOPT: dict[str, float | str] = {"nlp_scaling_method": "none", "mu_strategy": "monotone"}
WARM: dict[str, float | str] = {  # a warm round stays where it starts
    "mu_init": 1e-6,
    "warm_start_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_slack_bound_push": 1e-9,
    "warm_start_slack_bound_frac": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
}


def output_error(
    model: Model,
    records: Sequence[Record],
    *,
    interval: float | None = None,
    R: Array | CovarianceKind | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    biases: bool = True,
    options: SolverOptions | None = None,
) -> Fit:
    """Maximum-likelihood estimate of a model from time histories.

    Parameters
    ----------
    model : Model
        Structure and start, e.g. ``match(...).model``.
    records : sequence of Record
        With at least the model's channels, by name; NaN in y and any sampling are welcome.
    interval : float
        Length of the shooting intervals [s]; from the model's fastest growing mode unless given.
    R : (ny, ny) array, "diagonal" or "full"
        Covariance of the measurement noise, or the structure in which it is estimated; None is
        "diagonal".
    fixed : collection of str
        Parameters held at the model's values.
    bounds : mapping
        ``{name: (lower, upper)}`` instead of the model file's.
    biases : bool
        Whether every record has a bias on each output.
    options : SolverOptions
        Limits and tolerance of each solve.

    Returns
    -------
    Fit
        ``cost`` is the negative logarithm of the likelihood, ½ Σ (rᵀR⁻¹r + log det R), less its
        constant ½ n log 2π; ``std_error`` the Cramér-Rao bound.

    Raises
    ------
    ValueError, ModelError
        No records, a missing channel, a record too short, an R that is no covariance.
    ConvergenceError
        IPOPT stopped early; ``best`` is the `Fit` so far.
    """
    begin = time.perf_counter()
    options = options or SolverOptions()
    options = replace(options, ipopt=IPOPT | dict(options.ipopt))
    free = free_parameters(model, fixed, bounds)
    chosen = select_records(model, records)
    length = choose_interval(free, chosen) if interval is None else float(interval)
    evaluator = Evaluator(free, lay_out(chosen, length))
    search = _Search(evaluator, free, biases, options)
    outcome = search.run(_checked_covariance(R, evaluator.ny))
    return _result(search, outcome, length, time.perf_counter() - begin)


def select_records(model: Model, records: Sequence[Record]) -> list[Record]:
    """Records with the model's channels, in the model's order.

    Raises
    ------
    ValueError
        No records, a channel missing, a record with fewer than two samples.
    """
    if isinstance(records, Record):
        records = [records]
    if not records:
        raise ValueError("no records: output error needs at least one")
    return [record.select(model.inputs, model.outputs) for record in records]


def choose_interval(free: Free, records: Sequence[Record]) -> float:
    """Length of the shooting intervals [s].

    As long as the starting model's fastest growing mode grows no more than e-fold over it, within
    0.5 s and 5 s: fewer nodes are quicker, shorter intervals forgive a worse start.
    """
    growth = float(free.model.with_vector(free.full(free.guess)).system().poles()[0].real)
    length = LONGEST if growth <= 0 else GROWTH / growth
    shortest = max(SHORTEST, 4 * max(record.dt for record in records))
    return float(np.clip(length, shortest, max(LONGEST, shortest)))


def simulate(
    model: Model, record: Record, x0: Array | None = None, bias: Array | None = None
) -> Array:
    """Outputs (N, ny) of a model over a record, by the intersample model of the estimator.

    Delayed inputs are read off an interpolating spline (`casid.spline`) and then held as the
    record says; `StateSpace.simulate` delays the held input itself instead.

    Parameters
    ----------
    model : Model
        Structure at its parameter values.
    record : Record
        With the model's inputs; its outputs are not used.
    x0, bias : (nx,), (ny,) array
        Initial state and output biases; zero unless given.
    """
    nx, ny = len(model.states), len(model.outputs)
    bare = replace(
        record.select(model.inputs, ()), y=np.zeros((record.N, ny)), outputs=model.outputs
    )
    free = free_parameters(model)
    evaluator = Evaluator(free, lay_out([bare], 2 * record.duration))
    point = Point(
        lam=model.vector()[free.index],
        bias=np.zeros((1, ny)) if bias is None else np.reshape(bias, (1, ny)).astype(float),
        nodes=np.zeros((1, nx)) if x0 is None else np.reshape(x0, (1, nx)).astype(float),
    )
    return evaluator.simulate(point)[0]


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Where the rounds of solves ended."""

    programme: Programme
    solution: Solution
    iterations: int
    rounds: int
    settled: bool


class _Search:
    """Solve with R held at the start's, then for the likelihood with R concentrated out."""

    def __init__(
        self, evaluator: Evaluator, free: Free, biases: bool, options: SolverOptions
    ) -> None:
        self.evaluator, self.free, self.biases, self.options = evaluator, free, biases, options
        layout = evaluator.layout
        seen = layout.patterns[layout.pattern].sum(axis=0)
        if not seen.all():
            name = free.model.outputs[int(np.argmin(seen))]
            raise ValueError(f"output {name!r} is missing in every sample of every record")
        spread = np.sqrt(np.sum(layout.y**2, axis=0) / seen)
        self.spread = np.where(spread > 0, spread, 1.0)

    def noise(self, given: Array | None, kind: CovarianceKind) -> Noise:
        """Noise model of these records, R held at ``given`` unless that is None."""
        layout = self.evaluator.layout
        counts = np.bincount(layout.pattern, minlength=len(layout.patterns))
        return Noise(layout.patterns, counts, FLOOR * self.spread, kind, given)

    def run(self, R: Array | CovarianceKind | None) -> _Outcome:
        """Estimate; R is held if it is an array."""
        kind: CovarianceKind = R if isinstance(R, str) else "diagonal"
        if isinstance(R, np.ndarray):
            point, scales = self._start(self.noise(R, kind))
            programme = Programme(
                self.evaluator, self.free, scales, self.noise(R, kind), self.biases
            )
            programme = programme.rescaled(programme.balanced(point))
            solution = self._solve(programme, programme.pack(point), None, 1)
            return _Outcome(programme, solution, solution.iterations, 1, True)
        return self._relaxed(kind)

    def _relaxed(self, kind: CovarianceKind) -> _Outcome:
        coarse = self.noise(np.diag((0.1 * self.spread) ** 2), kind)
        point, scales = self._start(coarse)
        first = Programme(self.evaluator, self.free, scales, self.noise(None, kind), self.biases)
        held = self.noise(first.values(first.pack(point)).R, kind)
        programme = Programme(self.evaluator, self.free, scales, held, self.biases)
        programme = programme.rescaled(programme.balanced(point))
        rough = replace(self.options, tolerance=max(ROUGH, self.options.tolerance))
        solution = self._solve(programme, programme.pack(point), None, 1, rough)
        iterations, R = solution.iterations, held.given
        for rounds in range(2, ROUNDS + 1):
            if not solution.success:
                return _Outcome(programme, solution, iterations, rounds - 1, False)
            last, point = programme, programme.unpack(solution.x)
            programme = Programme(self.evaluator, self.free, last.scales, first.noise, self.biases)
            programme = programme.rescaled(programme.balanced(point))
            warm = _carried(solution, last, programme)
            solution = self._solve(programme, programme.pack(point), warm, rounds)
            iterations += solution.iterations
            R, before = programme.values(solution.x).R, programme.values(programme.pack(point)).R
            change = np.diag(R) / np.diag(before)
            if solution.success and (first.noise.exact(R) or (change > 1 / SETTLED).all()):
                return _Outcome(programme, solution, iterations, rounds, True)
        return _Outcome(programme, solution, iterations, ROUNDS, False)

    def _solve(
        self,
        programme: Programme,
        x: Array,
        warm: tuple[Array, Array] | None,
        number: int,
        options: SolverOptions | None = None,
    ) -> Solution:
        options = options or self.options
        if warm is not None:
            options = replace(options, ipopt=WARM | dict(options.ipopt))
        stage = f"output error, round {number}"
        return solve(programme.problem(x), options, stage=stage, warm=warm)

    def _start(self, noise: Noise) -> tuple[Point, Scales]:
        """Nodes that follow the data: the starting model's states, smoothed over the records.

        The model is trusted up to a share of its inputs' effect, so a poor one does not run away.
        """
        e, layout, free = self.evaluator, self.evaluator.layout, self.free
        point = Point(
            lam=free.guess,
            bias=np.zeros((len(layout.records), e.ny)),
            nodes=np.zeros((len(layout.count), e.nx)),
        )
        ones = Scales(np.ones(e.nf), np.ones(e.ny), np.ones(e.nx))
        programme = Programme(e, free, ones, noise, biases=False)
        blocks = programme.blocks(programme.pack(point))
        drift = self._drift()
        nodes = _smooth(blocks.Hnn, blocks.gn, blocks.slope_n, blocks.ends, programme.links, drift)
        if not np.isfinite(nodes).all():
            raise ConvergenceError(
                "the starting model's simulation overflows within one interval; give a shorter "
                "interval or a start nearer the data"
            )
        size = np.sqrt(np.mean(nodes**2, axis=0))
        state = np.maximum(size, np.sqrt(np.diag(drift)))
        scales = Scales(free.scale[free.index], self.spread, np.where(state > 0, state, 1.0))
        return replace(point, nodes=nodes), scales

    def _drift(self) -> Array:
        """Covariance of what a start may miss in the states over one interval, (nx, nx)."""
        layout, free = self.evaluator.layout, self.free
        numbers = self.evaluator.structure(free.guess)
        u = np.concatenate([record.u for record in layout.records])
        dt = float(np.median([record.dt for record in layout.records]))
        T = float(np.median(layout.count)) * dt
        Q = SURPRISE**2 * (numbers.B * np.mean(u**2, axis=0)) @ numbers.B.T
        nx = len(Q)
        block = np.zeros((2 * nx, 2 * nx))
        block[:nx, :nx], block[:nx, nx:], block[nx:, nx:] = -numbers.A, Q, numbers.A.T
        expm = scipy.linalg.expm(block * T)  # Van Loan: ∫ e^{As} Q e^{Aᵀs} ds
        drift = expm[nx:, nx:].T @ expm[:nx, nx:]
        scale = np.trace(drift) / nx
        floor = 1e-6 * (np.diag(drift) + (scale if scale > 0 else 1.0) * 1e-3)
        return np.asarray((drift + drift.T) / 2 + np.diag(floor))


def _smooth(
    H: Array, g: Array, slope: Array, ends: Array, links: np.ndarray, drift: Array
) -> Array:
    """Nodes minimising the residuals and, weighted by drift⁻¹, the gaps between intervals."""
    J, nx = g.shape
    P = np.linalg.inv(drift)
    diagonal, right = H.copy(), -g
    above: dict[int, Array] = {}
    for j in links:
        diagonal[j] += slope[j].T @ P @ slope[j]
        diagonal[j + 1] += P
        above[j] = -slope[j].T @ P
        right[j] -= slope[j].T @ P @ ends[j]
        right[j + 1] += P @ ends[j]
    ridge = 1e-12 * float(np.abs(diagonal).max()) * np.eye(nx)
    grid: dict[tuple[int, int], Array] = {(j, j): diagonal[j] + ridge for j in range(J)}
    grid |= {(j, j + 1): block for j, block in above.items()}
    grid |= {(j + 1, j): block.T for j, block in above.items()}
    i, k = np.divmod(np.arange(nx * nx), nx)
    row = np.concatenate([j * nx + i for j, _ in grid])
    col = np.concatenate([j * nx + k for _, j in grid])
    values = np.concatenate([block.ravel() for block in grid.values()])
    K = scipy.sparse.csc_array((values, (row, col)), (J * nx, J * nx))
    return np.asarray(scipy.sparse.linalg.splu(K).solve(right.ravel()).reshape(J, nx))


def _carried(solution: Solution, last: Programme, programme: Programme) -> tuple[Array, Array]:
    """Multipliers of one programme in the units of another."""
    (x, g), (new_x, new_g) = last.units(), programme.units()
    return solution.multipliers_x * new_x / x, solution.multipliers_g * new_g / g


def _checked_covariance(R: Array | CovarianceKind | None, ny: int) -> Array | CovarianceKind | None:
    if R is None:
        return R
    if isinstance(R, str):
        if R not in get_args(CovarianceKind):
            raise ValueError(f'R={R!r}: expected "diagonal", "full" or an (ny, ny) array')
        return R
    R = np.asarray(R, dtype=float)
    if R.shape != (ny, ny):
        raise ValueError(f"R has shape {R.shape}, expected (ny, ny) = ({ny}, {ny})")
    if not np.allclose(R, R.T) or np.linalg.eigvalsh(R).min() <= 0:
        raise ValueError("R is not symmetric positive definite: it is a covariance, squared units")
    return R


def _information(programme: Programme, x: Array) -> Array:
    """Fisher information of the scaled λ, nodes and biases eliminated."""
    upper = _matrix(programme, x)
    H = scipy.sparse.csc_array(upper + scipy.sparse.triu(upper, 1).T)
    G = _constraints(programme, x)
    nf = programme.evaluator.nf
    F, _ = eliminate(
        H[:nf, :nf].toarray(), H[nf:, nf:], H[nf:, :nf].toarray(), G[:, nf:], G[:, :nf].toarray()
    )
    return F


def _matrix(programme: Programme, x: Array) -> scipy.sparse.csc_array:
    pattern = programme._hessian_pattern
    return pattern.matrix(programme.hessian(x) * programme.n)


def _constraints(programme: Programme, x: Array) -> scipy.sparse.csc_array:
    links = len(programme.links) * programme.evaluator.nx
    return programme._jacobian_pattern.matrix(programme.jacobian(x))[:links]


def _result(search: _Search, outcome: _Outcome, interval: float, seconds: float) -> Fit:
    free, programme, solution = search.free, outcome.programme, outcome.solution
    scale, nf = programme.scales.lam, len(free.index)
    point, final = programme.unpack(solution.x), programme.values(solution.x)
    F = _information(programme, solution.x)
    covariance = np.linalg.pinv(F, hermitian=True) * np.outer(scale, scale)
    std = np.sqrt(np.diag(covariance))
    insensitivity = scale / np.sqrt(np.maximum(np.diag(F), 1e-300))
    lam = np.clip(point.lam, free.lower[free.index], free.upper[free.index])
    multipliers = -programme.n * solution.multipliers_x[:nf] / scale
    success = solution.success and outcome.settled
    status = solution.status if outcome.settled or not solution.success else (
        f"R has not settled after {outcome.rounds} rounds; give R"
    )  # fmt: skip
    firsts = np.searchsorted(programme.record, np.arange(programme.records))
    fit = Fit(
        model=free.model.with_vector(free.full(lam)),
        parameters=parameter_table(free, lam, multipliers, std, insensitivity),
        cost=programme.n * final.cost,
        status=status,
        success=success,
        iterations=outcome.iterations,
        seconds=seconds,
        method="output error",
        covariance=covariance,
        free_names=free.names,
        R=final.R,
        initial_states=point.nodes[firsts],
        biases=point.bias,
        interval=interval,
        notes={"rounds": outcome.rounds, "nodes": programme.J},
    )
    if not success:
        raise ConvergenceError(f"output error: {status}", fit)
    return fit
