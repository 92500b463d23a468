"""The lifted programmes of model matching: states and errors of every frequency are variables.

At every point s_k of a `Comparison`, with X_k the states' and E_k the weighted error's response,

    (s_k I − A(λ)) X_k = B(λ) e^(−s_k τ)        E_k = W_k ∘ (C(λ) X_k + D(λ) e^(−s_k τ) − Ĝ_k)

are constraints, bilinear in (λ, X_k) but for the delays. The quadratic norm minimises the mean of
‖E_k‖²_F. The H-infinity norm minimises t subject to t I − E_kᴴ E_k = L_k L_kᴴ with L_k lower
triangular and its diagonal >= 0: √t is the largest singular value over the points, exactly
(M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
equation (10) as an epigraph). What matters only where the error is not largest leaves the norm as
it is, so the optimum need not be unique; a small share of the mean square error decides.

The third norm is that of decibels and degrees: the mean of |W_k Ĝ_k|² [ln² |z_k| + ρ arg² z_k]
over the ratio z_k of the model's response to Ĝ_k, ρ T&R's weight of a radian beside a neper
(`casid.matching.mismatch`); no variables E_k.

Everything is scaled: parameters by their typical magnitude, states by their size at the start,
inputs and outputs by the comparison's weights, errors by ``unit``.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca
import numpy as np
import scipy.linalg

from casid.arrays import Array, ComplexArray
from casid.blocks import Block, assemble
from casid.evaluation import Matrices, MatrixFunction
from casid.matching.comparison import Comparison
from casid.matching.delays import delay_parameters
from casid.matching.mismatch import DB, TINY, TURN
from casid.model import Free
from casid.nlp import Problem, SolverOptions, solve

START = 1.05  # t at the start, in units of the largest squared error there
TIE = 1e-3  # weight of the mean square error beside the largest squared one
LYAPUNOV_LIMIT = 1e2  # largest entry of the Lyapunov factor: how near to the line a pole may come


# A quadratic programme starts next to its solution, which its barrier must not blur.
CLOSE: dict[str, float | str] = {"mu_init": 1e-7, "bound_push": 1e-8, "bound_frac": 1e-8}
CLOSE |= {"tol": 1e-11, "acceptable_tol": 1e-8, "acceptable_iter": 3}
FAR: dict[str, float | str] = {"mu_init": 1e-2, "bound_mult_init_method": "mu-based"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Optimum:
    """Where a programme ended, by IPOPT's word and with its effort."""

    values: Array  # (nf,) free parameters in physical units, on or inside their bounds
    multipliers: Array  # (nf,) derivatives of the cost by the bounds' positions
    prices: Array  # (nc,) the same by the constraints' positions
    cost: float  # what was minimised: the mean square, or t and a share of it
    success: bool
    status: str
    iterations: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Lifted:
    """One programme and how to read its vector."""

    problem: Problem  # for `casid.nlp.solve`
    free: Free  # which parameters its first variables are, each over its scale
    norm: str  # what it minimises in units of ``unit`` squared: quadratic, hinf, decibel
    unit: float  # of the weighted error
    ties: slice  # where the structure's own constraints are among the programme's

    def parameters(self, x: Array) -> Array:
        """Free parameters (nf,) in physical units, on or inside their bounds."""
        free = self.free
        values = x[: len(free.index)] * free.scale[free.index]
        return np.asarray(np.clip(values, free.lower[free.index], free.upper[free.index]))

    def solve(self, options: SolverOptions, stage: str) -> Optimum:
        """Solve it with IPOPT."""
        near = FAR if self.norm == "hinf" else CLOSE
        found = solve(self.problem, replace(options, ipopt=near | dict(options.ipopt)), stage=stage)
        scale, unit = self.free.scale[self.free.index], self.unit**2
        return Optimum(
            values=self.parameters(found.x), cost=found.f * unit, success=found.success,
            multipliers=-found.multipliers_x[: len(scale)] / scale * unit,
            prices=-found.multipliers_g[self.ties] * unit,
            status=found.status, iterations=found.iterations,
        )  # fmt: skip


def lift(
    free: Free, comparison: Comparison, norm: str, values: Array, *, stable: bool = False
) -> Lifted:
    """Build the programme around a start.

    Parameters
    ----------
    free : Free
        The parameters to estimate.
    comparison : Comparison
        Points, responses, weights.
    norm : {"quadratic", "hinf", "decibel"}
        What to minimise.
    values : (nf,) array
        Free parameters to start from, in physical units.
    stable : bool
        Keep A(λ) − σ I Hurwitz by a lifted Lyapunov equation.
    """
    nf = len(free.index)
    at, scale = MatrixFunction(free)(values), free.scale[free.index]
    X = state_responses(at, comparison)
    E = _errors(at, X, comparison)
    unit = _largest(E) if norm == "hinf" else 0.0
    unit = unit or _largest(comparison.W * comparison.G) or 1.0
    size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
    floor = 1e-6 * size.max()
    state_scale = np.maximum(size, floor) if floor > 0 else np.ones_like(size)
    parts = [(values / scale, free.lower[free.index] / scale, free.upper[free.index] / scale)]
    if norm == "hinf":
        parts.append((np.array([START]), np.zeros(1), np.full(1, np.inf)))
    z, lower_z = _local_start(norm, X / state_scale[:, None], E / unit)
    parts.append((z.ravel(), lower_z.ravel(), np.full(z.size, np.inf)))
    blocks = [_points_block(free, comparison, norm, state_scale, unit)]
    ties = blocks[0].g.numel() * blocks[0].count
    composed = delay_parameters(free)[1]
    if free.model.constraints() or composed:
        blocks.append(_constraint_block(free, composed))
    if stable:
        start = nf + (norm == "hinf") + z.size
        block, *part = _lyapunov(free, at, comparison, state_scale, start)
        blocks.append(block)
        parts.append((part[0], part[1], part[2]))
    x0, lower, upper = (np.concatenate(column) for column in zip(*parts, strict=True))
    if free.priors:
        blocks.append(_surprise_block(free, comparison.price_of_surprise(norm) / unit))
    own = slice(ties, ties + len(free.model.constraints()))
    problem = assemble(blocks, x0, lower, upper)
    return Lifted(problem=problem, free=free, norm=norm, unit=unit, ties=own)


def state_responses(at: Matrices, comparison: Comparison) -> ComplexArray:
    """The states' responses (s_k I − A)⁻¹ B e^(−s_k τ) to scaled inputs, (K, nx, nu)."""
    A, B, _, _ = at.blocks
    s = comparison.s[:, None, None]
    B = B * comparison.input_scale * np.exp(-s * at.tau)
    return np.asarray(np.linalg.solve(s * np.eye(at.nx) - A, B))


def _errors(at: Matrices, X: ComplexArray, comparison: Comparison) -> ComplexArray:
    """Weighted errors E_k when the states respond as X, (K, ny, nu)."""
    _, _, C, D = at.blocks
    direct = D * np.exp(-comparison.s[:, None, None] * at.tau)
    return np.asarray(comparison.W * ((C @ X) / comparison.input_scale + direct - comparison.G))


def _largest(E: ComplexArray) -> float:
    return float(np.linalg.norm(E, 2, axis=(1, 2)).max())


def _local_start(norm: str, X: ComplexArray, E: ComplexArray) -> tuple[Array, Array]:
    """Start and lower bounds of the variables of every point, (K, local)."""

    def vec(M: Array) -> Array:  # column by column, as CasADi
        return np.asarray(M.transpose(0, 2, 1).reshape(len(M), -1))

    start = [vec(X.real), vec(X.imag)]
    if norm != "decibel":
        start += [vec(E.real), vec(E.imag)]
    if norm == "hinf":
        wide = E.shape[1] < E.shape[2]
        EH = E.conj().transpose(0, 2, 1)
        gram = E @ EH if wide else EH @ E
        r = gram.shape[1]
        L = np.linalg.cholesky(START * np.eye(r) - gram)
        i, j = np.tril_indices(r, -1)
        start += [L.real[:, range(r), range(r)], L.real[:, i, j], L.imag[:, i, j]]
    z = np.concatenate(start, axis=1)
    lower = np.full_like(z, -np.inf)
    first = 2 * (X[0].size + E[0].size)
    lower[:, first : first + min(E.shape[1:])] = 0.0  # the diagonal of L
    return z, lower


Pair: TypeAlias = tuple[ca.SX, ca.SX]  # real and imaginary part
# A variable that all points share, if any, variables and constraints of each point, and its cost.
Cost: TypeAlias = tuple[ca.SX, list[ca.SX], list[ca.SX], ca.SX]


def _points_block(free: Free, comparison: Comparison, norm: str, size: Array, unit: float) -> Block:
    """Constraints and cost of one point, repeated over all of them."""
    K, ny, nu = comparison.G.shape
    lam = ca.SX.sym("lam", len(free.index))
    A, B, C, D, tau = _matrices(free, lam, comparison.input_scale, size)
    sigma, omega, rate = ca.SX.sym("sigma"), ca.SX.sym("omega"), ca.SX.sym("rate")
    X, G = _complex("X", len(size), nu), _complex("G", ny, nu)
    W = ca.SX.sym("W", ny, nu)
    decay = ca.exp(-sigma * tau)
    delay = (ca.diag(decay * ca.cos(omega * tau)), -ca.diag(decay * ca.sin(omega * tau)))
    state = (
        (sigma * X[0] - omega * X[1] - A @ X[0] - B @ delay[0]) / rate,
        (omega * X[0] + sigma * X[1] - A @ X[1] - B @ delay[1]) / rate,
    )
    y = C @ X[0] + D @ delay[0], C @ X[1] + D @ delay[1]
    t, errors, ties, f = _decibels(y, G, W) if norm == "decibel" else _weighted(y, G, W, norm)
    w, local = ca.vertcat(lam, t), ca.vertcat(*map(ca.vec, [*X, *errors]))
    shared, count = w.numel(), local.numel()
    index = np.empty((shared + count, K), dtype=int)
    index[:shared] = np.arange(shared)[:, None]
    index[shared:] = shared + np.arange(K * count).reshape(K, count).T
    g = ca.vertcat(*map(ca.vec, [*state, *ties]))
    zero = np.zeros(g.numel())
    d = ca.vertcat(sigma, omega, rate, *map(ca.vec, (*G, W)))
    data = _data(comparison, unit)
    w = ca.vertcat(w, local)
    return Block(w=w, d=d, f=f / K, g=g, index=index, data=data, lower=zero, upper=zero)


def _complex(name: str, rows: int, columns: int) -> Pair:
    return ca.SX.sym(f"{name}_re", rows, columns), ca.SX.sym(f"{name}_im", rows, columns)


def _weighted(y: Pair, G: Pair, W: ca.SX, norm: str) -> Cost:
    """Cost of the weighted error E, its norm the H-infinity one or the quadratic."""
    ny, nu = W.shape
    E = _complex("E", ny, nu)
    g = [E[i] - W * (y[i] - G[i]) for i in range(2)]
    f = ca.sumsqr(E[0]) + ca.sumsqr(E[1])
    if norm != "hinf":
        return ca.SX(0, 1), [*E], g, f
    t = ca.SX.sym("t")
    factor, gram = _epigraph(t, E, wide=ny < nu)
    return t, [*E, *factor], [*g, *gram], t + TIE * f


def _decibels(y: Pair, G: Pair, W: ca.SX) -> Cost:
    """Cost of nepers and radians of y/G, weighted by W G; 1 in place of a masked ratio."""
    size = G[0] ** 2 + G[1] ** 2
    z = (y[0] * G[0] + y[1] * G[1]) / size + (W == 0), (y[1] * G[0] - y[0] * G[1]) / size
    gain, phase = ca.log(z[0] ** 2 + z[1] ** 2 + TINY) / 2, ca.atan2(z[1], z[0])
    f: ca.SX = ca.dot(W**2 * size, gain**2 + (TURN / DB) ** 2 * phase**2)
    return ca.SX(0, 1), [], [], f


def _data(comparison: Comparison, unit: float) -> Array:
    """Data of every point: s, its modulus, responses to scaled inputs, weights in ``unit``."""
    G = np.where(comparison.W > 0, comparison.G * comparison.input_scale, 1.0)
    parts = G.real, G.imag, comparison.W / comparison.input_scale / unit
    columns = [part.transpose(0, 2, 1).reshape(len(part), -1) for part in parts]
    s = comparison.s
    return np.column_stack([s.real, s.imag, np.maximum(np.abs(s), 1e-12), *columns]).T


def _matrices(free: Free, lam: ca.SX, input_scale: Array, state_scale: Array) -> tuple[ca.SX, ...]:
    """A, B, C, D and τ of scaled states and inputs, symbols of the scaled free parameters."""
    A, B, C, D, tau, _ = free.model.matrices()(free.full(lam * free.scale[free.index]))
    S, U = ca.diag(ca.DM(state_scale)), ca.diag(ca.DM(input_scale))
    inverse = ca.diag(ca.DM(1 / state_scale))
    return inverse @ A @ S, inverse @ B @ U, C @ S, D @ U, tau


def _epigraph(t: ca.SX, E: Pair, *, wide: bool) -> tuple[list[ca.SX], list[ca.SX]]:
    """The variables of L and the constraints t I − Eᴴ E = L Lᴴ, the smaller Gram matrix taken."""
    R, J = E
    if wide:
        real, imaginary = R @ R.T + J @ J.T, J @ R.T - R @ J.T
    else:
        real, imaginary = R.T @ R + J.T @ J, R.T @ J - J.T @ R
    r = real.shape[0]
    rows, columns = np.tril_indices(r, -1)
    diagonal = ca.SX.sym("L", r)
    below = ca.SX.sym("L_re", len(rows)), ca.SX.sym("L_im", len(rows))
    Lr, Li = ca.diag(diagonal), ca.SX(r, r)
    for k, (i, j) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        Lr[i, j], Li[i, j] = below[0][k], below[1][k]
    real += Lr @ Lr.T + Li @ Li.T
    imaginary += Li @ Lr.T - Lr @ Li.T
    constraints = [t - real[i, i] for i in range(r)]
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        constraints += [real[i, j], imaginary[i, j]]
    return [diagonal, *below], constraints


def _constraint_block(free: Free, composed: list[int]) -> Block:
    """Ties and inequalities that the structure declares, and composed delays at >= 0."""
    lam, nf = ca.SX.sym("lam", len(free.index)), len(free.index)
    *_, tau, c = free.model.matrices()(free.full(lam * free.scale[free.index]))
    limits = [(item.lower, item.upper) for item in free.model.constraints()]
    lower, upper = np.array([*limits, *[(0.0, np.inf)] * len(composed)], dtype=float).T
    g, index = ca.vertcat(ca.densify(c), *[tau[j] for j in composed]), np.arange(nf)[:, None]
    return _shared_block(lam, g, index, lower, upper)


def _surprise_block(free: Free, price: float) -> Block:
    """The cost of distances from prior values."""
    nf = len(free.index)
    lam, scale = ca.SX.sym("lam", nf), free.scale[free.index]
    off, slopes = free.surprise(np.zeros(nf))
    f = price**2 * ca.sumsqr(ca.DM(slopes * scale) @ lam + ca.DM(off))
    block = _shared_block(lam, ca.SX(0, 1), np.arange(nf)[:, None], np.zeros(0), np.zeros(0))
    return replace(block, f=f)


def _shared_block(w: ca.SX, g: ca.SX, index: np.ndarray, lower: Array, upper: Array) -> Block:
    """Constraints on variables that all points share."""
    d, data = ca.SX(0, 1), np.zeros((0, 1))
    return Block(w=w, d=d, f=ca.SX(0), g=g, index=index, data=data, lower=lower, upper=upper)


def _lyapunov(
    free: Free, at: Matrices, comparison: Comparison, state_scale: Array, start: int
) -> tuple[Block, Array, Array, Array]:
    """A(λ) − σ I is Hurwitz exactly when F P + P Fᵀ = −I, P = M Mᵀ has a solution.

    Returns the block and start, lower and upper bounds of the entries of M.
    """
    nx, nf = len(state_scale), len(free.index)
    low, high = comparison.band
    rate = float(np.sqrt(low * high)) or high or 1.0
    lam, m = ca.SX.sym("lam", nf), ca.SX.sym("m", nx * (nx + 1) // 2)
    A = _matrices(free, lam, comparison.input_scale, state_scale)[0]
    M = ca.SX(ca.Sparsity.lower(nx), m)
    P = M @ M.T
    F = (A - comparison.shift * ca.SX.eye(nx)) / rate
    residual = F @ P + P @ F.T + ca.SX.eye(nx)
    constraints = ca.vertcat(*[residual[i, j] for i in range(nx) for j in range(i + 1)])
    zero = np.zeros(constraints.numel())
    index = np.concatenate([np.arange(nf), start + np.arange(m.numel())])[:, None]
    block = _shared_block(ca.vertcat(lam, m), constraints, index, zero, zero)
    scaled = at.blocks[0] * state_scale / state_scale[:, None]
    rightmost = np.linalg.eigvals(scaled).real.max()
    line = max(comparison.shift, rightmost + 0.1 * rate)
    F0 = (scaled - line * np.eye(nx)) / rate
    M0 = np.linalg.cholesky(scipy.linalg.solve_continuous_lyapunov(F0, -np.eye(nx)))
    column, row = np.triu_indices(nx)  # CasADi's order of a lower triangle, column by column
    diagonal = np.where(row == column, 0.0, -LYAPUNOV_LIMIT)
    return block, M0[row, column], diagonal, np.full(m.numel(), LYAPUNOV_LIMIT)
