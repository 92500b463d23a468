"""The Kalman filter of a structure whose states are driven by white noise, and its derivatives.

    dx = (A x + B u) dt + dw,    E dw dwᵀ = Q dt diagonal,    y_k = C x_k + ... + v_k,  E v vᵀ = R

P_0 is that of a filter which began two seconds earlier without uncertainty: where a record begins
is estimated, and with P_0 = 0 the likelihood would have no bound, first samples being met exactly
by ever smaller R. Over every step, by the channels measured,

    S = C P Cᵀ + R,    K = A_d P Cᵀ S⁻¹,    F = A_d - K C,    P⁺ = F P Fᵀ + K R Kᵀ + Q_d.

K being the best gain, its own derivative cancels in that of P⁺ (Joseph's form):

    dP⁺ = F dP Fᵀ + dF P Fᵀ + F P dFᵀ + K dR Kᵀ + dQ_d,    dF = dA_d - K dC.

Where neither step nor channels change both converge within seconds of flight: P to the solution of
the algebraic Riccati equation, dP to that of its Lyapunov equation; from there one gain serves all
samples (R. V. Jategaonkar, Flight Vehicle System Identification, ch. 5, has that gain alone).
Missing samples, several rates and irregular sampling need nothing more.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.intersample import integral_slopes
from casid.shooting.gains import Gains
from casid.shooting.intervals import Layout
from casid.shooting.stepping import interpolation, octaves
from casid.shooting.unknowns import FilterMatrices

SETTLED = 1e-11  # change of P over a step, relative, that ends its recursion
OFTEN = 8  # samples after which that is looked at
EARLIER = 2.0  # s, since when filters run
POINTS = 12  # of Gauss and Legendre: ∫ e^{As} Q e^{Aᵀs} ds to rounding for ‖A‖h up to 4


@dataclass(frozen=True, eq=False)
class Transitions:
    """A_d and Q_d of every class of steps (c), and behind each its derivatives by all unknowns."""

    A: Array  # (c, 1 + nf, nx, nx)
    Q: Array  # (c, 1 + nf, nx, nx)


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
    return Transitions(A, Q)


def filter_gains(m: FilterMatrices, layout: Layout) -> Gains:
    """Gains at all samples of a layout."""
    moves, recursion = transitions(m, layout.classes), _Recursion(m, layout)
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
            which[mine] = list(recursion.run(moves, kinds))
            done.append((kinds, which[mine]))
    return recursion.gains(which)


class _Recursion:
    """The filter's covariance from the first sample of a record on, and tables of what it gives.

    Arrays hold a value and behind it, along the first axis, its derivatives by the unknowns that
    move it.
    """

    def __init__(self, m: FilterMatrices, layout: Layout) -> None:
        self._m, self._nf = m, m.A_lam.shape[2]
        parts = (m.A_lam, m.C_lam, m.Q_lam[None], m.R_lam)
        self._moving = np.flatnonzero(sum(part.any(axis=(0, 1)) for part in parts))
        self._C = np.concatenate([m.C[None], np.moveaxis(m.C_lam[..., self._moving], 2, 0)])
        self._R = np.concatenate([m.R[None], np.moveaxis(m.R_lam[..., self._moving], 2, 0)])
        self._patterns = layout.patterns
        self._early = round(EARLIER / float(np.median(layout.classes[layout.step])))
        self._K: list[Array] = []
        self._S: list[Array] = []
        self._seen: list[np.ndarray] = []

    def run(self, moves: Transitions, kinds: np.ndarray) -> Iterator[int]:
        """Row of the tables for every sample of a record; ``kinds`` (N, 2) are step and pattern."""
        index = np.concatenate([[0], 1 + self._moving])
        P = self._begun(moves.A[kinds[0, 0], index], moves.Q[kinds[0, 0], index])
        settled, row = False, -1
        for k, (step, pattern) in enumerate(kinds):
            if not (settled and k and np.array_equal(kinds[k], kinds[k - 1])):
                row, before = len(self._K), P
                P, tables = self._advance(P, moves.A[step, index], moves.Q[step, index], pattern)
                for table, entry in zip((self._K, self._S, self._seen), tables, strict=True):
                    table.append(entry)
                settled = k % OFTEN == 0 and _alike(before, P)
            yield row

    def _begun(self, A: Array, Q: Array) -> Array:
        """P after some seconds of steps with all channels, from none."""
        P = np.zeros_like(A)
        for _ in range(self._early):
            before, (P, _) = P, self._advance(P, A, Q, 0)
            if _alike(before, P):
                break
        return P

    def _advance(
        self, P: Array, A: Array, Q: Array, pattern: int
    ) -> tuple[Array, tuple[Array, Array, np.ndarray]]:
        """P one step on, and K, S and the channels of its sample."""
        seen = self._patterns[pattern]
        C, R = self._C * seen[:, None], self._R * (seen & seen[:, None])
        CP = C[0] @ P
        CP[1:] += C[1:] @ P[0]
        S = CP @ C[0].T + R
        S[0] += np.diag(~seen)
        S[1:] += CP[0] @ C[1:].transpose(0, 2, 1)
        AP = A[0] @ CP.transpose(0, 2, 1)
        AP[1:] += A[1:] @ CP[0].T
        inverse = np.linalg.inv(S[0])
        K = AP @ inverse
        K[1:] -= K[0] @ S[1:] @ inverse
        F = A - K[0] @ C
        ahead = F[0] @ P @ F[0].T + K[0] @ R @ K[0].T + Q
        turned = F[1:] @ (P[0] @ F[0].T)
        ahead[1:] += turned + turned.transpose(0, 2, 1)
        return np.asarray(ahead + ahead.transpose(0, 2, 1)) / 2, (K, S, seen)

    def gains(self, which: np.ndarray) -> Gains:
        """The tables, with derivatives by all unknowns."""
        K, S, seen = (np.array(part) for part in (self._K, self._S, self._seen))
        W = np.linalg.inv(np.linalg.cholesky(S[:, 0])) * seen[:, :, None]
        K_lam, S_lam = (np.zeros((len(K), *part.shape[2:], self._nf)) for part in (K, S))
        K_lam[..., self._moving] = np.moveaxis(K[:, 1:], 1, 3)
        S_lam[..., self._moving] = np.moveaxis(S[:, 1:], 1, 3)
        return Gains(which, K[:, 0], S[:, 0], W, K_lam, S_lam)


def _alike(before: Array, after: Array) -> bool:
    """Whether matrices (n, nx, nx), each in its own scale, are the same but for rounding."""
    unit = np.sqrt(np.abs(np.einsum("nii->ni", after)).max(axis=0))
    unit[unit == 0] = 1.0
    size, change = (
        np.abs(part / np.outer(unit, unit)).max(axis=(1, 2)) for part in (after, after - before)
    )
    return bool((change <= SETTLED * size).all())
