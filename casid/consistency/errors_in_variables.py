"""Least squares with errors in variables: the noise's part of the normal equations is subtracted.

Unknowns of one record alone, its biases, are eliminated first: what is left are the equations of
those that all records share (Schur's complement).

Noise of a rate stands in the slopes as well as in the residuals. It counts as movement, so that
standard errors come out too small, and pulls gains towards zero. Both are quadratic in the noise,
so its share of information and slope is known once what it adds is: the corrected score of
T. Nakamura, Biometrika 77, 1990; R. J. Carroll et al., Measurement Error in Nonlinear Models,
2nd ed., chapters 5 and 7. Directions in which noise is most of what is seen are left alone, and
nothing but the prior is known along them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array

FLOOR = 1e-13  # of information, next to the largest
LEAST = 0.5  # share of the information that must be no noise's
LEVEL = 0.5  # of the correction: its standard error, as noise is not quite white


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations: information (n, n) and slope (n,)."""

    information: Array
    slope: Array

    def __add__(self, other: "Normal") -> "Normal":
        return Normal(self.information + other.information, self.slope + other.slope)

    def __mul__(self, factor: float) -> "Normal":
        return Normal(factor * self.information, factor * self.slope)

    def after(self, step: Array) -> "Normal":
        """These of a quadratic, such a step (n,) on."""
        return replace(self, slope=self.slope - self.information @ step)


class Eliminated:
    """Normal equations of one record in the ``n`` unknowns that all share, its own eliminated."""

    def __init__(self, whole: Normal, n: int) -> None:
        H, g = whole.information, whole.slope
        size = np.sqrt(np.diag(H)[n:])
        size = np.where(size > 0, size, 1.0)
        scale = np.outer(size, size)
        self._inverse = np.linalg.inv(H[n:, n:] / scale + FLOOR * np.eye(len(size))) / scale
        self._passed, self._alone = self._inverse @ H[n:, :n], self._inverse @ g[n:]
        self.shared = Normal(H[:n, :n] - H[:n, n:] @ self._passed, g[:n] - H[:n, n:] @ self._alone)

    def step(self, shared: Array) -> Array:
        """Newton's step of its own unknowns beside one of those that are ``shared`` (n,)."""
        return np.asarray(self._alone - self._passed @ shared)

    def drawn(self, k: Sequence[int]) -> tuple[float, float]:
        """Newton's step that some unknowns share, all else held.

        And its standard error, were all else known and innovations white: none is known better.
        """
        known = max(float(self.shared.information[np.ix_(k, k)].sum()), 1e-300)
        return float(self.shared.slope[[*k]].sum()) / known, known**-0.5

    def scores(self, scores: Array) -> Array:
        """Scores (m, n) without what its own unknowns take, of those (m, n + own) of all."""
        n = self._passed.shape[1]
        return np.asarray(scores[:, :n] - scores[:, n:] @ self._passed)

    def variances(self, scores: Array, P: Array) -> Array:
        """Of its own unknowns, ``P`` (n, n) the covariance of the others."""
        scatter = np.sum((scores[:, self._passed.shape[1] :] @ self._inverse) ** 2, axis=0)
        known = np.maximum(np.diag(self._inverse), scatter)  # if the others were
        return np.asarray(known + np.sum(self._passed @ P * self._passed, axis=1))


class Corrected:
    """Normal equations without what noise adds to them."""

    def __init__(self, seen: Normal, pretended: Normal) -> None:
        size = np.sqrt(np.diag(seen.information))
        self._size = np.where(size > 0, size, 1.0)
        scale = np.outer(self._size, self._size)
        lam, V = np.linalg.eigh(seen.information / scale)
        W = V / np.sqrt(np.maximum(lam, FLOOR * lam[-1]))  # W' information W = 1
        noisy = W.T @ (pretended.information / scale) @ W
        share, U = np.linalg.eigh(np.eye(len(W)) - noisy)
        self._known = share > LEAST
        self._share = np.where(self._known, share, 1.0)
        self._W = W @ U
        self._slope = self._W.T @ (seen.slope / self._size)
        self._bias = self._W.T @ (pretended.slope / self._size)

    def step(self) -> Array:
        """Newton's step (n,)."""
        slope = self._slope - np.where(self._known, self._bias, 0.0)
        return np.asarray(self._W @ (slope / self._share) / self._size)

    def covariance(self, scores: Array, reach: Array) -> Array:
        """Covariance (n, n) of the unknowns, which are at most their ``reach`` (n,).

        Variances are the larger of the inverse and of what the scatter of the scores (m, n) says,
        and what noise of another level or colour would do; correlations are those of the inverse.
        """
        H = self._W / self._share
        scatter = (scores / self._size) @ self._W - self._bias / len(scores)
        seen = np.maximum(np.sum(H**2, axis=1), np.sum((scatter @ H.T) ** 2, axis=0))
        seen += (LEVEL * (H @ np.where(self._known, self._bias, 0.0))) ** 2
        lengths = (reach * self._size)[:, None] / np.maximum(np.abs(self._W), 1e-300)
        unknown = self._W * np.where(self._known, 0.0, lengths.min(axis=0))
        std = np.sqrt(seen + np.sum(unknown**2, axis=1))
        rows = np.hstack([H, unknown])
        rows *= (std / np.linalg.norm(rows, axis=1) / self._size)[:, None]
        return np.asarray(rows @ rows.T)
