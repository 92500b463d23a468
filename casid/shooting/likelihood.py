"""The covariance of white measurement noise, and the likelihood of residuals under it.

Residuals enter by their second moments: for every pattern p of measured channels the sum
S_p = Σ r rᵀ over its n_p samples. Up to the constant ½ n log 2π the negative logarithm of the
likelihood is

    ℓ(R) = ½ Σ_p ( tr(R_p⁻¹ S_p) + n_p log det R_p ),

R_p being the block of R for the channels of pattern p.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from casid.arrays import Array, BoolArray
from casid.assembly import by_number

CovarianceKind = Literal["diagonal", "full"]
EM_STEPS, EM_SETTLED = 500, 1e-12


@dataclass(frozen=True, eq=False)
class Noise:
    """What is known of R before the residuals are seen."""

    patterns: BoolArray  # (P, ny) measured channels of every pattern
    counts: np.ndarray  # (P,) samples of every pattern
    floor: Array  # (ny,) smallest standard deviation believed of each channel
    kind: CovarianceKind = "diagonal"  # structure of an estimated R
    given: Array | None = None  # (ny, ny) R, if it is not estimated

    @property
    def unknowns(self) -> int:
        """How many variances and covariances are estimated."""
        ny = len(self.floor)
        return {"diagonal": ny, "full": ny * (ny + 1) // 2}[self.kind] * (self.given is None)

    @property
    def concentrated(self) -> bool:
        """Whether every channel's variance is estimated alone."""
        return self.given is None and self.kind == "diagonal"

    def covariance(self, moments: Array) -> Array:
        """Most likely R (ny, ny) for second moments (P, ny, ny), not below the floor."""
        if self.given is not None:
            return self.given
        seen = self.patterns.T @ self.counts
        variance = np.einsum("pii->i", moments) / np.maximum(seen, 1)
        if self.kind == "diagonal":
            return np.diag(np.maximum(variance, self.floor**2))
        return self._floored(self._full(np.diag(np.maximum(variance, self.floor**2)), moments))

    def _full(self, R: Array, moments: Array) -> Array:
        """Expectation maximisation over the missing channels; one step if there are none."""
        total = self.counts[self.patterns.any(axis=1)].sum()
        for _ in range(EM_STEPS):
            new = np.zeros_like(R)
            for seen, n, S in zip(self.patterns, self.counts, moments, strict=True):
                if n and seen.any():
                    K = np.linalg.solve(R[np.ix_(seen, seen)], R[seen]).T
                    expected = K @ S[np.ix_(seen, seen)] @ K.T
                    new += expected + n * (R - K @ R[seen])
            new /= total
            change = np.abs(new - R).max() / np.abs(new).max()
            R = (new + new.T) / 2
            if change <= EM_SETTLED:
                break
            R = self._floored(R)
        return R

    def _floored(self, R: Array) -> Array:
        unit = np.outer(self.floor, self.floor)
        values, vectors = np.linalg.eigh(R / unit)
        return np.asarray((vectors * np.maximum(values, 1.0)) @ vectors.T * unit)

    def exact(self, R: Array) -> bool:
        """Whether every channel is fitted down to the floor: noise-free data."""
        return bool((np.sqrt(np.diag(R)) <= 1.001 * self.floor).all())

    def cost(self, R: Array, moments: Array) -> float:
        """ℓ(R), the negative log-likelihood less ½ n log 2π."""
        cost = 0.0
        for seen, n, S in zip(self.patterns, self.counts, moments, strict=True):
            if n and seen.any():
                block = np.ix_(seen, seen)
                cost += 0.5 * float(np.trace(np.linalg.solve(R[block], S[block])))
                cost += 0.5 * int(n) * float(np.linalg.slogdet(R[block])[1])
        return cost


def moments_of(residuals: Array, pattern: np.ndarray, patterns: int) -> Array:
    """Σ r rᵀ of every pattern, (P, ny, ny), from residuals (N, ny) that are 0 where missing."""
    moments = np.zeros((patterns, residuals.shape[1], residuals.shape[1]))
    for p, mine in by_number(pattern, patterns):
        moments[p] = residuals[mine].T @ residuals[mine]
    return moments
