"""The lifted programmes of model matching: states and errors of every frequency are variables.

At every point s_k of a `Comparison`, with X_k the states' and E_k the weighted error's response,

    (s_k I − A(λ)) X_k = B(λ) e^(−s_k τ)        E_k = W_k ∘ (C(λ) X_k + D(λ) e^(−s_k τ) − Ĝ_k)

are constraints, bilinear in (λ, X_k) but for the delays. The quadratic norm minimises the mean of
‖E_k‖²_F. The H-infinity norm minimises t subject to t I − E_kᴴ E_k = L_k L_kᴴ with L_k lower
triangular and its diagonal >= 0: √t is the largest singular value over the points, exactly
(M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
equation (10) as an epigraph). What matters only where the error is not largest leaves the norm as
it is, so the optimum need not be unique; a small share of the mean square error decides.

Everything is scaled: parameters by their typical magnitude, states by their size at the start,
inputs and outputs by the comparison's weights, errors by ``unit``.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg

from casid.arrays import Array, ComplexArray
from casid.blocks import Block, assemble
from casid.linear import StateSpace
from casid.matching.comparison import Comparison
from casid.model import Free
from casid.nlp import Problem

START = 1.05  # t at the start, in units of the largest squared error there
TIE = 1e-3  # weight of the mean square error beside the largest squared one
LYAPUNOV_LIMIT = 1e2  # largest entry of the Lyapunov factor: how near to the line a pole may come


@dataclass(frozen=True, eq=False, kw_only=True)
class Lifted:
    """One programme and how to read its vector.

    Parameters
    ----------
    problem : Problem
        For `casid.nlp.solve`.
    free : Free
        Which parameters its first variables are, each over its scale.
    norm : {"quadratic", "hinf"}
        What it minimises, in units of ``unit`` squared.
    unit : float
        Unit of the weighted error.
    state_scale : (nx,) array
        Unit of the states for scaled inputs.
    ties : slice
        Where the structure's own constraints are among the programme's.
    """

    problem: Problem
    free: Free
    norm: str
    unit: float
    state_scale: Array
    ties: slice

    def parameters(self, x: Array) -> Array:
        """Free parameters (nf,) in physical units, on or inside their bounds."""
        free = self.free
        values = x[: len(free.index)] * free.scale[free.index]
        return np.asarray(np.clip(values, free.lower[free.index], free.upper[free.index]))


def lift(
    free: Free,
    comparison: Comparison,
    norm: str,
    values: Array,
    *,
    stable: bool = False,
) -> Lifted:
    """Build the programme around a start.

    Parameters
    ----------
    free : Free
        The parameters to estimate.
    comparison : Comparison
        Points, responses, weights.
    norm : {"quadratic", "hinf"}
        What to minimise.
    values : (nf,) array
        Free parameters to start from, in physical units.
    stable : bool
        Keep A(λ) − σ I Hurwitz by a lifted Lyapunov equation.
    """
    nf = len(free.index)
    shared = nf + (norm == "hinf")
    system = free.model.with_vector(free.full(values)).system()
    X = state_responses(system, comparison)
    E = lifted_errors(system, X, comparison)
    unit = _largest(E) if norm == "hinf" else 0.0
    unit = unit or _largest(comparison.W * comparison.G) or 1.0
    state_scale = _state_scale(X)
    scale = free.scale[free.index]
    parts = [(values / scale, free.lower[free.index] / scale, free.upper[free.index] / scale)]
    if norm == "hinf":
        parts.append((np.array([START]), np.zeros(1), np.full(1, np.inf)))
    z, lower_z = _local_start(norm, X / state_scale[:, None], E / unit)
    parts.append((z.ravel(), lower_z.ravel(), np.full(z.size, np.inf)))
    blocks = [_points_block(free, comparison, norm, state_scale, unit)]
    ties = blocks[0].g.numel() * blocks[0].count
    if free.model.constraints():
        blocks.append(_constraint_block(free))
    if stable:
        start = shared + z.size
        block, *part = _lyapunov(free, system.A, comparison, state_scale, start)
        blocks.append(block)
        parts.append((part[0], part[1], part[2]))
    x0, lower, upper = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Lifted(
        problem=assemble(blocks, x0, lower, upper), free=free, norm=norm, unit=unit,
        state_scale=state_scale, ties=slice(ties, ties + len(free.model.constraints())),
    )  # fmt: skip


def state_responses(system: StateSpace, comparison: Comparison) -> ComplexArray:
    """The states' responses (s_k I − A)⁻¹ B e^(−s_k τ) to scaled inputs, (K, nx, nu)."""
    s = comparison.s[:, None, None]
    B = system.B * comparison.input_scale * np.exp(-s * system.delay)
    return np.asarray(np.linalg.solve(s * np.eye(system.nx) - system.A, B))


def lifted_errors(system: StateSpace, X: ComplexArray, comparison: Comparison) -> ComplexArray:
    """Weighted errors E_k when the states respond as X, (K, ny, nu)."""
    direct = system.D * np.exp(-comparison.s[:, None, None] * system.delay)
    y = (system.C @ X) / comparison.input_scale + direct
    return np.asarray(comparison.W * (y - comparison.G))


def _largest(E: ComplexArray) -> float:
    return float(np.linalg.norm(E, 2, axis=(1, 2)).max())


def _state_scale(X: ComplexArray) -> Array:
    size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
    floor = 1e-6 * size.max()
    return np.asarray(np.maximum(size, floor) if floor > 0 else np.ones_like(size))


def _local_start(norm: str, X: ComplexArray, E: ComplexArray) -> tuple[Array, Array]:
    """Start and lower bounds of the variables of every point, (K, local)."""

    def vec(M: Array) -> Array:  # column by column, as CasADi
        return np.asarray(M.transpose(0, 2, 1).reshape(len(M), -1))

    start = [vec(X.real), vec(X.imag), vec(E.real), vec(E.imag)]
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
    lower[:, first : first + min(E.shape[1:])] = 0.0
    return z, lower


def _points_block(
    free: Free, comparison: Comparison, norm: str, state_scale: Array, unit: float
) -> Block:
    """The constraints of one point, repeated over all of them."""
    K, ny, nu = comparison.G.shape
    nx = len(state_scale)
    lam = ca.SX.sym("lam", len(free.index))
    A, B, C, D, tau = _matrices(free, lam, comparison.input_scale, state_scale)
    sigma, omega, rate = ca.SX.sym("sigma"), ca.SX.sym("omega"), ca.SX.sym("rate")
    X, E, G = (_complex(name, *shape) for name, shape in _shapes(nx, ny, nu))
    W = ca.SX.sym("W", ny, nu)
    decay = ca.exp(-sigma * tau)
    delay = (ca.diag(decay * ca.cos(omega * tau)), -ca.diag(decay * ca.sin(omega * tau)))
    state = (
        (sigma * X[0] - omega * X[1] - A @ X[0] - B @ delay[0]) / rate,
        (omega * X[0] + sigma * X[1] - A @ X[1] - B @ delay[1]) / rate,
    )
    error = tuple(E[i] - W * (C @ X[i] + D @ delay[i] - G[i]) for i in range(2))
    w, g = [lam], [*map(ca.vec, state), *map(ca.vec, error)]
    local = [*map(ca.vec, X), *map(ca.vec, E)]
    f = (ca.sumsqr(E[0]) + ca.sumsqr(E[1])) / K
    if norm == "hinf":
        t = ca.SX.sym("t")
        factor, gram = _epigraph(t, E, wide=ny < nu)
        w, local, g = [lam, t], [*local, *factor], [*g, *gram]
        f = t / K + TIE * f
    data = np.column_stack([
        comparison.s.real, comparison.s.imag, np.maximum(np.abs(comparison.s), 1e-12),
        *_data(comparison, unit),
    ]).T  # fmt: skip
    shared, count = sum(part.numel() for part in w), sum(part.numel() for part in local)
    index = np.empty((shared + count, K), dtype=int)
    index[:shared] = np.arange(shared)[:, None]
    index[shared:] = shared + np.arange(K * count).reshape(K, count).T
    constraints = ca.vertcat(*g)
    zero = np.zeros(constraints.numel())
    d = ca.vertcat(sigma, omega, rate, ca.vec(G[0]), ca.vec(G[1]), ca.vec(W))
    return Block(
        w=ca.vertcat(*w, *local), d=d, f=f, g=constraints, index=index, data=data,
        lower=zero, upper=zero,
    )  # fmt: skip


def _shapes(nx: int, ny: int, nu: int) -> tuple[tuple[str, tuple[int, int]], ...]:
    return ("X", (nx, nu)), ("E", (ny, nu)), ("G", (ny, nu))


def _complex(name: str, rows: int, columns: int) -> tuple[ca.SX, ca.SX]:
    return ca.SX.sym(f"{name}_re", rows, columns), ca.SX.sym(f"{name}_im", rows, columns)


def _data(comparison: Comparison, unit: float) -> list[Array]:
    """Responses to scaled inputs and weights that turn them into errors in ``unit``, (K, ny nu)."""
    G = (comparison.G * comparison.input_scale).transpose(0, 2, 1)
    W = (comparison.W / comparison.input_scale / unit).transpose(0, 2, 1)
    return [part.reshape(len(part), -1) for part in (G.real, G.imag, W)]


def _matrices(free: Free, lam: ca.SX, input_scale: Array, state_scale: Array) -> tuple[ca.SX, ...]:
    """A, B, C, D and τ of scaled states and inputs, symbols of the scaled free parameters."""
    A, B, C, D, tau, _ = free.model.matrices()(free.full(lam * free.scale[free.index]))
    S, U = ca.diag(ca.DM(state_scale)), ca.diag(ca.DM(input_scale))
    inverse = ca.diag(ca.DM(1 / state_scale))
    return inverse @ A @ S, inverse @ B @ U, C @ S, D @ U, tau


def _epigraph(t: ca.SX, E: tuple[ca.SX, ca.SX], *, wide: bool) -> tuple[list[ca.SX], list[ca.SX]]:
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


def _constraint_block(free: Free) -> Block:
    """Ties and inequalities that the structure declares."""
    lam = ca.SX.sym("lam", len(free.index))
    c = free.model.matrices()(free.full(lam * free.scale[free.index]))[5]
    items = free.model.constraints()
    return Block(
        w=lam, d=ca.SX(0, 1), f=ca.SX(0), g=ca.densify(c),
        index=np.arange(len(free.index))[:, None], data=np.zeros((0, 1)),
        lower=np.array([item.lower for item in items], dtype=float),
        upper=np.array([item.upper for item in items], dtype=float),
    )  # fmt: skip


def _lyapunov(
    free: Free, A0: Array, comparison: Comparison, state_scale: Array, start: int
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
    block = Block(
        w=ca.vertcat(lam, m), d=ca.SX(0, 1), f=ca.SX(0), g=constraints, index=index,
        data=np.zeros((0, 1)), lower=zero, upper=zero,
    )  # fmt: skip
    scaled = A0 * state_scale / state_scale[:, None]
    rightmost = np.linalg.eigvals(scaled).real.max()
    line = max(comparison.shift, rightmost + 0.1 * rate)
    F0 = (scaled - line * np.eye(nx)) / rate
    M0 = np.linalg.cholesky(scipy.linalg.solve_continuous_lyapunov(F0, -np.eye(nx)))
    column, row = np.triu_indices(nx)  # CasADi's order of a lower triangle, column by column
    diagonal = np.where(row == column, 0.0, -LYAPUNOV_LIMIT)
    return block, M0[row, column], diagonal, np.full(m.numel(), LYAPUNOV_LIMIT)
