"""Whether a sensor was at its limit: while it reads its largest, others say that more was flown.

Where a rate or specific force stands near its largest or smallest value, it is taken to be off by
something more, beside gain, bias and skew. Of a sensor that follows this is nothing, or inward, as
noise is what lifts a sample to the extreme; of one at its limit it is what was cut off. No
histogram tells that: a rate that a pilot holds steady piles up as well.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array
from casid.consistency.measured import Flight, white_noise

NEAR = 6.0  # deviations of noise below the extreme that count as standing there
CLOSE = 0.02  # of the channel's reach from its middle, without noise
MUCH = 0.1  # of that reach: what matters of a part that was cut off
CERTAIN = 3.0  # standard errors
SURE = 4.0  # of the largest of a dozen ends
FEWEST = 4.0  # stretches that tell of it
RIDGE = 1e-9  # of information

Whitened = tuple[
    Array, Array, NDArray[np.intp]
]  # residual (N,), its slopes (n, N), batch of each sample, which others may share
Beside = tuple[Array, Array]  # coefficients (m,), their scatter (m, batches)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """An extreme that a sensor did not pass, and how much more was flown while it stood there."""

    extreme: float
    beyond: float
    error: float

    def told(self, name: str, unit: str, attitude: str) -> str:
        """In words."""
        return (
            f"{name} goes no further than {self.extreme:.3g} {unit}, where {attitude} implies "
            f"{abs(self.beyond):.2g} ± {self.error:.1g} {unit} more: its sensor was at its "
            "limit, so no scale is given; leave these samples out"
        )


def standing(flights: Sequence[Flight], name: str) -> list[tuple[float, float, float]]:
    """Both extremes of a channel in all flights: threshold, value, reach from its middle."""
    own = [flight.own(name) for flight in flights]
    x, found = np.concatenate(own), []
    middle, noise = float(np.median(x)), float(np.median([white_noise(each) for each in own]))
    for extreme in (float(x.min()), float(x.max())):
        reach = extreme - middle
        width = max(NEAR * noise, CLOSE * abs(reach))
        if width < abs(reach) / 2:
            found.append((extreme - np.copysign(width, reach), extreme, reach))
    return found


def cut_off(parts: Sequence[Whitened], more: Sequence[Array]) -> tuple[Array, Array]:
    """Coefficients (m,) of regressors ``more`` [(m, N)] beside the known ones, and their errors."""
    value, scatter = beside(parts, more)
    return value, np.linalg.norm(scatter, axis=1)


def beside(parts: Sequence[Whitened], more: Sequence[Array], of: Sequence[Hashable] = ()) -> Beside:
    """Coefficients (m,) of regressors ``more`` [(m, N)] beside the known ones, and their scatter.

    What is known already is estimated anew, of each flight by itself: gains too. Parts ``of`` the
    same have it in common, as stretches of one record do. The scatter (m, batches) is what single
    stretches do to the coefficients: its rows' products are their covariance, and infinite where
    too few stretches tell.
    """
    together: dict[Hashable, list[int]] = {}
    for i in range(len(parts)):
        together.setdefault(of[i] if of else i, []).append(i)
    found = []
    for own in together.values():
        rows = np.hstack([np.vstack([more[i], parts[i][0]]) for i in own])
        X = np.hstack([parts[i][1] for i in own])
        left = rows - rows @ X.T @ _inverse(X @ X.T) @ X
        found.append((left[:-1], left[-1], np.hstack([parts[i][2] for i in own])))
    P = _inverse(np.sum([z @ z.T for z, _, _ in found], axis=0))
    value = P @ sum(z @ e for z, e, _ in found)
    last = max(int(batch[-1]) for _, _, batch in found) + 1
    scores = sum(_sums(z * (e - value @ z), batch, last) for z, e, batch in found)
    # One stretch alone may be anything; of few the scatter is hardly known: Student's quantile.
    weight = np.sum([_sums(z**2, batch, last) for z, _, batch in found], axis=0)
    many = weight.sum(axis=1) ** 2 / np.maximum((weight**2).sum(axis=1), 1e-300)
    wide = scipy.special.stdtrit(np.maximum(many - 1, 1.0), scipy.special.ndtr(CERTAIN)) / CERTAIN
    return value, np.where(many[:, None] < FEWEST, np.inf, wide[:, None] * (P @ scores))


def _inverse(H: Array) -> Array:
    size = np.sqrt(np.diag(H))
    size = np.where(size > 0, size, 1.0)
    scale = np.outer(size, size)
    return np.asarray(np.linalg.inv(H / scale + RIDGE * np.eye(len(H))) / scale)


def _sums(rows: Array, batch: NDArray[np.intp], last: int) -> Array:
    """Sums (m, batches) of rows (m, N) over each batch."""
    return np.array([np.bincount(batch, row, last) for row in rows])


def judged(extreme: float, reach: float, beyond: float, error: float) -> Limit | None:
    """The limit, if more was flown by what matters and is no noise."""
    outward = beyond * np.sign(reach)
    if outward < max(MUCH * abs(reach), SURE * error):
        return None
    return Limit(extreme=extreme, beyond=beyond, error=error)
