"""Rounds of estimates that creep or swing, accelerated: Anderson's mixing.

D. G. Anderson, J. ACM 12 (1965), 547; H. F. Walker and P. Ni, SIAM J. Numer. Anal. 49 (2011), 1715.
What a structure misses moves with the estimate, and what it weighs with it: then a round moves the
estimates nearly as far as the round before, and those after it would as well.
"""

import numpy as np

from casid.arrays import Array

SLOW = 0.5  # of the move of the round before: rounds that shrink by less are accelerated
WORSE = 1.5  # of that move: past a kink or a bend, where earlier rounds tell nothing
BACK = 5  # rounds that this looks back
LEAST = 1e-8  # of the squares of secants' lengths in the largest, that tells of a direction


class Secants:
    """Where rounds lead; ``used`` once they are slow, and from then on."""

    def __init__(self) -> None:
        self.used = False
        self._begins: list[Array] = []
        self._ends: list[Array] = []

    def ahead(self, begin: Array, end: Array, F: Array) -> Array:
        """Where to begin after a round from one to other values (n,), of information F (n, n).

        At its end; but where secants through the last rounds see no move, if these are slow and
        lead there.
        """
        self._begins = [*self._begins[-BACK:], begin]
        self._ends = [*self._ends[-BACK:], end]
        ends = np.array(self._ends)
        moves = ends - np.array(self._begins)
        sizes = np.sqrt(np.einsum("ka,ab,kb->k", moves, F, moves))
        if len(sizes) > 1 and not sizes[-1] < WORSE * sizes[-2]:
            self._begins, self._ends = [begin], [end]
            return end
        self.used |= len(sizes) > 1 and bool(sizes[-1] > SLOW * sizes[-2])
        if not self.used or len(sizes) == 1:
            return end
        changes = np.diff(moves, axis=0)
        share = np.linalg.lstsq(changes @ F @ changes.T, changes @ F @ moves[-1], rcond=LEAST)[0]
        beyond = -share @ np.diff(ends, axis=0)
        if beyond @ F @ moves[-1] < -(sizes[-1] ** 2):  # behind the begin: rounds lead away from it
            return end
        return np.asarray(end + beyond)
