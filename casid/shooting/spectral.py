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

from collections.abc import Sequence
from copy import copy
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, ComplexArray
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free
from casid.intersample import ORDER, integral_slopes
from casid.model import Model
from casid.shooting.delayed_inputs import LATE
from casid.shooting.line_residuals import Felt, Residual, halves, stacked
from casid.shooting.lines import Lines
from casid.shooting.noise_transients import Outside


class SpectralResiduals:
    """Residuals of one structure on the lines of its records."""

    def __init__(self, free: Free, lines: list[Lines]) -> None:
        self.free, self.lines = free, lines
        self.matrices = _function(free.model, tuple(free.index.tolist()))
        self._last: list[_Discrete] = []  # at the last values, of all copies

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
        at = self._at(lam)
        groups: list[tuple[tuple[float, ...], Felt, list[int], list[ComplexArray]]] = []
        noise: Sequence[Outside | None] = outside or [None] * len(self.lines)
        for r, (lines, weight, beyond) in enumerate(zip(self.lines, weights, noise, strict=True)):
            W, order, K = np.sqrt(weight * lines.seen), self._order(lines, at.m), len(lines.z)
            S, rest = lines.inputs.at(at.m.tau, order, K)
            key = (ORDER[lines.record.hold], _rounded(lines.dt), *np.round(rest, 12))
            place = (lines.kind, lines.record.N, K, *key)
            for own, felt, mine, signals in groups:
                if own == place and np.array_equal(felt.weight, W) and _same(felt.noise, beyond):
                    mine.append(r)
                    signals.append(S)
                    break
            else:
                felt = at.felt(key, lines, W, beyond)
                groups.append((place, felt, [r], [S]))
        found: dict[int, Residual] = {}
        for _, felt, mine, signals in groups:
            lines_of = [self.lines[r] for r in mine]
            found |= zip(
                mine, _residuals(lines_of, felt, np.stack(signals, axis=2), at), strict=True
            )
        return [found[r] for r in range(len(self.lines))]

    def _at(self, lam: Array) -> "_Discrete":
        key = lam.tobytes()
        if not self._last or self._last[0].key != key:
            self._last[:] = [_Discrete(key, self.matrices(lam))]
        return self._last[0]

    def _order(self, lines: Lines, m: Matrices) -> Array:
        """Delays by which breaks and samples are ordered; one on its bound 0 counts as to come."""
        moves = m.dtau.any(axis=0)
        if lines.record.hold == "zoh":
            moves &= ~self.matrices.direct  # outputs jump there
        return np.where(moves, np.maximum(m.tau, LATE * lines.dt), m.tau)


@lru_cache(maxsize=8)
def _function(model: Model, index: tuple[int, ...]) -> MatrixFunction:
    """Matrices of a structure as a function of some of its parameters, whatever their bounds."""
    n = len(model.vector())
    return MatrixFunction(Free(model, np.array(index, dtype=int), *np.zeros((3, n))))


class _Discrete:
    """The model at some values between samples and on lines, of all records alike."""

    def __init__(self, key: bytes, m: Matrices) -> None:
        self.key, self.m, self.direct = key, m, _direct(m)
        self._driven: dict[tuple[float, ...], tuple[Array, Array, NDArray[np.intp]]] = {}
        self._resolvents: dict[tuple[float, ...], ComplexArray] = {}

    def felt(self, key: tuple[float, ...], lines: Lines, W: Array, noise: Outside | None) -> Felt:
        """What outputs of records like one feel, weighed by W² (K, ny).

        By order, sampling interval and rests.
        """
        if key not in self._driven:
            order, h, *rest = key
            drive, by_lam = _driven(self.m, h, np.array(rest), int(order))
            self._driven[key] = drive, *_slopes(by_lam, self.direct[1])
        drive, slopes, acting = self._driven[key]
        R, end = self.resolvent(lines, drive[:, : self.m.nx]), lines.z / np.sqrt(lines.record.N)
        return Felt(W, self.m.blocks[2], R, end, noise, drive, slopes, acting)

    def resolvent(self, lines: Lines, A_d: Array) -> ComplexArray:
        """(z I − A_d)⁻¹ on a record's lines (K, nx, nx)."""
        key, K = (_rounded(lines.dt), lines.record.N), len(lines.z)
        known = self._resolvents.get(key, np.zeros((0, *A_d.shape), dtype=complex))
        if len(known) < K:
            more = _resolvent(lines.z[len(known) :], A_d)
            known = self._resolvents[key] = np.concatenate([known, more])
        return known[:K]


def _same(one: Outside | None, other: Outside | None) -> bool:
    """Whether noise from outside is the same on the lines of two records."""
    if one is None or other is None:
        return one is other
    return one.output == other.output and np.array_equal(one.columns, other.columns)


def _rounded(h: float) -> float:
    """A sampling interval, the same where records' differ by rounding."""
    return float(f"{h:.12g}")


def _resolvent(z: ComplexArray, A_d: Array) -> ComplexArray:
    """(z I − A_d)⁻¹ on lines (K,): (K, nx, nx)."""
    R = np.linalg.inv(z[:, None, None] * np.eye(len(A_d)) - A_d)
    if not np.isfinite(R).all():
        raise np.linalg.LinAlgError("a pole on a line")
    return np.asarray(R)


def _slopes(states: Array, outputs: Array) -> tuple[Array, NDArray[np.intp]]:
    """Ψ (nz, p, nf) of derivatives (nz, nx, nf) of what follows and (nz, ny, nf) at once.

    And the outputs that are not 0 in the latter.
    """
    direct = np.flatnonzero(outputs.any(axis=(0, 2)))
    return np.concatenate([states, outputs[:, direct]], axis=1), direct


def _residuals(
    lines: Sequence[Lines], felt: Felt, S: ComplexArray, model: _Discrete
) -> list[Residual]:
    """Residuals of records that are alike, from the signals S (K, 3 nu, n) that drive them."""
    nx, n, W = felt.C.shape[1], S.shape[2], felt.weight[:, :, None]
    seen, direct = lines[0].seen[:, None], model.direct[0]
    Z = np.concatenate([felt.R @ (felt.drive[:, nx:] @ S), S], axis=1)
    E = (np.stack([each.Y for each in lines], axis=2) - direct @ Z) * seen
    (T, known), root = felt.columns, felt.root
    d = root @ (root.T @ (T.reshape(-1, len(root)).T @ halves(W * E).reshape(-1, n)))
    begun, out = felt.left(d)
    Z[:, :nx] += begun
    E -= out * seen
    weighed = W * E
    cost = (np.sum(np.abs(weighed) ** 2, axis=(0, 1)) + known @ d**2) / 2
    # Slopes of the cost by the transient and by what λ moves.
    across = felt.ends.reshape(-1, len(root)).T @ halves(weighed).reshape(-1, n)
    across -= root.T @ (known[:, None] * d)
    moved, signals = stacked(felt.L.conj().swapaxes(1, 2) @ weighed), stacked(Z)
    own = signals.transpose(2, 1, 0) @ moved.transpose(2, 0, 1)
    g = own.reshape(n, -1) @ felt.slopes.reshape(-1, felt.slopes.shape[2])
    return [
        Residual(
            E[:, :, r], follow.T @ across[:, r] - g[r], felt, Z[:, :, r], follow, float(cost[r])
        )
        for r, follow in enumerate(felt.along(felt.met, signals))
    ]


def _driven(m: Matrices, h: float, rest: Array, order: int) -> tuple[Array, Array]:
    """The matrix by which the next state follows from [x; value; slope; jump], (nx, nx + 3 nu).

    Behind it its derivatives by λ, those of the value by the delays with it, (nx + 3 nu, nx, nf).
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
    return drive, np.ascontiguousarray(np.moveaxis(by_lam, 1, 0))


def _direct(m: Matrices) -> tuple[Array, Array]:
    """The same of the outputs: (ny, nx + 3 nu), and derivatives (nx + 3 nu, ny, nf)."""
    C, D = m.blocks[2:]
    (ny, nu), nx, nf = D.shape, m.nx, len(m.dtau)
    none = np.zeros((ny, 2 * nu))
    by_lam = np.zeros((nx + 3 * nu, ny, nf))
    by_lam[: nx + nu] = np.moveaxis(m.slopes[:, nx:], (0, 1, 2), (2, 1, 0))
    by_lam[nx + nu : nx + 2 * nu] = -np.einsum("im,ma->mia", D, m.dtau.T)
    return np.hstack([C, D, none]), by_lam
