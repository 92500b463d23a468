"""Which few of several records contradict the others, by quadratic models of every one's cost.

At the estimate of all records the test of specification of `casid.shooting.hausman` asks each
against all others. A record of its own flight condition, trim or unit stands out; leave it out, and
the others agree. So the worst is left out until those that are left agree, and its fault is told
if they are more than half. Where a structure misses something records of other manoeuvres never
agree, whichever is left out: that is no record's fault, and nothing is said here.

Where a response depends on amplitude, and records were flown at two of them, each has others on
its side. Two tests ask all at once: those of the larger inputs against those of the smaller, and
the heterogeneity of W. G. Cochran, Biometrics 10 (1954), 101, of estimates that are vectors: with
e_i the scores at the truth, of covariance S_i, g_i = e_i - F_i Σ e, so

    Q = min_δ Σ (g_i + F_i δ)ᵀ S_i⁻¹ (g_i + F_i δ)

is χ² of as many degrees of freedom as records decide parameters, less those that all do.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from casid.arrays import Array
from casid.shooting.amplitudes import Sides
from casid.shooting.hausman import SAID, Disagreement, Source, disagreement
from casid.shooting.uncertainty import larger

RARELY = 1e-3  # of what widens errors
SELDOM = 1e-6  # chance of records that agree, all together; more if their noise is coloured
LITTLE = 0.1  # of the first excess over chance: what curvature leaves of it, no discord of others
RIVALS = 0.5  # of the largest excess: records of less are not asked whether they are to blame
SIDED = 0.5  # of the excess over chance of all records, in what parts them by their inputs' size
NONE = 1e-8  # of the information: rounding


class Discord(NamedTuple):
    """Records that contradict the others."""

    which: tuple[int, ...]  # the likeliest first
    any: bool | None  # without any one of them the others agree, without all of them; or do not
    off: Disagreement  # of the likeliest, or of all of them, from the others
    noise: Array  # (nf,) errors of the parameters by noise as it is in every record, of all
    seldom: float = SELDOM  # chance at which records that agree are said not to
    sides: Sides | None = None  # of the inputs' size, if those set them apart
    whole: "Heterogeneity | None" = None  # of all records, where that is clearer than of the one
    wider: Array | None = None  # (nf,) times what they were are errors stated, for this; if at all


class Heterogeneity(NamedTuple):
    """How far the estimates of single records scatter."""

    square: float  # χ² of as many degrees of freedom, if they agree
    freedom: int

    @property
    def chance(self) -> float:
        """By which records that agree scatter as much."""
        return float(chdtrc(self.freedom, self.square)) if self.freedom else 1.0


@dataclass(frozen=True, eq=False)
class Records:
    """Sources of one estimate, at it, in coordinates in which the information of all is I.

    With what is known beside them the gradients are nothing in all.
    """

    sources: Sequence[Source]
    root: Array  # (nf, k): the parameters by the coordinates

    @cached_property
    def each(self) -> dict[int, Disagreement]:
        """How far each is from all others."""
        return {i: self.against([i], self._all()) for i in self._all()}

    def against(self, which: Collection[int], kept: Sequence[int]) -> Disagreement:
        """How far some of those kept are from the others of them, at the estimate of the kept."""
        every, gone = np.eye(self.root.shape[1]), [i for i in self._all() if i not in kept]
        P = _inverse(every - self._sum(1, gone))
        V = every - self._sum(1, self._all()) + self._sum(2, kept)  # of the gradients
        g, F, S = (self._sum(part, which) for part in range(3))
        g = g + F @ P @ self._sum(0, gone)
        return disagreement(Source(g, F, S), P, P @ V @ P, self.root)

    def told(self, which: tuple[int, ...], any_: bool | None, off: Disagreement) -> Discord:
        """What is told of some, with the errors that noise makes."""
        scatter = self.root @ self._sum(2, self._all()) @ self.root.T
        return Discord(which, any_, off, np.sqrt(np.maximum(np.diag(scatter), 0.0)))

    @cached_property
    def heterogeneity(self) -> Heterogeneity:
        """Of all records, by Cochran's Q; errors of each no smaller than stated."""
        k = self.root.shape[1]
        q, freedom, b, H = 0.0, 0, np.zeros(k), np.zeros((k, k))
        for g, F, S in self.sources:
            values, axes = np.linalg.eigh(F)
            axes, own = axes[:, values > SAID], np.diag(values[values > SAID])
            weight = np.linalg.inv(larger(own, axes.T @ S @ axes))
            pull, share = axes.T @ g, axes.T @ F
            q, freedom = q + float(pull @ weight @ pull), freedom + len(own)
            b, H = b + share.T @ weight @ pull, H + share.T @ weight @ share
        values, axes = np.linalg.eigh(H)
        told = values > NONE * values.max(initial=0.0)
        square = q - float(np.sum((axes[:, told].T @ b) ** 2 / values[told]))
        return Heterogeneity(max(square, 0.0), max(freedom - int(told.sum()), 0))

    def parted(self, at: Sides | None) -> Disagreement | None:
        """How far records of smaller inputs are from those of larger, if both are there."""
        if at is None:
            return None
        return self.against(at.larger, [*at.smaller, *at.larger])

    def _all(self) -> list[int]:
        return list(range(len(self.sources)))

    def _sum(self, part: int, which: Collection[int]) -> Array:
        """Of gradients, informations or covariances; zeros of none."""
        k = self.root.shape[1]
        nothing = np.zeros(k) if part == 0 else np.zeros((k, k))
        return np.asarray(sum((self.sources[i][part] for i in which), nothing))


def discord(records: Records, *, white: bool, seldom: float = SELDOM) -> Discord | None:
    """The records that contradict the others, fewer than half; None if there are no such.

    Of two records both are named, if residuals are ``white``: what is left of each by an estimate
    of its own then is noise, and the structure misses nothing that might set them apart.
    """
    every = list(range(len(records.sources)))
    first = records.each
    worst = _worst(first, len(every), seldom)
    if worst is None:
        return None
    if len(every) == 2:
        return records.told((worst, 1 - worst), True, first[worst]) if white else None
    most = _excess(first[worst])
    rivals = [i for i in every if _excess(first[i]) >= RIVALS * most]
    blamed = [i for i in rivals if _agree(records, [k for k in every if k != i], most, seldom)]
    if blamed:
        blamed.sort(key=lambda i: -_excess(first[i]))
        return records.told((*blamed,), len(blamed) > 1, first[blamed[0]])
    out = [worst]
    while 2 * len(out) < len(every):
        kept = [i for i in every if i not in out]
        if _agree(records, kept, most, seldom):
            return records.told((*out,), False, records.against(out, every))
        found = {i: records.against([i], kept) for i in kept}
        out.append(max(kept, key=lambda i: _excess(found[i])))
    return None


def scattered(records: Records, seldom: float = SELDOM) -> Discord | None:
    """What is told of records that disagree where none, or no few, of them are to blame."""
    found, whole = records.each, records.heterogeneity
    worst = max(found, key=lambda i: _excess(found[i]))
    one = len(found) * found[worst].chance
    if min(one, whole.chance) >= seldom:
        return None
    told = records.told((worst,), None, found[worst])
    return told._replace(whole=whole if whole.chance < one else None)


def differ(records: Records, at: Sides | None) -> bool:
    """Whether records differ by more than noise, one, all together or by their inputs' size."""
    off = records.parted(at)
    return bool(off and off.chance < RARELY) or scattered(records, RARELY) is not None


def parted(records: Records, at: Sides | None, few: Discord | None) -> Discord | None:
    """What is told of records that their inputs' size sets apart, better than a few to blame do."""
    off = records.parted(at)
    if at is None or off is None or off.chance >= RARELY:
        return None
    whole = records.heterogeneity
    least = max(SIDED * (whole.square - whole.freedom), _excess(few.off) if few else 0.0)
    return records.told(at.larger, None, off)._replace(sides=at) if _excess(off) > least else None


def _agree(records: Records, kept: Sequence[int], most: float, seldom: float) -> bool:
    """Whether these agree, but for little beside an excess over chance."""
    found = {i: records.against([i], kept) for i in kept}
    worst = _worst(found, len(records.sources), seldom)
    return worst is None or _excess(found[worst]) < LITTLE * most


def _worst(found: dict[int, Disagreement], of: int, seldom: float = SELDOM) -> int | None:
    """Which disagrees most, if any does by more than chance."""
    if not any(each.chance < seldom / of for each in found.values()):
        return None
    return max(found, key=lambda i: _excess(found[i]))


def _excess(off: Disagreement) -> float:
    return off.square - off.freedom


def _inverse(F: Array) -> Array:
    """Inverse of a part (k, k) of the information I, nothing where there is none."""
    values, axes = np.linalg.eigh(F)
    known = values > NONE
    return np.asarray(axes[:, known] / values[known] @ axes[:, known].T)
