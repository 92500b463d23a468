"""Scatter of the scores of coloured residuals: as of a process of its own, and by blocks of them.

A score is a sum sᵀ r̃ of whitened residuals r̃ by their derivatives s, the slopes, in k directions of
the parameters. Slopes come record by record, in pieces, and every piece is passed on to all that is
summed over them, so that they are computed once and memory does not grow with the records.
"""

from collections.abc import Iterable, Sequence
from typing import Protocol, TypeAlias

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from casid.arrays import Array

RecordScores: TypeAlias = tuple[Array, Array]  # (m, n) and (m, n, n): scores and information

NO_SCORES: RecordScores = np.zeros((0, 0)), np.zeros((0, 0, 0))
PARTS = 4  # of a block of scores
LEFT = 0.05  # of the information outside a block, at least


class Scores(Protocol):
    """What is summed over the records."""

    def begin(self, r: Array) -> None:
        """Begin a record with its whitened residuals (N, ny)."""

    def add(self, s: Array) -> None:
        """Go on with its next slopes (n, ny, k)."""

    def end(self) -> None:
        """End it."""


def summed(
    residuals: Sequence[Array], slopes: Iterable[Iterable[Array]], scores: Sequence[Scores]
) -> None:
    """Sum scores over records, whose slopes come in pieces (n, ny, k)."""
    for r, pieces in zip(residuals, slopes, strict=True):
        for each in scores:
            each.begin(r)
        for piece in pieces:
            for each in scores:
                each.add(piece)
        for each in scores:
            each.end()


class ProcessScores:
    """Σ_i Σ_j s_iᵀ C(j - i) s_j, (k, k), for C(m) = mean r̃_i r̃_{i+m}ᵀ.

    C (lags + 1, ny, ny) as `casid.shooting.uncertainty.residual_covariance` has it; the sum is
    taken over the spectrum.
    """

    def __init__(self, C: Array, k: int) -> None:
        self._C, self._K = C, np.zeros((k, k))
        self._past: Array = np.zeros((0, C.shape[1], k))
        self._spectra: dict[int, Array] = {}  # of C, by the length of transforms

    def begin(self, r: Array) -> None:  # noqa: ARG002
        """See `Scores`."""
        self._past = self._past[:0]

    def add(self, s: Array) -> None:
        """See `Scores`."""
        past = self._past
        s = np.concatenate([past, s]) if len(past) else s
        self._K += self._double_sum(s)
        if len(past):
            self._K -= self._double_sum(past)
        self._past = s[max(len(s) - len(self._C) + 1, 0) :]

    def end(self) -> None:
        """See `Scores`."""

    def _double_sum(self, s: Array) -> Array:
        """Σ_i Σ_j s_iᵀ C(j - i) s_j over all samples of s (N, ny, k)."""
        C = self._C
        if len(C) == 1:  # white: nothing to transform
            return np.asarray(_flat(s).T @ _flat(C[0] @ s))
        n = scipy.fft.next_fast_len(len(s) + len(C), real=True)
        if n not in self._spectra:
            self._spectra[n] = _weighted_spectrum(C, n)
        S = scipy.fft.rfft(s, n, axis=0)
        weighted = self._spectra[n] @ S
        return np.asarray(
            _flat(S.real).T @ _flat(weighted.real) + _flat(S.imag).T @ _flat(weighted.imag)
        )

    def total(self) -> Array:
        """The sum, positive semidefinite."""
        values, vectors = np.linalg.eigh(self._K + self._K.T)
        values = np.maximum(values / 2, 0.0)  # the taper may leave < 0
        return np.asarray((vectors * values) @ vectors.T)


class OwnScores:
    """Gradient (k,) of every record's cost and its information (k, k), in ``found``."""

    def __init__(self) -> None:
        self.found: list[tuple[Array, Array]] = []

    def begin(self, r: Array) -> None:
        """See `Scores`."""
        self._r, self._first = r, 0
        self._parts: list[tuple[Array, Array]] = []

    def add(self, s: Array) -> None:
        """See `Scores`."""
        flat, last = _flat(s), self._first + len(s)
        self._parts.append((flat.T @ self._r[self._first : last].ravel(), flat.T @ flat))
        self._first = last

    def end(self) -> None:
        """See `Scores`."""
        g, F = zip(*self._parts, strict=True)
        self.found.append((np.sum(g, axis=0), np.sum(F, axis=0)))


class BlockScores:
    """Σ g̃ g̃ᵀ of the scores g = Σ sᵀ r̃ of overlapping blocks, ``K`` (k, k).

    Every score is that of the residuals its block would have were it not fitted itself, to first
    order g̃ = (I - H)⁻¹ g with H its share of the information: the jackknife's (R. M. Bell, D. F.
    McCaffrey, Survey Methodology 28(2), 2002). Blocks have four parts of ``length`` samples and
    begin with every part (H. R. Künsch, Ann. Statist. 17(3), 1989).
    """

    def __init__(self, length: int, k: int) -> None:
        self.K, self._length = np.zeros((k, k)), length
        self._records: list[tuple[Array, Array]] = []

    def begin(self, r: Array) -> None:
        """See `Scores`."""
        count, k = -(-len(r) // self._length), len(self.K)
        self._r, self._first = r, 0
        self._g, self._H = np.zeros((count, k)), np.zeros((count, k, k))

    def add(self, s: Array) -> None:
        """See `Scores`."""
        edges = range(self._length - self._first % self._length, len(s), self._length)
        for part in np.split(s, edges):
            own, last = self._first // self._length, self._first + len(part)
            flat = _flat(part)
            self._g[own] += flat.T @ self._r[self._first : last].ravel()
            self._H[own] += flat.T @ flat
            self._first = last

    def end(self) -> None:
        """See `Scores`."""
        alone = _left_out_scores(_of_blocks(self._H), _of_blocks(self._g))
        self.K += alone.T @ alone / PARTS
        self._records.append((self._g.sum(axis=0), self._H.sum(axis=0)))

    def records(self) -> RecordScores:
        """Scores and information of whole records."""
        scores, shares = zip(*self._records, strict=True)
        return np.array(scores), np.array(shares)


def _of_blocks(parts: Array) -> Array:
    """Sums over all blocks of neighbouring parts (count, ...), those cut by the ends as well."""
    none = np.zeros((PARTS - 1, *parts.shape[1:]))
    padded = np.concatenate([none, parts, none])
    return np.asarray(sliding_window_view(padded, PARTS, axis=0).sum(axis=-1))


def _left_out_scores(H: Array, g: Array) -> Array:
    """(I - H)⁻¹ g of every block, as `left_out` has it; by far less work for small ones."""
    eye, alone = np.eye(H.shape[1]), np.empty_like(g)
    small = np.linalg.norm(H, axis=(1, 2)) <= 1 - LEFT  # no eigenvalue is larger than that
    alone[small] = np.linalg.solve(eye - H[small], g[small, :, None])[..., 0]
    for k in np.flatnonzero(~small):
        alone[k] = left_out(H[k], 1.0) @ g[k]
    return alone


def left_out(H: Array, power: float) -> Array:
    """(I - H)^-power (k, k) of a share H of the information, which is I in all."""
    shares, axes = np.linalg.eigh(H)
    return np.asarray(axes / np.maximum(1 - shares, LEFT) ** power @ axes.T)


def _flat(s: Array) -> Array:
    """(N, ny, k) as (N ny, k): one product of matrices instead of N small ones."""
    return s.reshape(len(s) * s.shape[1], s.shape[2])


def _weighted_spectrum(C: Array, n: int) -> Array:
    """Σ_m C(m) e^{jωm} over both signs of m, on the grid of rfft(n): (n // 2 + 1, ny, ny).

    With the weights that make a sum over the grid one over all n frequencies, by n.
    """
    padded = np.zeros((n, *C.shape[1:]))
    padded[: len(C)] = C
    padded[n - len(C) + 1 :] += np.transpose(C[:0:-1], (0, 2, 1))
    weight = np.full((n // 2 + 1, 1, 1), 2.0 / n)
    weight[0] /= 2
    if n % 2 == 0:
        weight[-1] /= 2
    return np.asarray(scipy.fft.rfft(padded, n, axis=0).conj() * weight)
