"""Which few of several records contradict the others, by quadratic models of every one's cost.

At the estimate of all records the test of specification of `casid.shooting.hausman` asks each
against all others. A record of its own flight condition, trim or unit stands out; leave it out, and
the others agree. So the worst is left out until those that are left agree, and its fault is told
if they are more than half. Where a structure misses something records of other manoeuvres never
agree, whichever is left out: that is no record's fault, and nothing is said here.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from casid.arrays import Array
from casid.shooting.hausman import Disagreement, Source, disagreement

SELDOM = 1e-6  # chance of records that agree, all together; more if their noise is coloured
LITTLE = 0.1  # of the first excess over chance: what curvature leaves of it, no discord of others
RIVALS = 0.5  # of the largest excess: records of less are not asked whether they are to blame
NONE = 1e-8  # of the information: rounding


class Discord(NamedTuple):
    """Records that contradict the others."""

    which: tuple[int, ...]  # the likeliest first
    any: bool | None  # without any one of them the others agree, without all of them; or do not
    off: Disagreement  # of the likeliest, or of all of them, from the others
    noise: Array  # (nf,) errors of the parameters by noise as it is in every record, of all


class Records(NamedTuple):
    """Sources of one estimate, at it, in coordinates in which the information of all is I.

    With what is known beside them the gradients are nothing in all.
    """

    sources: Sequence[Source]
    root: Array  # (nf, k): the parameters by the coordinates

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

    def agree(self) -> bool:
        """Whether nothing is beyond chance."""
        return self.worst() is None

    def worst(self, seldom: float = SELDOM) -> int | None:
        """Which disagrees most with all others, if any does by more than chance."""
        found = {i: self.against([i], self._all()) for i in self._all()}
        return _worst(found, len(found), seldom)

    def _all(self) -> list[int]:
        return list(range(len(self.sources)))

    def _sum(self, part: int, which: Collection[int]) -> Array:
        """Of gradients, informations or covariances; zeros of none."""
        k = self.root.shape[1]
        nothing = np.zeros(k) if part == 0 else np.zeros((k, k))
        return np.asarray(sum((self.sources[i][part] for i in which), nothing))


def discord(records: Records, *, white: bool) -> Discord | None:
    """The records that contradict the others, fewer than half; None if there are no such.

    Of two records both are named, if residuals are ``white``: what is left of each by an estimate
    of its own then is noise, and the structure misses nothing that might set them apart.
    """
    every = list(range(len(records.sources)))
    first = {i: records.against([i], every) for i in every}
    worst = _worst(first, len(every))
    if worst is None:
        return None
    if len(every) == 2:
        return records.told((worst, 1 - worst), True, first[worst]) if white else None
    most = _excess(first[worst])
    rivals = [i for i in every if _excess(first[i]) >= RIVALS * most]
    blamed = [i for i in rivals if _agree(records, [k for k in every if k != i], most)]
    if blamed:
        blamed.sort(key=lambda i: -_excess(first[i]))
        return records.told((*blamed,), len(blamed) > 1, first[blamed[0]])
    out = [worst]
    while 2 * len(out) < len(every):
        kept = [i for i in every if i not in out]
        if _agree(records, kept, most):
            return records.told((*out,), False, records.against(out, every))
        found = {i: records.against([i], kept) for i in kept}
        out.append(max(kept, key=lambda i: _excess(found[i])))
    return None


def scattered(records: Records) -> Discord | None:
    """What is told of records that disagree where none, or no few, of them are to blame."""
    worst = records.worst()
    if worst is None:
        return None
    every = range(len(records.sources))
    return records.told((worst,), None, records.against([worst], every))


def _agree(records: Records, kept: Sequence[int], most: float) -> bool:
    """Whether these agree, but for little beside an excess over chance."""
    found = {i: records.against([i], kept) for i in kept}
    worst = _worst(found, len(records.sources))
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
