"""Residuals of a linear model on the lines of whole records, and what Gauss-Newton needs of them.

Over one period of a record's transform, with A_d = e^{Ah} and the forcing f_n of the delayed inputs
over the step after sample n (`casid.intersample`), x_{n+1} = A_d x_n + f_n becomes

    X = (z I − A_d)⁻¹ (F + z (x_0 − x_N)/√N),        E = Y − C X − D U,

exactly, whether the model is stable or not and wherever the record begins and ends. The forcing is
linear in the signals of `casid.shooting.lines`: [X; F's signals] times one matrix whose derivatives
by λ come from `casid.intersample.integral_slopes`. What begins and ends, x_0 − x_N of every record,
enters linearly and is eliminated (variable projection: Golub and Pereyra 1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free
from casid.intersample import ORDER, DelayedInput, delayed_input, integral_slopes
from casid.shooting.delayed import LATE
from casid.shooting.lines import Lines, held_lines

PORTION = 1000  # lines whose derivatives are held at once before they are joined
RANK = 1e-13  # eigenvalue of the transient's information, to unit diagonal, that counts as zero


@dataclass(frozen=True, eq=False)
class Residual:
    """Weighed residuals of one record's lines and their normal equations, transient eliminated.

    The transient d = x_0 − x_N minimises the sum of squares. T has orthonormal columns: derivatives
    by d times a root of its covariance; ``follow`` (nx, nf) says what of them is in J.
    """

    E: ComplexArray  # (K, ny) measured less the model, 0 where not measured
    J: ComplexArray  # (K, ny, nf) weighed derivative of the model by λ, d held
    T: ComplexArray  # (K, ny, nx)
    follow: Array
    cost: float  # half the weighed sum of squares
    F: Array  # (nf, nf) information
    g: Array  # (nf,) gradient of the cost
    alone: Array  # (nf,) information were the transient known

    @property
    def rows(self) -> ComplexArray:
        """Weighed derivative of the model by λ as d follows, (K, ny, nf)."""
        return self.J - self.T @ self.follow


class SpectralResiduals:
    """Residuals of one structure on the lines of its records."""

    def __init__(self, free: Free, lines: list[Lines]) -> None:
        self.free, self.lines, self.matrices = free, lines, MatrixFunction(free)

    def __call__(self, lam: Array, weights: Sequence[Array]) -> list[Residual]:
        """Of every record at free values (nf,), weighed by its (K, ny) of them.

        LinAlgError for a pole on a line.
        """
        m = self.matrices(lam)
        driven: dict[tuple[float, ...], tuple[Array, Array]] = {}
        found = []
        for lines, weight in zip(self.lines, weights, strict=True):
            record = lines.record
            S, rest = held_lines(self._held(lines, m), record.N, len(lines.z))
            key = (ORDER[record.hold], record.dt, *np.round(rest, 12))
            if key not in driven:
                driven[key] = _driven(m, record.dt, rest, ORDER[record.hold])
            found.append(_residual(lines, weight, S, m, driven[key]))
        return found

    def _held(self, lines: Lines, m: Matrices) -> DelayedInput:
        """Delayed inputs of one record; a delay on its bound 0 counts as one to come."""
        record, moves = lines.record, m.dtau.any(axis=0)
        if record.hold == "zoh":
            moves &= ~self.matrices.direct  # outputs jump there
        within = np.where(moves, np.maximum(m.tau, LATE * record.dt), m.tau)
        return delayed_input(record.t, record.u, m.tau, record.hold, within)


def _residual(
    lines: Lines, weight: Array, S: ComplexArray, m: Matrices, driven: tuple[Array, Array]
) -> Residual:
    """Residuals of one record from the signals S (K, 3 nu) that drive it."""
    (drive, drive_lam), (direct, direct_lam) = driven, _direct(m)
    nx, C = m.nx, m.blocks[2]
    R = np.linalg.inv(lines.z[:, None, None] * np.eye(nx) - drive[:, :nx])
    if not np.isfinite(R).all():
        raise np.linalg.LinAlgError("a pole on a line")
    W = np.sqrt(weight * lines.seen)[:, :, None]
    Z = np.hstack([(R @ (S @ drive[:, nx:].T)[:, :, None])[:, :, 0], S])
    begun = R * (lines.z / np.sqrt(lines.record.N))[:, None, None]
    E, T = (lines.Y - Z @ direct.T) * lines.seen, W * (C @ begun)
    d, root = _transient(T, W[:, :, 0] * E)
    Z[:, :nx] += begun @ d
    E -= (begun @ d) @ C.T
    J = np.empty((len(W), len(C), len(m.dtau)), dtype=complex)
    flat, felt = J.reshape(len(J), -1), np.flatnonzero(direct_lam.any(axis=0))
    for at in (slice(k, k + PORTION) for k in range(0, len(W), PORTION)):
        J[at] = C @ R[at] @ _times(Z[at], drive_lam).reshape(-1, nx, J.shape[2])
        flat[at, felt] += _times(Z[at], direct_lam[:, felt])
    J *= W
    return _eliminated(E * lines.seen, W, J, T @ root)


def _gram(left: ComplexArray, right: ComplexArray) -> Array:
    """Real part of the product of the first, conjugate transposed, with the second: (K, ny, n)."""
    total: Array = np.zeros((left.shape[-1], right.shape[-1]))
    for half in (np.real, np.imag):
        a, b = (np.ascontiguousarray(half(x)).reshape(-1, x.shape[-1]) for x in (left, right))
        total += a.T @ b
    return total


def _transient(T: ComplexArray, E: ComplexArray) -> tuple[Array, Array]:
    """The transient (nx,) that fits residuals (K, ny) best, and a root of its covariance."""
    G = _gram(T, T)
    unit = 1 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = np.linalg.eigh(G * np.outer(unit, unit))
    kept = values > RANK * max(float(values.max()), 1e-300)
    root = unit[:, None] * vectors * np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return root @ (root.T @ _gram(T, E[:, :, None])[:, 0]), root


def _eliminated(E: ComplexArray, W: Array, J: ComplexArray, T: ComplexArray) -> Residual:
    """Normal equations from weighed derivatives, those by the transient T orthonormal."""
    n, parts = J.shape[2], (J, T, W * E[:, :, None])
    rows = np.empty((2, *J.shape[:2], sum(part.shape[2] for part in parts)))
    for half, of in zip(rows, (np.real, np.imag), strict=True):
        np.concatenate([of(part) for part in parts], axis=2, out=half)
    flat = rows.reshape(-1, rows.shape[-1])
    G = flat.T @ flat
    follow = G[n:-1, :n]
    return Residual(
        E=E, J=J, T=T, follow=follow, cost=float(G[-1, -1]) / 2, F=G[:n, :n] - follow.T @ follow,
        g=follow.T @ G[n:-1, -1] - G[:n, -1], alone=np.diag(G)[:n],
    )  # fmt: skip


def _times(Z: ComplexArray, matrix: Array) -> ComplexArray:
    """Z times a real matrix, without making that complex."""
    out = np.empty((len(Z), matrix.shape[1]), dtype=complex)
    out.real, out.imag = Z.real @ matrix, Z.imag @ matrix
    return out


def _driven(m: Matrices, h: float, rest: Array, order: int) -> tuple[Array, Array]:
    """The matrix by which the next state follows from [x; value; slope; jump], (nx, nx + 3 nu).

    Behind it its derivatives by λ, those of the value by the delays with it, (nx + 3 nu, nx nf).
    """
    A, B = m.blocks[:2]
    nx, nu = B.shape
    dA, dB, tau_lam = m.slopes[:, :nx, :nx], m.slopes[:, :nx, nx:], m.dtau.T
    P = integral_slopes(A, np.array([h, *rest]), np.moveaxis(dA, 0, -1))
    matrices, slopes = P[..., 0], P[..., 1:]
    nf = len(dB)
    drive, by_lam = np.zeros((nx, nx + 3 * nu)), np.zeros((nx, nx + 3 * nu, nf))
    drive[:, :nx], by_lam[:, :nx] = matrices[0, 0], slopes[0, 0]
    for p in (1, 2):
        at = slice(nx + (p - 1) * nu, nx + p * nu)
        drive[:, at] = matrices[p, 0] @ B
        by_lam[:, at] = np.einsum("ija,jm->ima", slopes[p, 0], B)
        by_lam[:, at] += np.einsum("ij,ajm->ima", matrices[p, 0], dB)
    for j in range(nu):
        at, b = nx + 2 * nu + j, B[:, j]
        drive[:, at] = matrices[order, 1 + j] @ b
        by_lam[:, at] = np.einsum("ija,j->ia", slopes[order, 1 + j], b)
        by_lam[:, at] += matrices[order, 1 + j] @ dB[:, :, j].T
        by_lam[:, at] -= np.outer(matrices[order - 1, 1 + j] @ b, tau_lam[j])
    by_lam[:, nx + nu : nx + 2 * nu] -= drive[:, nx : nx + nu, None] * tau_lam
    return drive, np.moveaxis(by_lam, 1, 0).reshape(nx + 3 * nu, nx * nf)


def _direct(m: Matrices) -> tuple[Array, Array]:
    """The same of the outputs: (ny, nx + 3 nu), and derivatives (nx + 3 nu, ny nf)."""
    C, D = m.blocks[2:]
    (ny, nu), nx, nf = D.shape, m.nx, len(m.dtau)
    none = np.zeros((ny, 2 * nu))
    by_lam = np.zeros((nx + 3 * nu, ny, nf))
    by_lam[: nx + nu] = np.moveaxis(m.slopes[:, nx:], (0, 1, 2), (2, 1, 0))
    by_lam[nx + nu : nx + 2 * nu] = -np.einsum("im,ma->mia", D, m.dtau.T)
    return np.hstack([C, D, none]), by_lam.reshape(nx + 3 * nu, ny * nf)
