"""Matrices, delays, innovation gain and noises as functions of the unknowns, with derivatives."""

from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.evaluation import MatrixFunction
from casid.free import Free
from casid.model import Model

LARGEST = 40.0  # e^40 times what matters is more than any noise
CALM = 1.0  # process noises of almost still air, in their units


@dataclass(frozen=True, eq=False)
class FilterMatrices:
    """Matrices of a model, its gain K and noises, and derivatives by the unknowns (last axis, nf).

    K, Q and R are zero for output error; ``c`` are the values of the model's own constraints.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    tau: Array
    c: Array
    K: Array
    Q: Array  # (nx,) densities of the process noises [state²/s]
    R: Array  # (ny, ny) covariance of the measurement noise
    A_lam: Array
    B_lam: Array
    C_lam: Array
    D_lam: Array
    tau_lam: Array
    c_lam: Array
    K_lam: Array
    Q_lam: Array
    R_lam: Array


@dataclass(frozen=True, eq=False)
class GainUnknowns:
    """An innovation gain K (nx, ny) that is free, or held."""

    K: Array
    free: bool

    @property
    def start(self) -> Array:
        """Values to start from, by rows."""
        return np.asarray(self.K.ravel()) if self.free else np.zeros(0)

    def calm(self, R: Array) -> "GainUnknowns":  # noqa: ARG002 - the residuals' is R anyhow
        """The same, starting from still air and measurement noise R."""
        return replace(self, K=np.zeros_like(self.K))

    def names(self, model: Model) -> tuple[str, ...]:
        """Of the unknowns."""
        return tuple(f"K[{x},{y}]" for x in model.states for y in model.outputs if self.free)

    def bounds(self) -> tuple[Array, Array]:
        """Of the unknowns: none."""
        unbounded = np.full(len(self.start), np.inf)
        return -unbounded, unbounded

    def typical(self, states: Array, outputs: Array) -> Array:
        """Magnitudes of the unknowns, for those of states (nx,) and outputs (ny,)."""
        return np.asarray(np.outer(states, 1 / outputs).ravel()[: len(self.start)])


@dataclass(frozen=True, eq=False)
class NoiseUnknowns:
    """Densities of process noises, one a state, and the covariance of the measurement noise.

        q = q_0 (e^η - 1),    r = r_min + r_0 (e^η - 1),    R = T diag(r) Tᵀ,    η >= 0

    As logarithms where a noise matters, and linear where it does not: a bound is reached with a
    slope, and nothing is singular there. T is the identity, or unit lower triangular of unknowns in
    units of (r_0i / r_0j)^½. Noises of density q_0 = 0 are left out.
    """

    q0: Array
    r0: Array
    least: Array  # (ny,) smallest variance believed
    given: Array | None  # (ny, ny) R, if it is known
    full: bool
    start: Array

    @property
    def count(self) -> tuple[int, int, int]:
        """Unknowns of the process noises, of variances and of the triangle."""
        ny = len(self.r0) if self.given is None else 0
        return len(self.q0), ny, self.full * ny * (ny - 1) // 2

    def names(self, model: Model) -> tuple[str, ...]:
        """Of the unknowns."""
        y, (_, some, more) = model.outputs, self.count
        pairs = [f"{y[i]}, {y[j]}" for i, j in zip(*np.tril_indices(len(y), -1), strict=True)]
        process = [f"process noise of {x}" for x in model.states]
        return (*process, *(f"noise of {each}" for each in [*y[:some], *pairs[:more]]))

    def bounds(self) -> tuple[Array, Array]:
        """Of the unknowns."""
        nq, nr, nt = self.count
        lower = np.concatenate([np.zeros(nq + nr), np.full(nt, -np.inf)])
        heard = np.concatenate([self.q0 > 0, np.ones(nr)])
        return lower, np.concatenate([LARGEST * heard, np.full(nt, np.inf)])

    def typical(self, states: Array, outputs: Array) -> Array:
        """Magnitudes of the unknowns: one."""
        del states, outputs  # η has no unit
        return np.ones(sum(self.count))

    def raised(self, rise: float) -> "NoiseUnknowns":
        """The same, starting from process noises so many times their units."""
        process = np.where(self.q0 > 0, np.log1p(rise), 0.0)
        return replace(self, start=np.concatenate([process, self.start[len(process) :]]))

    def calm(self, R: Array) -> "NoiseUnknowns":
        """The same, starting from almost still air and measurement noise R."""
        nq, nr, nt = self.count
        noise = np.log1p(np.maximum(np.diag(R) - self.least, 0.0) / self.r0)[:nr]
        return replace(self, start=np.concatenate([np.zeros(nq), noise, np.zeros(nt)])).raised(CALM)

    def scaled(self, factor: float) -> "NoiseUnknowns":
        """The same, starting from all noises so many times larger; R as it is if it is given."""
        if self.given is not None:
            return self
        (nq, nr, _), start = self.count, self.start.copy()
        start[: nq + nr] = np.log1p(factor * np.expm1(start[: nq + nr]))
        return replace(self, start=start)

    def densities(self, eta: Array) -> tuple[Array, Array]:
        """Q's diagonal (nx,) and its derivative (nx, n) by all unknowns (n,)."""
        nx = len(self.q0)
        slope = np.zeros((nx, len(eta)))
        slope[:, :nx] = np.diag(self.q0 * np.exp(eta[:nx]))
        return self.q0 * np.expm1(np.maximum(eta[:nx], 0.0)), slope  # IPOPT goes beyond by 1e-8

    def covariance(self, eta: Array) -> tuple[Array, Array]:
        """R and its derivative (ny, ny, n) by all unknowns (n,)."""
        (nx, nr, nt), ny = self.count, len(self.r0)
        slope = np.zeros((ny, ny, len(eta)))
        if self.given is not None:
            return self.given, slope
        at, T = eta[nx : nx + nr], np.eye(ny)
        i, j = np.tril_indices(ny, -1)
        unit = np.sqrt(self.r0[i] / self.r0[j])
        if nt:
            T[i, j] = eta[nx + nr :] * unit
        r = self.least + self.r0 * np.expm1(np.maximum(at, 0.0))
        slope[..., nx : nx + nr] = np.einsum("ik,jk,k->ijk", T, T, self.r0 * np.exp(at))
        if nt:
            half = np.zeros((ny, ny, nt))
            half[i, :, np.arange(nt)] = unit[:, None] * (T * r)[:, j].T
            slope[..., nx + nr :] = half + half.transpose(1, 0, 2)
        return (T * r) @ T.T, slope


class FilterFunction:
    """The same as functions of the unknowns: free λ, then those of the gain or of the noises."""

    def __init__(self, free: Free, more: GainUnknowns | NoiseUnknowns | None) -> None:
        self._matrices, self._more = MatrixFunction(free), more
        self._last: tuple[bytes, FilterMatrices] | None = None
        self.linear_delays, self.direct = self._matrices.linear_delays, self._matrices.direct
        self.nf: int = self._matrices.nf + (0 if more is None else len(more.start))

    def __call__(self, unknowns: Array) -> FilterMatrices:
        """Matrices and derivatives at the unknowns (nf,); the same again if they are."""
        key = unknowns.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._at(unknowns)
        return self._last[1]

    def _at(self, unknowns: Array) -> FilterMatrices:
        n, nf = self._matrices.nf, self.nf
        m, more = self._matrices(unknowns[:n]), self._more
        slopes, tau_lam, c_lam = (
            np.concatenate([np.moveaxis(part, 0, -1), np.zeros((*part.shape[1:], nf - n))], axis=-1)
            for part in (m.slopes, m.dtau, m.dc)
        )
        nx, ny = m.nx, self._matrices.ny
        K: Array = np.zeros((nx, ny))
        Q: Array = np.zeros(nx)
        R: Array = np.zeros((ny, ny))
        K_lam, Q_lam, R_lam = (np.zeros((*part.shape, nf)) for part in (K, Q, R))
        if isinstance(more, NoiseUnknowns):
            Q, Q_lam[..., n:] = more.densities(unknowns[n:])
            R, R_lam[..., n:] = more.covariance(unknowns[n:])
        elif more is not None:
            K = unknowns[n:].reshape(K.shape) if more.free else more.K
            K_lam.reshape(K.size, nf)[:, n:] = np.eye(K.size)[:, : nf - n]
        x, y = slice(0, m.nx), slice(m.nx, None)
        blocks = (slopes[x, : m.nx], slopes[x, m.nx :], slopes[y, : m.nx], slopes[y, m.nx :])
        return FilterMatrices(
            *m.blocks, m.tau, m.c, K, Q, R, *blocks, tau_lam, c_lam, K_lam, Q_lam, R_lam
        )
