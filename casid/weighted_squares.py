"""Weighted sums of squares of normal numbers over a variance that is estimated.

    Q = Σ λ_i z_i²/s²,   m s² of χ² with m degrees of freedom:   P(Q > x) = P(Σ λ z² - x s² > 0),

a sum of χ², the last of negative weight, whose tail a saddle point gives within some per cent (R.
Lugannani, S. Rice, Advances in Applied Probability 12 (1980), 475; D. Kuonen, Biometrika 86 (1999),
929). The one χ² of Welch and Satterthwaite has too short a tail where few weights are large.
"""

import numpy as np
import scipy

from casid.arrays import Array

HALVINGS = 40


def upper_limit(weights: Array, freedom: Array | float, chance: float) -> Array:
    """What each Q exceeds with a small chance, below a fifth or so.

    Parameters
    ----------
    weights : (..., n) array
        λ >= 0, not all zero.
    freedom : (...) array
        m, which may be infinite: a variance that is known.
    chance : float
        P(Q > limit).

    Returns
    -------
    (...) array
        The limits.
    """
    freedom = np.broadcast_to(freedom, weights.shape[:-1])
    high = 1 / (2 * weights.max(axis=-1))  # the saddle point ζ of a chance is between 0 and this
    low = 0.0 * high
    for _ in range(HALVINGS):
        zeta = (low + high) / 2
        likely = _tail(zeta, weights, freedom)[1] > chance
        low, high = np.where(likely, zeta, low), np.where(likely, high, zeta)
    return _tail(low, weights, freedom)[0]


def _tail(zeta: Array, weights: Array, freedom: Array) -> tuple[Array, Array]:
    """The x whose saddle points are at ζ > 0, and P(Q > x)."""
    own = weights / (1 - 2 * zeta[..., None] * weights)  # derivatives of the cumulant functions
    mean = own.sum(axis=-1)
    rest = 1 - 2 * zeta * mean / freedom  # not above 0 beyond the saddle points of all x
    safe = np.maximum(rest, 1e-12)
    x, known = mean / safe, np.isinf(freedom)
    of_scale = np.where(known, 2 * zeta * mean, -np.where(known, 0.0, freedom) * np.log(safe))
    fall = of_scale - np.log1p(2 * zeta[..., None] * own).sum(axis=-1)  # -2 K(ζ)
    w = np.sqrt(np.maximum(fall, 1e-12))
    v = np.maximum(zeta * np.sqrt(2 * np.sum(own**2, axis=-1) + 2 * mean**2 / freedom), 1e-12)
    return x, np.where(rest > 0, scipy.special.ndtr(-(w + np.log(v / w) / w)), 0.0)
