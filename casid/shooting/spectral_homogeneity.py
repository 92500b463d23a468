"""Whether records contradict each other, on the lines of their transforms.

`casid.shooting.outlying_records` asks each record by the slope g of its part of the likelihood and
by its information F. The covariance of g is that of noise of the spectra that are left by an
estimate of each record alone, to first order: those that all leave together may hold the
contradiction itself.
They are of records of one kind together, every output of its own size in each. Of few lines they
are less known: scores count for less by as much as Student's t is wider.

A delay may stay on a break of its likelihood, as samples held make one: slopes of records do not
balance along it then, and nothing is asked there.

Scores of whole records also tell how estimates scatter from flight to flight, where that is by more
than noise, as `casid.bounds.robust` has it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space
from scipy.special import ndtri, stdtrit

from casid.arrays import Array, ComplexArray
from casid.shooting.amplitudes import Sides, sides
from casid.shooting.hausman import Source
from casid.shooting.independence import LEVEL as FOLLOWS
from casid.shooting.independence import Followed, followed
from casid.shooting.line_residuals import OnLines
from casid.shooting.lines import Lines
from casid.shooting.outlying_records import (
    RARELY,
    Discord,
    Records,
    differ,
    discord,
    parted,
    scattered,
)
from casid.shooting.scores import RecordScores, left_out
from casid.shooting.spectrum import (
    NoiseSpectrum,
    coherent,
    degrees,
    kinds,
    leftover,
    leverages,
    shared,
    smoothed,
)
from casid.shooting.uncertainty import coordinates, larger, own_step

HELD = 0.01  # standard errors by which an estimate is short of where slopes balance
ROUNDS = 3  # of sizes and shapes of noise, each by the other
FEWEST = 1.0  # degrees of freedom of noise, that count, lest a factor be infinite


class Opposed(NamedTuple):
    """Records of one estimate on their lines, in coordinates in which the information is I."""

    records: Records
    inverse: Array  # (k, nf) of their root
    noise: Array  # (nf,) errors of the parameters by noise as it is in every record
    left: Sequence[OnLines]  # what an estimate of each record alone would leave, to first order
    sides: Sides | None  # of the inputs' size
    scores: RecordScores  # of whole records by the free parameters, and their information
    wider: Array | None = None  # (nf,) times what they were are errors stated, if at all

    @property
    def scatter(self) -> bool:
        """Whether they differ by more than noise, one, all together or by their inputs' size."""
        return differ(self.records, self.sides)

    def widened(self, covariance: Array) -> Array:
        """A covariance (nf, nf) of the estimates, no less than scores of whole records scatter."""
        told, root = np.isfinite(covariance), self.records.root
        K = self.inverse @ np.where(told, covariance, 0.0) @ self.inverse.T
        g = np.array([left_out(each.F, 0.5) @ each.g for each in self.records.sources])
        return np.where(told, covariance + root @ (larger(K, g.T @ g) - K) @ root.T, covariance)

    def discord(self, lines: Sequence[Lines], spectra: Sequence[NoiseSpectrum]) -> Discord | None:
        """What sets them apart: a few against the others, the size of their inputs, or neither.

        Of two, where nothing that their own estimates leave follows the inputs.
        """
        pairs = zip(lines, self.left, strict=True)
        chances = [each.chance for own, r in pairs for each in _followed(own, r, spectra)]
        few = discord(self.records, white=min(chances) > FOLLOWS / len(chances), seldom=RARELY)
        found = parted(self.records, self.sides, few) or few or scattered(self.records, RARELY)
        return found and found._replace(noise=self.noise, seldom=RARELY, wider=self.wider)


def opposed(
    lines: Sequence[Lines],
    residuals: Sequence[OnLines],
    powers: Sequence[Array],
    P: Array,
    slope: Array | None = None,
    there: Array | None = None,
    *,
    white: bool = False,
    fewest: float = FEWEST,
) -> Opposed:
    """Records at an estimate whose inverse information is P (nf, nf), 0 of what is held.

    ``powers`` (K, ny) are the spectra by which residuals are weighed, ``slope`` (nf,) is that of
    the whole cost, nothing unless given. Residuals and derivatives stand for whole records; of
    their samples (records, ny) shares may be ``there``, which alone tell. Noise that is ``white``
    is of one power on all lines. Of its power ``fewest`` degrees of freedom tell at least.
    """
    root, inverse = coordinates(P)
    own = [(root.T @ each.g, root.T @ each.F @ root) for each in residuals]
    steps = [-root @ own_step(*each)[0] for each in own]
    alone = [_alone(*each) for each in zip(lines, residuals, powers, steps, strict=True)]
    taken = [leverages([each], each.F)[0] for each in residuals]
    left = leftover(lines, residuals, taken)
    plain = [replace(r, E=r.E / np.sqrt(power)) for r, power in zip(alone, powers, strict=True)]
    shapes, sizes = _levels(lines, plain, left, white=white)
    even = [replace(r, E=r.E / np.sqrt(size)) for r, size in zip(plain, sizes, strict=True)]
    across = coherent(lines, even, shapes, left)
    share = np.ones(sizes.shape) if there is None else there
    noise = [shape * size for shape, size in zip(shapes, sizes * share, strict=True)]
    covariances = [
        root.T @ _scatter(*each) @ root for each in zip(residuals, across, noise, strict=True)
    ]
    ones = np.ones(root.shape[1])
    wider = ones if white else _wider(lines, residuals, noise, left, root, fewest)
    Z = _balanced(root, slope)
    sources = [
        Source(Z.T @ g, Z.T @ F @ Z, Z.T @ (wider[:, None] * S * wider) @ Z)
        for (g, F), S in zip(own, covariances, strict=True)
    ]
    errors = np.sqrt(np.diag(root @ np.sum(covariances, axis=0) @ root.T))
    g, F = (np.array(each) for each in zip(*own, strict=True))
    scores = g @ inverse, inverse.T @ F @ inverse
    flown = sides([each.record for each in lines])
    return Opposed(Records(sources, root @ Z), Z.T @ inverse, errors, alone, flown, scores)


def _balanced(root: Array, slope: Array | None) -> Array:
    """Coordinates (k, m), orthonormal, along which slopes balance."""
    k = root.shape[1]
    if slope is None or np.linalg.norm(root.T @ slope) < HELD:
        return np.eye(k)
    size = np.linalg.norm(root, axis=1)
    held = np.abs(slope) * size > HELD / len(size)
    return np.asarray(null_space(root[held] / size[held, None]))


def _alone(lines: Lines, residual: OnLines, power: Array, step: Array) -> OnLines:
    """The residuals that a record leaves after a step of free values (nf,), to first order."""
    real, imaginary = np.split(residual.moved(step[:, None])[..., 0], 2, axis=1)  # weighed
    moved = (real + 1j * imaginary) / np.sqrt(lines.weight)[:, None]
    return replace(residual, E=residual.E - moved * np.sqrt(power))


def _levels(
    lines: Sequence[Lines], residuals: Sequence[OnLines], left: Sequence[Array], *, white: bool
) -> tuple[list[Array], Array]:
    """Power of noise, shapes (K, ny) of records of one kind times sizes (ny,) of each.

    Sizes are beside the shapes, in turn: records hold other bands, in which a spectrum that falls
    has other means.
    """
    shapes: list[Array] = [np.ones(each.Y.shape) for each in lines]
    sizes = np.array([_sizes(*each) for each in zip(lines, residuals, shapes, left, strict=True)])
    for _ in range(0 if white else ROUNDS):
        even = [replace(r, E=r.E / np.sqrt(size)) for r, size in zip(residuals, sizes, strict=True)]
        shapes = _shapes(lines, even, left)
        parts = zip(lines, residuals, shapes, left, strict=True)
        sizes = np.array([_sizes(*each) for each in parts])
    return shapes, sizes


def _sizes(lines: Lines, residual: OnLines, shape: Array, left: Array) -> Array:
    """Mean power (ny,) of a record's residuals beside a shape (K, ny); 1 of what it has not."""
    power = lines.weight @ (np.abs(residual.E) ** 2 / shape)
    size = power / np.maximum(left.sum(axis=0), 1.0)
    return np.where(size > 0, size, 1.0)


def _shapes(
    lines: Sequence[Lines], residuals: Sequence[OnLines], left: Sequence[Array]
) -> list[Array]:
    """Power of residuals on the lines of every record, (K, ny), of records of a kind together."""
    found: dict[int, Array] = {}
    for mine, at, places in kinds(lines):
        omega = np.concatenate([lines[r].omega for r in mine])
        shape = np.ones((len(at), len(lines[0].seen)))
        for i in range(shape.shape[1]):
            power = [lines[r].weight * np.abs(residuals[r].E[:, i]) ** 2 for r in mine]
            freedom = [left[r][:, i] * lines[r].seen[i] for r in mine]
            if np.concatenate(freedom).any():
                parts = np.concatenate(power), np.concatenate(freedom)
                shape[:, i] = np.maximum(smoothed(omega, *parts, at), 1e-300)
        found |= shared(shape, mine, places)
    return [found[r] for r in range(len(lines))]


def _scatter(residual: OnLines, S: ComplexArray, power: Array) -> Array:
    """Covariance (nf, nf) of the score of a record by noise of a power (K, ny), correlated so."""
    size = np.sqrt(power)
    total = residual.scatter([residual], [size[:, :, None] * S * size[:, None]])
    return (total + total.T) / 2


def _followed(lines: Lines, r: OnLines, spectra: Sequence[NoiseSpectrum]) -> list[Followed]:
    """What of one record's residuals follows its inputs."""
    return followed([lines], [r], leverages([r], r.F), spectra)


def _wider(
    lines: Sequence[Lines],
    residuals: Sequence[OnLines],
    noise: Sequence[Array],
    left: Sequence[Array],
    root: Array,
    fewest: float,
) -> Array:
    """By what scores (k,) scatter more for what of noise is known from few degrees of freedom.

    Student's t where the test asks, by the normal distribution. By the power of ``noise`` (K, ny)
    in every record's weighed residuals.
    """
    shares, free = [], np.zeros(root.shape[1])
    for each, own, power, rest in zip(lines, residuals, noise, left, strict=True):
        sizes = np.stack([power, power * rest / each.weight[:, None]], axis=1)
        found = own.shares(root, sizes)
        shares.append(found[:, 0])
        free += found[:, 1].sum(axis=0)
    share = free / np.maximum(sum(each.sum(axis=0) for each in shares), 1e-300)
    freedom = np.maximum(degrees(lines, shares) * share, fewest)
    chance = RARELY / len(lines)
    return np.asarray(stdtrit(freedom, chance / 2) / ndtri(chance / 2))
