"""What feedback makes of the noise that it hears: sticks and rates beside those of the card.

With u = r - K (y + e) and e white from sample to sample, of covariance R, one sample of e acts as
one of r = -K e: with H_k the sticks k samples after one sample of each r, their covariance is
Σ (H_k K) R (H_k K)ᵀ, that of their rates the same of (H_k - H_{k-1})/h. Noise that is heard white
takes a rate far: √2 K σ/h, however small the card.
"""

import numpy as np
import scipy

from casid.arrays import Array
from casid.design.criterion import KEPT
from casid.design.loop import Loop

FAR = 12.0  # standard deviations that no flight of any length exceeds


def deviations(loop: Loop, K: Array, R: Array) -> Array:
    """Standard deviations (2 nu,) of sticks and their rates, of noise alone, gains K (nu, ny)."""
    H = loop.impulses()[:, : loop.nu] @ K @ np.linalg.cholesky(R)
    rates = np.diff(H, axis=0, prepend=0.0 * H[:1]) / loop.h
    return np.asarray(np.sqrt((np.concatenate([H, rates], axis=1) ** 2).sum(axis=(0, 2))))


def peak(c: Array, sigma: float, share: float = KEPT) -> float:
    """Below which a share of flights keep all |c + n|, c (N,) known, n normal, independent.

    Samples that are correlated stay below with at least that share, where c is nothing (Z. Šidák,
    Journal of the American Statistical Association 62, 1967).
    """
    most = float(np.abs(c).max())
    if sigma == 0.0:
        return most

    def excess(a: float) -> float:
        inside = scipy.special.ndtr((a - c) / sigma) - scipy.special.ndtr((-a - c) / sigma)
        return float(np.prod(inside)) - share

    return float(scipy.optimize.brentq(excess, most, most + FAR * sigma, xtol=1e-6 * sigma))
