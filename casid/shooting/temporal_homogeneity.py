"""Whether records contradict each other, by their residuals in time.

Whitened residuals r̃ of every record, and their derivatives by the parameters, are transformed as
they stand, sample by sample:

    g = Σ_n s_nᵀ r̃_n = Σ_k w Re S_kᴴ R_k,

so that `casid.shooting.spectral_homogeneity` asks the same of them as of residuals on lines,
whatever the structure, the hold and the sampling. Noise that is stationary in time has a spectrum;
what initial states and biases take of its degrees of freedom is known by their derivatives.
Unlike there, the mean counts, where records have no biases.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.record import Record
from casid.shooting.amplitudes import sides
from casid.shooting.hausman import Source
from casid.shooting.independence import LEVEL as FOLLOWS
from casid.shooting.independence import followed
from casid.shooting.line_residuals import OnLines, as_real, halves
from casid.shooting.lines import HeldLines, Lines, kinds
from casid.shooting.outlying_records import Discord, Records, differ
from casid.shooting.spectral_homogeneity import Opposed, opposed
from casid.shooting.spectrum import leverages, noise_spectra
from casid.shooting.uncertainty import own_step, residual_covariance

QUIET = 1e-3  # of what each parameter moves: lines above, which hold less, are left out
SAME = 1e-7  # of the largest direction of initial states and biases: one that is another
LEAST = 8  # lines of a record, at least
MORE = 2.0  # times the variance of scores where the structure misses something
FEWEST = 4.0  # degrees of freedom of noise on a line that count: its neighbours tell of it, too

Pieces = Iterable[Iterable[Array]]


@dataclass(frozen=True, eq=False)
class Transformed(OnLines):
    """Residuals of one record, transformed."""

    own: Array  # (nf, nf) information of all lines
    rows: Array  # (K, 2 ny, nf)
    taken: Array  # (K, 2, ny, m)

    @property
    def F(self) -> Array:
        """See `casid.shooting.line_residuals.OnLines`."""
        return self.own

    @property
    def ends(self) -> Array:
        """See `casid.shooting.line_residuals.OnLines`."""
        return self.taken

    def portions(self, by: Array) -> Iterator[tuple[slice, Array]]:
        """See `casid.shooting.line_residuals.OnLines`; all lines at once."""
        yield slice(0, len(self.rows)), self.rows @ by

    @classmethod
    def leverages(cls, residuals: Sequence[Self], root: Array) -> list[Array]:
        """See `casid.shooting.line_residuals.OnLines`."""
        ones = np.eye(residuals[0].E.shape[1])
        return [
            each.shares(root, np.broadcast_to(ones, (len(each.E), *ones.shape))).sum(axis=2)
            for each in residuals
        ]

    @classmethod
    def scatter(cls, residuals: Sequence[Self], across: Sequence[ComplexArray]) -> Array:
        """See `casid.shooting.line_residuals.OnLines`."""
        pairs = zip(residuals, across, strict=True)
        return np.asarray(
            sum(np.tensordot(r.rows, as_real(S) @ r.rows, axes=([0, 1], [0, 1])) for r, S in pairs)
        )

    def beyond_mean(self) -> "Transformed":
        """The same without the first line, of no frequency."""
        return replace(self, E=self.E[1:], rows=self.rows[1:], taken=self.taken[1:])


def suspected(flown: Sequence[Record], own: Sequence[tuple[Array, Array]], root: Array) -> bool:
    """Whether records would differ by more than noise, if residuals were white.

    By the gradient and the information of each in the coordinates of a ``root`` (nf, k), as of
    `casid.shooting.scores.OwnScores`. If they are coloured, noise explains more.
    """
    return differ(Records([Source(g, F, F) for g, F in own], root), sides(flown))


def contradiction(
    flown: Sequence[Record],
    residuals: Sequence[Array],
    along: tuple[Pieces, Pieces],
    P: Array,
    F: Array,
    slope: Array,
    *,
    known: bool = False,
) -> tuple[Opposed, Discord | None] | None:
    """Records that contradict each other, and what is told of them.

    ``residuals`` (N, ny) are whitened, 0 where missing, the model less what was measured; ``along``
    are pieces of their derivatives by the parameters (n, ny, nf), and by what each record has of
    its own, (n, ny, m). ``P`` (nf, nf) is the inverse information, 0 of what is held, ``F`` the
    information and ``slope`` (nf,) that of the whole cost.

    Where residuals of all follow the inputs, what the structure misses may set records apart: of
    each more is allowed there, and nothing is told of all together. Where it is ``known`` that
    they do, they come whether anything is told or not.
    """
    parts = zip(flown, kinds(flown), residuals, *along, strict=True)
    lines, made, rest = zip(*(_transformed(*each) for each in parts), strict=True)
    ones, there = [np.ones(each.Y.shape) for each in lines], [(r != 0).mean(axis=0) for r in rest]
    white = len(residual_covariance(rest)) == 1
    found = opposed(lines, made, ones, P, slope, np.array(there), white=white, fewest=FEWEST)
    if not found.scatter:
        return (found, None) if known else None
    lines = tuple(_beyond_mean(each) for each in lines)
    made = tuple(each.beyond_mean() for each in made)
    left = [each.beyond_mean() for each in found.left if isinstance(each, Transformed)]
    taken = leverages(made, F)
    spectra = noise_spectra(lines, made, taken)
    found = found._replace(left=left)
    chances = [each.chance for each in followed(lines, made, taken, spectra)]
    if misses := min(chances) < FOLLOWS / len(chances):
        found = _loosened(found)
    told = found.discord(lines, spectra) if found.scatter else None
    if told is None or (misses and told.any is None):
        return (found, None) if known else None
    return found, told


def _loosened(found: Opposed) -> Opposed:
    """The same, with scores that scatter by more."""
    sources = [each._replace(S=MORE * each.S) for each in found.records.sources]
    return found._replace(records=replace(found.records, sources=sources))


def _transformed(
    record: Record, kind: int, r: Array, along: Iterable[Array], own: Iterable[Array]
) -> tuple[Lines, Transformed, Array]:
    """One record on its lines, and what its own estimate leaves of it, of one size in all outputs.

    That to first order.
    """
    S, T = (np.concatenate(list(pieces)) for pieces in (along, own))
    N, there = len(r), (r != 0).mean(axis=0)
    flat = S.reshape(-1, S.shape[2])
    g, F = flat.T @ r.ravel(), flat.T @ flat
    size = np.sqrt(np.diag(F))
    scale = 1 / np.where(size > 0, size, 1.0)
    left = (r - S @ (scale * own_step(scale * g, F * np.outer(scale, scale))[0])) * (r != 0)
    left /= np.sqrt(np.maximum(np.sum(left**2, axis=0), 1e-300))
    unit = 1 / np.sqrt(N * np.where(there > 0, there, 1.0))
    k = np.arange(N // 2 + 1)
    weight = np.where((k == 0) | (2 * k == N), 1.0, 2.0)
    X, Z = (np.fft.rfft(each, axis=0) for each in (S, _orthonormal(T)))
    power = weight[:, None] * np.sum(np.abs(X) ** 2, axis=1)
    beyond = 1 - np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), 1e-300)
    K = min(max(int(np.argmax((beyond <= QUIET).all(axis=1))) + 1, LEAST), len(k))
    E = -np.fft.rfft(r, axis=0)[:K] * unit
    size = np.sqrt(weight[:K, None]) * unit
    rows, taken = (halves(each[:K] * size[:, :, None]) for each in (X, Z))
    angle = 2 * np.pi * k[:K] / N
    z, omega = np.exp(1j * angle), angle / record.dt
    held, rows = HeldLines(record), rows.reshape(K, -1, rows.shape[3])
    lines = Lines(record, record.dt, kind, z, omega, weight[:K], E, there > 0, held)
    return lines, Transformed(E, g, F, rows, taken), left * np.sqrt(np.maximum(N * there, 1.0))


def _orthonormal(T: Array) -> Array:
    """Columns (N, ny, m) that span the same, orthonormal."""
    flat = T.reshape(T.shape[0] * T.shape[1], T.shape[2])
    size = np.linalg.norm(flat, axis=0)
    axes, sizes, _ = np.linalg.svd(flat / np.where(size > 0, size, 1.0), full_matrices=False)
    kept = axes[:, sizes > SAME * sizes.max(initial=0.0)]
    return np.asarray(kept.reshape(*T.shape[:2], kept.shape[1]))


def _beyond_mean(each: Lines) -> Lines:
    """Lines without the first, of no frequency."""
    parts = {name: getattr(each, name)[1:] for name in ("z", "omega", "weight", "Y")}
    return replace(each, **parts)
