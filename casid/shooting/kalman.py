"""The Kalman filter of a structure whose states are driven by white noise, and its derivatives.

    dx = (A x + B u) dt + dw,    E dw dwᵀ = Q dt diagonal,    y_k = C x_k + ... + v_k,  E v vᵀ = R

P_0 is that of a filter which began two seconds earlier without uncertainty: where a record begins
is estimated, and with P_0 = 0 the likelihood would have no bound, first samples being met exactly
by ever smaller R. Over every step, by the channels measured,

    S = C P Cᵀ + R,    K = A_d P Cᵀ S⁻¹,    F = A_d - K C,    P⁺ = F P Fᵀ + K R Kᵀ + Q_d.

K being the best gain, its own derivative cancels in that of P⁺ (Joseph's form):

    dP⁺ = F dP Fᵀ + dF P Fᵀ + F P dFᵀ + K dR Kᵀ + dQ_d,    dF = dA_d - K dC,
    dK = ((dF P + F dP) Cᵀ + F P dCᵀ - K dR) S⁻¹.

Where neither step nor channels change both converge within seconds of flight: P to the solution of
the algebraic Riccati equation, dP to that of its Lyapunov equation; from there one gain serves all
samples (R. V. Jategaonkar, Flight Vehicle System Identification, ch. 5, has that gain alone).
Missing samples, several rates and irregular sampling need nothing more. What drives dP follows from
P alone, all samples at once; derivatives are not computed where only a likelihood is wanted.
`casid.shooting.riccati` has P, many samples at once where they are alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.intersample import integral_slopes
from casid.record import Record
from casid.shooting.gains import Gains
from casid.shooting.intervals import Layout
from casid.shooting.riccati import Step
from casid.shooting.stepping import interpolation, octaves
from casid.shooting.unknowns import FilterMatrices

SETTLED = 1e-11  # change of P over a step, relative, that ends its recursion
OFTEN = 8  # samples after which that is looked at, a divisor of `MANY`
EARLIER = 2.0  # s, since when filters run
SHARES = 0.01, 0.5  # of the longest record: the least and the most of that, in any unit of time
ROWS = 64  # of the tables whose derivatives are made at once: they stay in the cache
POINTS = 12  # of Gauss and Legendre: ∫ e^{As} Q e^{Aᵀs} ds to rounding for ‖A‖h up to 4


@dataclass(frozen=True, eq=False)
class Transitions:
    """A_d and Q_d of every class of steps (c), and their derivatives by all unknowns."""

    A: Array  # (c, nx, nx)
    Q: Array  # (c, nx, nx)
    A_lam: Array  # (c, nx, nx, nf)
    Q_lam: Array  # (c, nx, nx, nf)


def transitions(m: FilterMatrices, classes: Array) -> Transitions:
    """Maps over steps of the classes' lengths [s]."""
    nx, nf = len(m.A), m.A_lam.shape[2]
    moving = np.flatnonzero(m.A_lam.any(axis=(0, 1)))
    A, Q = (np.zeros((len(classes), 1 + nf, nx, nx)) for _ in range(2))
    where, weight = np.polynomial.legendre.leggauss(POINTS)
    for members in octaves(classes):
        h, shares = interpolation(classes[members], m.A)
        times = np.concatenate([h, np.outer(h, (1 + where) / 2).ravel()])
        E = np.moveaxis(integral_slopes(m.A, times, m.A_lam[:, :, moving])[0], 3, 1)
        here, behind = E[: len(h)], E[len(h) :].reshape(len(h), POINTS, *E.shape[1:])
        part = behind * (np.multiply.outer(h, weight) / 2)[:, :, None, None, None] * m.Q
        spread = np.einsum("hpaik,hpjk->haij", part, behind[:, :, 0], optimize=True)
        spread[:, 1:] += spread[:, 1:].transpose(0, 1, 3, 2)
        by_noise = np.einsum(
            "p,h,hpik,hpjk,kf->hfij", weight / 2, h, behind[:, :, 0], behind[:, :, 0], m.Q_lam,
            optimize=True,
        )  # fmt: skip
        index = np.concatenate([[0], 1 + moving])
        A[np.ix_(members, index)] = np.tensordot(shares, here, axes=1)
        Q[np.ix_(members, index)] = np.tensordot(shares, spread, axes=1)
        Q[members, 1:] += np.tensordot(shares, by_noise, axes=1)
    slopes = (np.ascontiguousarray(np.moveaxis(part[:, 1:], 1, 3)) for part in (A, Q))
    return Transitions(A[:, 0], Q[:, 0], *slopes)


def filter_gains(m: FilterMatrices, layout: Layout, slopes: bool) -> Gains:
    """Gains at all samples of a layout, with derivatives by all unknowns or by none."""
    recursion = _Recursion(m if slopes else _held(m), layout)
    which = np.empty(len(layout.y), dtype=int)
    first = np.cumsum([0, *(record.N for record in layout.records)])
    done: list[tuple[np.ndarray, np.ndarray]] = []
    for r in np.argsort([-record.N for record in layout.records], kind="stable"):
        mine = slice(first[r], first[r + 1])
        kinds = np.column_stack([layout.step[mine], layout.pattern[mine]])
        for longer, found in done:  # records begin alike
            if np.array_equal(longer[: len(kinds)], kinds):
                which[mine] = found[: len(kinds)]
                break
        else:
            which[mine] = recursion.run(kinds)
            done.append((kinds, which[mine]))
    return recursion.gains(which)


def settling_time(records: Sequence[Record]) -> float:
    """Two seconds, or of flights whose unit of time is another one what is likely to be as long."""
    least, most = np.array(SHARES) * max(record.duration for record in records)
    return float(np.clip(EARLIER, least, most))


def _held(m: FilterMatrices) -> FilterMatrices:
    """The same without unknowns."""
    none = {name: getattr(m, name)[..., :0] for name in ("A_lam", "C_lam", "Q_lam", "R_lam")}
    return replace(m, **none)


class _Recursion:
    """The filter's covariance from the first sample of a record on, and tables of what it gives."""

    def __init__(self, m: FilterMatrices, layout: Layout) -> None:
        self._m, self._moves, self._patterns = m, transitions(m, layout.classes), layout.patterns
        parts = (m.A_lam, m.C_lam, m.Q_lam[None], m.R_lam)
        self._moving = np.flatnonzero(sum(part.any(axis=(0, 1)) for part in parts))
        self._early = settling_time(layout.records) / layout.classes  # in steps of each width
        self._tables: list[tuple[Array, ...]] = []

    def run(self, kinds: np.ndarray) -> np.ndarray:
        """Row of the tables for every sample of a record; ``kinds`` (N, 2) are step and pattern."""
        done = sum(len(K) for K, *_ in self._tables)
        first = np.array([kinds[0, 0], 0])  # before the record all channels are measured
        unlike, number = np.unique([first, *kinds], axis=0, return_inverse=True)
        steps = self._steps(unlike).apart()
        earlier = round(np.median(self._early[kinds[:, 0]]))
        before, P = self._carried(np.zeros_like(self._m.A), steps[number[0]], earlier)
        parts, which_step = [before], [np.full(len(before), number[0])]
        early, row, which = len(before), done, np.empty(len(kinds), dtype=int)
        starts = np.flatnonzero(np.append(True, number[2:] != number[1:-1]))
        for start, end in zip(starts, np.append(starts[1:], len(kinds)), strict=True):
            mine = number[1 + start]
            before, P = self._carried(P, steps[mine], end - start)
            which[start:end] = row + np.minimum(np.arange(end - start), len(before) - 1)
            row += len(before)
            parts.append(before)
            which_step.append(np.full(len(before), mine))
        each, P = unlike[np.concatenate(which_step)], np.concatenate(parts)
        K, S = self._steps(each).gain(P)
        tables = (K, S, self._patterns[each[:, 1]], *self._slopes(each, P, K, S))
        self._tables.append(tuple(table[early:] for table in tables))
        return which

    def _carried(self, P: Array, step: Step, count: int) -> tuple[Array, Array]:
        """P before so many samples alike, or before those until it stays; and behind these."""
        if count == 1:
            return P[None], step.ahead(P)
        found = [P[None]]
        for more in step.repeated(P, count):
            chain = np.concatenate([found[-1][-1:], more])
            for k in range(0, len(more), OFTEN):
                if self._settled(chain[k], chain[k + 1]):
                    return np.concatenate([*found, more[:k]]), more[k]
            found.append(more)
        return np.concatenate(found)[:-1], found[-1][-1]

    def _settled(self, before: Array, after: Array) -> bool:
        """Whether P stays as it is, and its derivatives: of P = 0, without noise, they need not."""
        return _alike(before, after) and bool(after.any() or not len(self._moving))

    def _steps(self, kinds: np.ndarray) -> Step:
        """The steps of kinds (g, 2)."""
        m, seen, step = self._m, self._patterns[kinds[:, 1]], kinds[:, 0]
        both = seen[:, :, None] & seen[:, None, :]
        R = np.where(both, m.R, np.eye(len(m.R)) * ~seen[:, None])
        return Step(self._moves.A[step], self._moves.Q[step], m.C * seen[:, :, None], R)

    def gains(self, which: np.ndarray) -> Gains:
        """The tables, with derivatives by all unknowns."""
        K, S, seen, *some = (np.concatenate(part) for part in zip(*self._tables, strict=True))
        W = np.linalg.inv(np.linalg.cholesky(S)) * seen[:, :, None]
        K_lam, S_lam = (np.zeros((*part.shape, self._m.A_lam.shape[2])) for part in (K, S))
        K_lam[..., self._moving], S_lam[..., self._moving] = some
        return Gains(which, K, S, W, K_lam, S_lam)

    def _slopes(self, kinds: np.ndarray, P: Array, K: Array, S: Array) -> tuple[Array, Array]:
        """Derivatives of K and S (g, ..., n) of all rows by the unknowns that move them."""
        K_lam, S_lam = (np.zeros((*part.shape, len(self._moving))) for part in (K, S))
        P_lam: Array = np.zeros((*P.shape[1:], len(self._moving)))
        for first in range(0, len(P) if len(self._moving) else 0, ROWS):
            at = slice(first, first + ROWS)
            filtered = P[at], K[at], S[at]
            rows = _Rows(self._m, self._moves, self._moving, kinds[at, 0], filtered)
            seen = self._patterns[kinds[at, 1]]
            all_lam, P_lam = rows.carried(P_lam)
            K_lam[at] = rows.of_gains(all_lam) * seen[:, None, :, None]
            S_lam[at] = rows.of_covariances(all_lam) * (seen[:, :, None] & seen[:, None])[..., None]
        return K_lam, S_lam


class _Rows:
    """Derivatives of some rows (g) by what moves them, n of it, as if all channels were measured.

    K being 0 where one is missing, only that channel's own row and column are wrong then.
    """

    def __init__(
        self,
        m: FilterMatrices,
        moves: Transitions,
        moving: np.ndarray,
        step: np.ndarray,
        filtered: tuple[Array, Array, Array],
    ) -> None:
        self._C, (self._P, self._K, self._S) = m.C, filtered
        self._C_lam, self._R_lam = (each[:, :, moving] for each in (m.C_lam, m.R_lam))
        A_lam, self._Q_lam = (each[..., moving][step] for each in (moves.A_lam, moves.Q_lam))
        self._F = moves.A[step] - self._K @ m.C
        self._F_lam = A_lam - np.tensordot(self._K, self._C_lam, axes=1)
        self._noise = np.tensordot(self._K, self._R_lam, axes=1)  # K dR

    def carried(self, P_lam: Array) -> tuple[Array, Array]:
        """The derivative of P in all rows (g, nx, nx, n), and behind them, from the first row's."""
        turned = _times(self._F_lam, self._P @ self._F.transpose(0, 2, 1))
        drive = self._Q_lam + turned + turned.transpose(0, 2, 1, 3)
        drive += _times(self._noise, self._K.transpose(0, 2, 1))
        found = np.empty_like(drive)
        for k, F in enumerate(self._F):
            found[k] = P_lam
            P_lam = F @ _turned(F, P_lam) + drive[k]
        return found, P_lam

    def of_gains(self, P_lam: Array) -> Array:
        """The derivative of K (g, nx, ny, n)."""
        K_lam = self._C @ (_times(self._F_lam, self._P) + _turned(self._F, P_lam)) - self._noise
        K_lam += np.tensordot(self._F @ self._P, self._C_lam.transpose(1, 0, 2), axes=1)
        return _times(K_lam, np.linalg.inv(self._S))

    def of_covariances(self, P_lam: Array) -> Array:
        """The derivative of S (g, ny, ny, n)."""
        turned = _times(self._C_lam[None], self._P @ self._C.T)
        both = turned + turned.transpose(0, 2, 1, 3) + self._R_lam
        return np.asarray(self._C @ _turned(self._C, P_lam) + both)


def _turned(X: Array, M: Array) -> Array:
    """Matrices X (..., k, i) times matrices M (..., i, j, n) with derivatives last."""
    flat = X @ M.reshape(*M.shape[:-2], -1)
    return np.asarray(flat.reshape(*flat.shape[:-1], *M.shape[-2:]))


def _times(M: Array, X: Array) -> Array:
    """Matrices M (g, i, j, n) with derivatives last, times matrices X (g, j, k)."""
    return np.asarray(X.transpose(0, 2, 1)[:, None] @ M)


def _alike(before: Array, after: Array) -> bool:
    """Whether P (nx, nx), in its own scale, is the same but for rounding."""
    unit = np.sqrt(np.maximum(np.diag(after), 0.0))  # rounding may leave < 0
    unit[unit == 0] = 1.0
    scaled = np.outer(unit, unit)
    return bool(np.abs((after - before) / scaled).max() <= SETTLED * np.abs(after / scaled).max())
