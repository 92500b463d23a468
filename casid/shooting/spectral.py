"""Residuals of a linear model on the lines of whole records, and what Gauss-Newton needs of them.

Over one period of a record's transform, with A_d = e^{Ah} and the forcing f_n of the delayed inputs
over the step after sample n (`casid.intersample`), x_{n+1} = A_d x_n + f_n becomes

    X = (z I − A_d)⁻¹ (F + z (x_0 − x_N)/√N),        E = Y − C X − D U,

exactly, whether the model is stable or not and wherever the record begins and ends. The forcing is
linear in the signals of `casid.shooting.lines`: [X; F's signals] times one matrix whose derivatives
by λ come from `casid.intersample.integral_slopes`. What begins and ends, x_0 − x_N of every record,
enters linearly and is eliminated (variable projection: Golub and Pereyra 1973); so is what noise
does that was under way before (`casid.shooting.noise_transients`), which has a variance.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free
from casid.intersample import ORDER, DelayedInput, delayed_input, integral_slopes
from casid.shooting.delayed_inputs import LATE
from casid.shooting.lines import Lines, held_lines
from casid.shooting.noise_transients import DOUBTED, Outside

PORTION = 200  # lines whose derivatives are held at once, in the processor's cache
RANK = 1e-13  # eigenvalue of the transient's information, to unit diagonal, that counts as zero


@dataclass(frozen=True, eq=False)
class _Factors:
    """Of the weighed derivatives of one record's model, real and imaginary parts as halves."""

    Z: Array  # (K, 2, nz) states and signals
    through: Array  # (K, 2 ny, 2 nx) outputs by the states that follow, weighed
    weight: Array  # (K, ny) of what acts at once
    states_lam: Array  # (nz, nx nf) what follows from Z, by λ
    outputs_lam: Array  # (nz, ny, nf) what acts at once, by λ
    beside: Array  # (K, 2, ny, m + 1) derivatives by d times a root of its covariance; residuals

    def portions(self) -> Iterator[tuple[slice, Array]]:
        """One portion of the lines after the other, rows (k, 2, ny, nf + m + 1): by λ, beside."""
        (K, _, ny, _), n, nz = self.beside.shape, self.outputs_lam.shape[2], len(self.states_lam)
        direct = np.flatnonzero(self.outputs_lam.any(axis=(0, 2)))
        for at in (slice(k, k + PORTION) for k in range(0, K, PORTION)):
            Z, beside = self.Z[at].reshape(-1, nz), self.beside[at]
            rows = np.empty((len(beside), 2, ny, n + beside.shape[3]))
            moved = (Z @ self.states_lam).reshape(len(beside), -1, n)
            np.matmul(self.through[at], moved, out=rows.reshape(len(rows), 2 * ny, -1)[..., :n])
            for i in direct:
                own = (Z @ self.outputs_lam[:, i]).reshape(-1, 2, n)
                rows[:, :, i, :n] += own * self.weight[at, None, i, None]
            rows[..., n:] = beside
            yield at, rows


@dataclass(frozen=True, eq=False)
class Residual:
    """Weighed residuals of one record's lines and their normal equations, transient eliminated.

    The transient d (m,), x_0 − x_N and noise from outside, minimises the sum of squares.
    """

    E: ComplexArray  # (K, ny) measured less the model, 0 where not measured
    factors: _Factors
    follow: Array  # (m, nf) what of the derivatives by d, orthonormal, is in those by λ
    cost: float  # half the weighed sum of squares
    F: Array  # (nf, nf) information
    g: Array  # (nf,) gradient of the cost
    alone: Array  # (nf,) information were the transient known

    @cached_property
    def halves(self) -> Array:
        """Weighed derivative of the model by λ as d follows, (K, 2, ny, nf)."""
        out = np.empty((*self.factors.beside.shape[:3], self.follow.shape[1]))
        for at, moved in self.moved():
            out[at] = moved
        return out

    def moved(self, by: Array | None = None) -> Iterator[tuple[slice, Array]]:
        """The same, or its product with a matrix (nf, m), one portion of the lines after the other.

        Portions are (k, 2, ny, nf) or (k, 2, ny, m).
        """
        n = self.follow.shape[1]
        both = np.vstack([np.eye(n), -self.follow]) @ (np.eye(n) if by is None else by)
        for at, rows in self.factors.portions():
            flat = rows.reshape(-1, rows.shape[3])[:, :-1] @ both
            yield at, flat.reshape(*rows.shape[:3], -1)

    @property
    def ends(self) -> Array:
        """Weighed derivative of the model by d, orthonormal columns, (K, 2, ny, m).

        Those of noise from outside are shorter, as far as their variance holds them.
        """
        return self.factors.beside[..., :-1]


class SpectralResiduals:
    """Residuals of one structure on the lines of its records."""

    def __init__(self, free: Free, lines: list[Lines]) -> None:
        self.free, self.lines, self.matrices = free, lines, MatrixFunction(free)

    def below(self, omega: float) -> "SpectralResiduals":
        """The same on lines up to a frequency [rad/s]."""
        other = copy(self)
        other.lines = [each.below(omega) for each in self.lines]
        return other

    def __call__(
        self, lam: Array, weights: Sequence[Array], outside: Sequence[Outside] = ()
    ) -> list[Residual]:
        """Of every record at free values (nf,), weighed by its (K, ny) of them.

        With what noise from outside each may hold. LinAlgError for a pole on a line.
        """
        m = self.matrices(lam)
        direct = _direct(m)
        driven: dict[tuple[float, ...], tuple[Array, Array]] = {}
        resolvents: dict[tuple[float, ...], ComplexArray] = {}
        found = []
        noise: Sequence[Outside | None] = outside or [None] * len(self.lines)
        for lines, weight, beyond in zip(self.lines, weights, noise, strict=True):
            order, h, N = ORDER[lines.record.hold], lines.dt, lines.record.N
            S, rest = held_lines(self._held(lines, m), N, len(lines.z))
            key, at = (order, h, *np.round(rest, 12)), (h, N, len(lines.z))
            if key not in driven:
                driven[key] = _driven(m, h, rest, order)
            if at not in resolvents:
                resolvents[at] = _resolvent(lines.z, driven[key][0][:, : m.nx])
            ends = _Ends(lines, np.sqrt(weight * lines.seen), m.blocks[2], resolvents[at], beyond)
            found.append(_residual(ends, S, m.nx, driven[key], direct))
        return found

    def _held(self, lines: Lines, m: Matrices) -> DelayedInput:
        """Delayed inputs of one record; a delay on its bound 0 counts as one to come."""
        record, moves = lines.record, m.dtau.any(axis=0)
        if record.hold == "zoh":
            moves &= ~self.matrices.direct  # outputs jump there
        within = np.where(moves, np.maximum(m.tau, LATE * lines.dt), m.tau)
        return delayed_input(record.t, record.u, m.tau, record.hold, within)


def _resolvent(z: ComplexArray, A_d: Array) -> ComplexArray:
    """(z I − A_d)⁻¹ on lines (K,): (K, nx, nx)."""
    R = np.linalg.inv(z[:, None, None] * np.eye(len(A_d)) - A_d)
    if not np.isfinite(R).all():
        raise np.linalg.LinAlgError("a pole on a line")
    return np.asarray(R)


@dataclass(frozen=True, eq=False)
class _Ends:
    """What the ends of one record leave on its lines."""

    lines: Lines
    weight: Array  # (K, ny) root of the lines' weights
    C: Array
    R: ComplexArray  # (K, nx, nx) resolvent
    noise: Outside | None

    @cached_property
    def felt(self) -> ComplexArray:
        """Outputs by the states that follow, weighed, (K, ny, nx)."""
        return np.asarray(self.weight[:, :, None] * (self.C @ self.R))

    @cached_property
    def end(self) -> ComplexArray:
        """What one of a state's transient drives, (K,)."""
        return np.asarray(self.lines.z / np.sqrt(self.lines.record.N))

    def columns(self) -> tuple[ComplexArray, Array]:
        """Weighed outputs by the transient d (K, ny, m), and 1/variance (m,) of what is known."""
        own = self.felt * self.end[:, None, None]
        if self.noise is None or not self.noise.output:
            return own, np.zeros(own.shape[2])
        at, (K, ny, nx) = list(self.noise.output), own.shape
        columns = np.zeros((K, ny, nx + len(at)), dtype=complex)
        columns[:, :, :nx] = own
        columns[:, at, nx + np.arange(len(at))] = self.noise.columns * self.weight[:, at]
        return columns, np.repeat([0.0, 1 / DOUBTED], [nx, len(at)])

    def left(self, d: Array) -> tuple[ComplexArray, ComplexArray]:
        """States (K, nx) and outputs (K, ny) of a transient."""
        nx = self.C.shape[1]
        begun = (self.R @ d[:nx]) * self.end[:, None]
        out = begun @ self.C.T
        if self.noise is not None:
            for i, column, size in zip(
                self.noise.output, self.noise.columns.T, d[nx:], strict=True
            ):
                out[:, i] += column * size
        return begun, out


def _residual(
    ends: _Ends,
    S: ComplexArray,
    nx: int,
    driven: tuple[Array, Array],
    straight: tuple[Array, Array],
) -> Residual:
    """Residuals of one record from the signals S (K, 3 nu) that drive it."""
    (drive, drive_lam), (direct, direct_lam) = driven, straight
    lines, W = ends.lines, ends.weight
    Z = np.hstack([(ends.R @ (S @ drive[:, nx:].T)[:, :, None])[:, :, 0], S])
    E = (lines.Y - Z @ direct.T) * lines.seen
    columns, known = ends.columns()
    T = halves(columns)
    d, root = _transient(T, halves(W * E), known)
    begun, out = ends.left(d)
    Z[:, :nx] += begun
    E -= out * lines.seen
    beside = np.concatenate([T @ root, halves(W * E)[..., None]], axis=3)
    factors = _Factors(halves(Z), as_real(ends.felt), W, drive_lam, direct_lam, beside)
    return _eliminated(E, factors, root.T @ (known * d), float(known @ d**2) / 2)


def halves(x: ComplexArray) -> Array:
    """Real and imaginary part, (K, 2, ...)."""
    return np.stack([x.real, x.imag], axis=1)


def as_real(x: ComplexArray) -> Array:
    """Complex matrices (K, m, n) as real ones (K, 2 m, 2 n), of halves one after the other."""
    out = np.empty((len(x), 2, x.shape[1], 2, x.shape[2]))
    out[:, 0, :, 0] = out[:, 1, :, 1] = x.real
    out[:, 0, :, 1], out[:, 1, :, 0] = -x.imag, x.imag
    return out.reshape(len(x), 2 * x.shape[1], -1)


def _transient(T: Array, E: Array, known: Array) -> tuple[Array, Array]:
    """The transient (m,) that fits residuals (K, 2, ny) best, and a root of its covariance.

    Of which zeros are ``known`` with (m,) 1/variance.
    """
    flat = T.reshape(-1, T.shape[-1])
    G = flat.T @ flat + np.diag(known)
    unit = 1 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = np.linalg.eigh(G * np.outer(unit, unit))
    kept = values > RANK * max(float(values.max()), 1e-300)
    root = unit[:, None] * vectors * np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return root @ (root.T @ (flat.T @ E.ravel())), root


def _eliminated(E: ComplexArray, factors: _Factors, pull: Array, cost: float) -> Residual:
    """Normal equations, summed over portions of the lines.

    ``pull`` (m,) is the slope by the transient, and ``cost`` its own, of what is known of it.
    """
    n = factors.outputs_lam.shape[2]
    flat = (rows.reshape(-1, rows.shape[3]) for _, rows in factors.portions())
    G = np.sum([rows.T @ rows for rows in flat], axis=0)
    follow = G[n:-1, :n]
    return Residual(
        E=E, factors=factors, follow=follow, cost=float(G[-1, -1]) / 2 + cost,
        F=G[:n, :n] - follow.T @ follow, g=follow.T @ (G[n:-1, -1] - pull) - G[:n, -1],
        alone=np.diag(G)[:n],
    )  # fmt: skip


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
    """The same of the outputs: (ny, nx + 3 nu), and derivatives (nx + 3 nu, ny, nf)."""
    C, D = m.blocks[2:]
    (ny, nu), nx, nf = D.shape, m.nx, len(m.dtau)
    none = np.zeros((ny, 2 * nu))
    by_lam = np.zeros((nx + 3 * nu, ny, nf))
    by_lam[: nx + nu] = np.moveaxis(m.slopes[:, nx:], (0, 1, 2), (2, 1, 0))
    by_lam[nx + nu : nx + 2 * nu] = -np.einsum("im,ma->mia", D, m.dtau.T)
    return np.hstack([C, D, none]), by_lam
