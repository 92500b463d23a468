"""Predictor-based subspace identification of data that are already regressors.

The columns of a data set are stacked instants z(0), z(1), ..., z(p) of z = (u, y): Laguerre
projections of one start instant, or successive samples. All that PBSIDopt needs of them is the
triangular factor of their QR decomposition, accumulated block by block, so memory does not grow
with the record. Source: A. Chiuso, "The role of vector autoregressive modeling in predictor-based
subspace identification", Automatica 43 (2007); M. Bergamasco, M. Lovera, IET CTA 5 (2011).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray


@dataclass(frozen=True, eq=False)
class Stack:
    """Triangular factor of all columns of a campaign."""

    R: Array  # upper triangular; RᵀR is the Gram matrix of the columns (z(0), ..., z(p))
    nu: int
    ny: int
    past: int
    columns: int  # how many went in

    @property
    def nz(self) -> int:
        """Number of channels."""
        return self.nu + self.ny

    @property
    def Z(self) -> Array:
        """z(0) ... z(p - 1)."""
        return self.R[:, : self.past * self.nz]

    @property
    def Z_next(self) -> Array:
        """z(1) ... z(p)."""
        return self.R[:, self.nz :]

    @property
    def u(self) -> Array:
        """Present input u(p)."""
        return self.R[:, self.past * self.nz : self.past * self.nz + self.nu]

    @property
    def y(self) -> Array:
        """Present output y(p)."""
        return self.R[:, self.past * self.nz + self.nu :]


def accumulate(blocks: Iterable[Array], *, constant: bool) -> tuple[Array, int]:
    """Triangular factor of blocks of columns (as rows); a constant is projected out or not."""
    R: Array | None = None
    count = 0
    for block in blocks:
        count += len(block)
        rows = np.hstack([np.ones((len(block), 1)), block]) if constant else block
        R = triangular(rows if R is None else np.vstack([R, rows]))
    if R is None:
        return np.zeros((0, 0)), 0
    return (R[1:, 1:] if constant else R), count


def triangular(rows: Array) -> Array:
    """R of the QR decomposition, (n, n) for at least n rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def ridge(X: Array, Y: Array, regularisation: float) -> Array:
    """Θ that minimises ‖Y - X Θ‖² + (regularisation ‖X‖₂)² ‖Θ‖²."""
    U, s, Vt = np.linalg.svd(X, full_matrices=False)
    floor = max(regularisation, 1e-13)
    gain = s / (s**2 + (floor * s[0]) ** 2)
    return np.asarray(Vt.T @ (gain[:, None] * (U.T @ Y)))


@dataclass(frozen=True, eq=False)
class Realisation:
    """A discrete innovation model, x⁺ = A x + B u + K e, y = C x + D u + e, of scaled channels."""

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    singular_values: Array
    residual_covariance: Array


def predictor_coefficients(
    stack: Stack, feedthrough: BoolArray, regularisation: float, *, at_one: bool
) -> tuple[Array, Array]:
    """VARX coefficients Ξ (ny, p nz) and direct term D (ny, nu) of y(p) = Ξ z + D u(p) + e(p).

    The regularisation is relative to the largest singular value. Where ``feedthrough`` (ny, nu) is
    False the direct term is dropped, the condition on samples; with ``at_one`` the plant's response
    at z = 1 (s = ∞) is zero there, that on projections. With M = I - Σ Ξ^y it reads
    M⁻¹(D + Σ Ξ^u) = 0, linear row by row in M⁻¹ y for a given M, so the regression runs twice.
    """
    free = predictor_rows(stack, np.ones_like(feedthrough), stack.y, regularisation, at_one=at_one)
    if feedthrough.all():
        return free
    if not at_one:
        return predictor_rows(stack, feedthrough, stack.y, regularisation, at_one=False)
    blocks = free[0].reshape(stack.ny, stack.past, stack.nz)[:, :, stack.nu :]
    M = np.eye(stack.ny) - blocks.sum(axis=1)
    y = np.linalg.solve(M, stack.y.T).T
    Xi, D = predictor_rows(stack, feedthrough, y, regularisation, at_one=True)
    return M @ Xi, M @ D


def predictor_rows(
    stack: Stack, feedthrough: BoolArray, y: Array, regularisation: float, *, at_one: bool
) -> tuple[Array, Array]:
    """One regression per distinct row of the mask; see `predictor_coefficients`."""
    p, nz, nu = stack.past, stack.nz, stack.nu
    Xi, D = np.empty((stack.ny, p * nz)), np.zeros((stack.ny, nu))
    for mask in np.unique(feedthrough, axis=0):
        rows = np.flatnonzero((feedthrough == mask).all(axis=1))
        Z = stack.Z.copy()
        if at_one:
            for j in np.flatnonzero(~mask):
                Z[:, j::nz] -= stack.u[:, [j]]  # D_j = -Σ Ξ_j: regress on u(p - i) - u(p)
        theta = ridge(np.hstack([Z, stack.u[:, mask]]), y[:, rows], regularisation)
        Xi[rows] = theta[: p * nz].T
        D[np.ix_(rows, mask)] = theta[p * nz :].T
        if at_one:
            for j in np.flatnonzero(~mask):
                D[rows, j] = -Xi[rows][:, j::nz].sum(axis=1)
    return Xi, D


@dataclass(frozen=True, eq=False)
class Future:
    """Predictions of y(p), y(p + 1), ... from the past z, and their principal directions."""

    map: Array  # (future ny, p nz)
    U: Array  # left singular vectors of the predictions over all columns
    singular_values: Array  # how much of the predictions each explains


def predicted_future(stack: Stack, Xi: Array, future: int) -> Future:
    """Predictions ``future`` steps ahead by VARX coefficients Ξ (ny, p nz)."""
    ny, nz, p = stack.ny, stack.nz, stack.past
    GammaK = np.zeros((future * ny, p * nz))
    for j in range(min(future, p)):
        GammaK[j * ny : (j + 1) * ny, j * nz :] = Xi[:, : (p - j) * nz]
    U, s, _ = np.linalg.svd(GammaK @ stack.Z.T, full_matrices=False)
    return Future(GammaK, U, s)


def realise(stack: Stack, predicted: Future, *, order: int, feedthrough: BoolArray) -> Realisation:
    """States from the predictor, matrices by least squares (PBSIDopt); D masked on samples."""
    ny, U, s = stack.ny, predicted.U, predicted.singular_values
    # x = Σ^{1/2} Vᵀ = to_state z
    to_state = (U[:, :order] / np.sqrt(s[:order])).T @ predicted.map
    x, x_next = stack.Z @ to_state.T, stack.Z_next @ to_state.T
    C, D = np.empty((ny, order)), np.zeros((ny, stack.nu))
    for mask in np.unique(feedthrough, axis=0):
        rows = np.flatnonzero((feedthrough == mask).all(axis=1))
        theta = ridge(np.hstack([x, stack.u[:, mask]]), stack.y[:, rows], 0.0)
        C[rows] = theta[:order].T
        D[np.ix_(rows, mask)] = theta[order:].T
    e = stack.y - x @ C.T - stack.u @ D.T
    ABK = ridge(np.hstack([x, stack.u, e]), x_next, 0.0).T
    A, B, K = np.split(ABK, [order, order + stack.nu], axis=1)
    w = x_next - x @ A.T - stack.u @ B.T
    covariance = e.T @ e / max(stack.columns, 1)
    K = stable_gain(A, C, K, w, e)
    return Realisation(A, B, C, D, K, s, covariance)


def stable_gain(A: Array, C: Array, K: Array, w: Array, e: Array) -> Array:
    """K itself if A - KC is stable, else the stationary Kalman gain of the residuals w and e."""
    if np.abs(np.linalg.eigvals(A - K @ C)).max() < 1:
        return K
    Q, S, R = w.T @ w, w.T @ e, e.T @ e
    try:
        P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R, s=S)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(
            f"no stable predictor of order {len(A)} exists for these data ({error}); "
            "lower the order or add regularisation"
        ) from error
    return np.linalg.solve(C @ P @ C.T + R, C @ P @ A.T + S.T).T
