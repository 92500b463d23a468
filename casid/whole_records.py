"""Whether whole records pull the estimate apart by more than blocks of their scores tell.

What a structure misses depends on the manoeuvre: of flights that differ, the sums of their scores
scatter by more than blocks within them do, which do not see what lasts as long as a record. Few
records do not tell a covariance, but its size: the mean over all directions of the ratio of both,

    δ = Σ_c g_cᵀ K⁻¹ g_c / Σ_c tr(H_c - H_c²)

with g_c the scores of record c, K the covariance of their sum by blocks and H_c the share of the
information, coordinates such that Σ H_c = I. The denominator is what the sum is on average if K is
right, since the fit holds Σ g_c = 0. That is the first-order correction for clusters of J. N. K.
Rao, A. J. Scott, J. American Statistical Association 76(374), 1981, and the factor of heterogeneity
of P. McCullagh, J. A. Nelder, Generalized Linear Models, 2nd ed. 1989, section 4.5.
"""

import numpy as np
import scipy

from casid.arrays import Array

FEWEST = 4.0  # degrees of freedom: of fewer, δ is chance
BELOW = 0.975  # the upper end of a 95 % interval, which is 1.96 standard errors away
FLAT = 1e-10  # of the largest variance of K: none


def understated(K: Array, g: Array, H: Array) -> float:
    """By how much K (k, k) is to be larger, at least 1; scores g (m, k) and shares H (m, k, k).

    So much that 1.96 standard errors are a 95 % interval by Student's t of as many degrees of
    freedom as give δ its variance where scores are normal: k(m - 1) of m records alike.
    """
    squares = H @ H
    whole = squares.sum(axis=0)
    spare = float(len(K) - np.trace(whole))
    scatter = float(np.trace(whole) - 2 * np.sum(squares * H) + np.sum(whole**2))
    freedom = spare**2 / max(scatter, FLAT)
    if freedom < FEWEST:
        return 1.0
    values, axes = np.linalg.eigh(K)
    inverse = axes / np.sqrt(np.maximum(values, FLAT * values.max()))
    delta = float(np.sum((g @ inverse) ** 2)) / spare
    wider = scipy.special.stdtrit(freedom, BELOW) / scipy.special.ndtri(BELOW)
    return float(max(delta * wider**2, 1.0))
