"""What a bound leaves open: a parameter on it lies within its bounds, it is not known to be there.

Were the bounds let go, the parameters a on theirs would end d = −K g from them, of covariance S: K
is their inverse information with the others following, g the slopes of the cost. What is known of
the true a is N(d, S) within the bounds; its second moments about them, D, count as their errors,
and V D Vᵀ as those of the parameters that follow them by V. A bound that noise alone has put an
estimate on leaves all of its error, one that the data press against hard leaves none.

Moments by the sequential conditioning of A. Genz, Numerical computation of multivariate normal
probabilities, J. Computational and Graphical Statistics 1, 1992.
"""

from typing import NamedTuple

import numpy as np
import scipy

from casid.arrays import Array

POINTS = 4096  # of the integral over several
FARTHEST = 30.0  # standard deviations beyond a bound: no probability is told farther out


class OnBounds(NamedTuple):
    """Parameters on bounds, (k,): their places, slopes of the cost by them, and widths within."""

    at: np.ndarray
    slope: Array
    side: Array  # 1 of a lower bound, -1 of an upper one
    room: Array  # to the other bound, perhaps infinite

    def information(self, n: int) -> Array:
        """That lying anywhere within the bounds is worth, (n,): 12/room²."""
        found = np.zeros(n)
        found[self.at] = 12.0 / self.room**2
        return found


def beside_bounds(K: Array, held: OnBounds, wider: float = 1.0) -> Array:
    """Covariance (n, n) that parameters on bounds add to one in which they are known.

    Of the inverse information K (n, n) with these bounds let go, and how many times the variance of
    estimates is that by it. Zero of parameters of which K knows nothing.
    """
    n = len(K)
    told = np.isfinite(K[:, held.at]).all(axis=0) & (np.diag(K)[held.at] > 0)
    at, side = held.at[told], held.side[told]
    if not len(at):
        return np.zeros((n, n))
    inner = K[np.ix_(at, at)]
    follow = scipy.linalg.solve(inner, K[at], assume_a="sym").T
    beyond = -side * (inner @ held.slope[told])
    flipped = np.outer(side, side)
    D = second_moments(beyond, wider * inner * flipped, held.room[told]) * flipped
    return np.asarray(follow @ D @ follow.T)


def second_moments(mean: Array, covariance: Array, room: Array) -> Array:
    """E[d dᵀ], (k, k), of normal d (k,) given that 0 <= d <= ``room`` (k,)."""
    size = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(size, size) + 1e-10 * np.eye(len(size)))
    center, end = mean / size, room / size
    rng = np.random.default_rng(0)
    u = np.transpose([(rng.permutation(POINTS) + 0.5) / POINTS for _ in size])  # Latin hypercube
    z, d, weight = np.zeros(u.shape), np.zeros(u.shape), np.ones(POINTS)
    for j, diagonal in enumerate(np.diag(root)):
        middle = center[j] + z[:, :j] @ root[j, :j]
        low = np.minimum(-middle / diagonal, FARTHEST)
        beyond, within = (scipy.special.ndtr(-x) for x in (low, (end[j] - middle) / diagonal))
        z[:, j] = -scipy.special.ndtri(beyond - u[:, j] * (beyond - within))
        d[:, j] = np.clip(middle + diagonal * z[:, j], 0.0, end[j])
        weight *= beyond - within
    share = weight / max(float(weight.sum()), 1e-300)
    return np.asarray((d.T * share) @ d * np.outer(size, size))
