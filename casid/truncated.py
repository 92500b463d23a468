"""What a bound leaves open: a parameter on it lies within its bounds, it is not known to be there.

Were bounds and inequalities with no room left let go, what they hold would end d = −K g from them,
of covariance S: K is its inverse information with all else following, g the slopes of the cost.
What is known of the true distances is N(d, S) within the bounds; their second moments D count as
errors, V D Vᵀ of parameters that follow them by V. A bound that noise alone has put an estimate on
leaves all of its error, one that the data press against hard leaves none.

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
    """What is on a bound, k combinations of n parameters."""

    rows: Array  # (k, n)
    slope: Array  # (k,) of the cost by each
    side: Array  # (k,) 1 of a lower bound, -1 of an upper one
    room: Array  # (k,) to the other bound, perhaps infinite

    @property
    def information(self) -> Array:
        """That lying anywhere within the bounds is worth, (n, n): 12/room² of each."""
        return np.asarray((self.rows.T * (12.0 / self.room**2)) @ self.rows)


def beside_bounds(
    K: Array, held: OnBounds, covariances: tuple[Array, Array] | None = None
) -> Array:
    """Covariance (n, n) that what is on bounds adds to one in which it is known to be there.

    Of the inverse information K (n, n) with these bounds let go. ``covariances`` (n, n) are of what
    else is estimated, by the information and as it is: what makes it larger, as colour, widens what
    a bound leaves open alike, in the geometric mean. Nothing is added of what K does not know.
    """
    K = np.where(np.isfinite(K), K, 0.0)
    rows = held.rows * held.side[:, None]  # inwards
    told = np.einsum("ka,ab,kb->k", rows, K, rows) > 0
    if not told.any():
        return np.zeros_like(K)
    rows, slope, room = rows[told], (held.side * held.slope)[told], held.room[told]
    cross = K @ rows.T
    inner, wider = rows @ cross, 1.0 if covariances is None else _wider(*covariances)
    size = np.sqrt(np.diag(inner))
    follow = cross / size @ scipy.linalg.pinvh(inner / np.outer(size, size)) / size
    return np.asarray(follow @ second_moments(-inner @ slope, wider * inner, room) @ follow.T)


def _wider(by_information: Array, covariance: Array) -> float:
    """How many times the one's variances are the other's, where both know them."""
    white, own = np.diag(by_information), np.diag(covariance)
    told = np.isfinite(white) & np.isfinite(own) & (white > 0) & (own > 0)
    return float(np.exp(np.mean(np.log(own[told] / white[told])))) if told.any() else 1.0


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
