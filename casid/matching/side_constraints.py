"""Constraints of a match beside the responses: the structure's own, its delays', its poles'.

A(λ) − σ I is Hurwitz exactly when F P + P Fᵀ = −I, P = M Mᵀ with M lower triangular, has a
solution; the entries of M are variables then. States that nothing couples to the others have an
equation and an M of their own.
"""

import warnings

import casadi as ca
import numpy as np
import scipy

from casid.arrays import Array
from casid.evaluation import Matrices
from casid.free import Free, delay_parameters
from casid.matching.comparison import Comparison

LIMIT = 1e2  # largest entry of the Lyapunov factor: how near to the line a pole may come


class SideConstraints:
    """Constraints on w = (λ over its scale, entries of M) and their dense derivatives.

    The structure's own come first, then delays composed of several parameters, which must not be
    negative, then the Lyapunov equation if ``at``, the matrices to start from, is given.
    """

    def __init__(self, free: Free, comparison: Comparison, at: Matrices | None) -> None:
        nf = len(free.index)
        lam = ca.SX.sym("lam", nf)
        A, *_, tau, c = free.model.matrices()(free.full(lam * free.scale[free.index]))
        composed = delay_parameters(free)[1]
        limits = list(map(tuple, free.constraint_limits.T))
        limits += [(0.0, np.inf)] * len(composed)
        parts, m = [ca.densify(c) / free.constraint_sizes, *[tau[j] for j in composed]], ca.SX(0, 1)
        none: Array = np.zeros(0)
        self.start = none, none, none
        if at is not None:
            size, rate = _state_sizes(at, comparison), _rate(comparison)
            scaled = ca.diag(ca.DM(1 / size)) @ A @ ca.diag(ca.DM(size))
            number = at.blocks[0] * size / size[:, None]
            line = max(comparison.shift, np.linalg.eigvals(number).real.max() + 0.1 * rate)
            starts = []
            for own in _coupled(A):
                F = (scaled[own, own] - comparison.shift * ca.SX.eye(len(own))) / rate
                M = ca.SX.sym("m", len(own) * (len(own) + 1) // 2)
                m, more = ca.vertcat(m, M), _lyapunov(F, M)
                parts.append(more)
                limits += [(0.0, 0.0)] * more.numel()
                starts.append(_factor((number[np.ix_(own, own)] - line * np.eye(len(own))) / rate))
            start, lower, upper = (np.concatenate(each) for each in zip(*starts, strict=True))
            self.start = start, lower, upper
        w, g = ca.vertcat(lam, m), ca.vertcat(*parts)
        mu = ca.SX.sym("mu", g.numel())
        H = ca.hessian(ca.dot(mu, g), w)[0]
        self._first = ca.Function("side", [w], [g, ca.densify(ca.jacobian(g, w))])
        self._second = ca.Function("side_hessian", [w, mu], [ca.densify(H)])
        self.limits = np.array(limits, dtype=float).reshape(-1, 2).T

    @property
    def count(self) -> int:
        """Number of constraints."""
        return int(self.limits.shape[1])

    def values(self, w: Array) -> Array:
        """Values of the constraints (m,)."""
        return np.asarray(self._first(w)[0].full().ravel())

    def slopes(self, w: Array) -> Array:
        """Their derivatives (m, nw)."""
        return np.asarray(self._first(w)[1].full())

    def curvature(self, w: Array, mu: Array) -> Array:
        """Second derivative (nw, nw) of their sum weighted by mu."""
        return np.asarray(self._second(w, mu).full())


def _state_sizes(at: Matrices, comparison: Comparison) -> Array:
    """Typical size of every state's response to inputs of typical size, (nx,)."""
    X = at.state_response(comparison.s) * comparison.input_scale
    size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
    floor = 1e-6 * size.max()
    return np.maximum(size, floor) if floor > 0 else np.ones_like(size)


def _rate(comparison: Comparison) -> float:
    """Middle of the band [rad/s], the unit of F."""
    low, high = comparison.band
    return float(np.sqrt(low * high)) or high or 1.0


def _lyapunov(F: ca.SX, m: ca.SX) -> ca.SX:
    """Lower triangle of F P + P Fᵀ + I."""
    nx = F.shape[0]
    M = ca.SX(ca.Sparsity.lower(nx), m)
    P = M @ M.T
    residual = F @ P + P @ F.T + ca.SX.eye(nx)
    return ca.vertcat(*[residual[i, j] for i in range(nx) for j in range(i + 1)])


def _coupled(A: ca.SX) -> list[list[int]]:
    """States by groups that couple with each other."""
    row, column = A.sparsity().get_triplet()
    graph = scipy.sparse.csr_array((np.ones(len(row)), (row, column)), A.shape)
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return [np.flatnonzero(label == k).tolist() for k in range(count)]


def _factor(F: Array) -> tuple[Array, Array, Array]:
    """Start, lower and upper bounds of the entries of M, column by column."""
    nx = len(F)
    with warnings.catch_warnings():  # a start need not be exact, where values ran far away
        warnings.simplefilter("ignore", RuntimeWarning)
        P = scipy.linalg.solve_continuous_lyapunov(F, -np.eye(nx))
    try:
        M = np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        M = np.eye(nx)
    column, row = np.triu_indices(nx)
    lower = np.where(row == column, 0.0, -LIMIT)
    return M[row, column], lower, np.full(len(lower), LIMIT)
