"""Skews whose likelihood is flat far from its peak: standard errors from there on to no skew.

How sharply a likelihood bends where it is largest tells a delay as long as that is short beside the
periods of what is flown. A channel that moves fast and little loses all that it says once it is a
fraction of a period late: its likelihood is as flat from there on as if nothing were known, with
peaks of noise, of which each bends sharply. So the error of a skew τ is no less than asks for

    (τ/σ)² = min Σ ε²|τ=0 − Σ ε² + (τ/s)²,

the likelihood ratio of no skew, all else adjusted to it, with a prior deviation s: where a parabola
holds that is its own σ.
The signed root of it is normal where the estimate is not: O. E. Barndorff-Nielsen, D. R. Cox,
Inference and Asymptotics, chapter 6.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from casid.arrays import Array
from casid.consistency.errors_in_variables import Corrected, Eliminated, Normal
from casid.consistency.voting import SKEW

TOLD = 3.0  # standard errors from which on a skew is looked at
ROUNDS = 3  # steps of all else
HELD = 1e-6  # s: the prior's deviation of a skew that stays
LONGEST = 0.125  # s: the largest step of a skew

Block = tuple[str, int, Array]  # equation, record; residual, slopes by own unknowns (1 + own, N)


class Problem(Protocol):
    """Residuals of a reconstruction, and their normal equations."""

    def blocks(self, x: Array, own: Array) -> list[Block]:
        """Residuals and slopes at these unknowns."""

    def whitened(self, blocks: Sequence[Block]) -> list[Block]:
        """Innovations and slopes in their standard deviations."""

    def normal(self, parts: Sequence[Block], own: Array) -> tuple[Normal, list[Eliminated]]:
        """Normal equations of all records and of each."""


def ratio_errors(
    problem: Problem,
    parts: Sequence[Block],
    x: Array,
    own: Array,
    reach: Array,
    errors: Array,
    skews: Sequence[int],
) -> Array:
    """Standard errors (n,) of unknowns, those of ``skews`` no less than likelihood ratios ask for.

    ``x`` (n,) and ``own`` (records, m) are the estimates, ``parts`` the innovations there, and
    ``reach`` (n,) the deviations of priors.
    """
    found, asis = errors.copy(), _size(parts)
    for i in skews:
        if abs(x[i]) > max(SKEW, TOLD * errors[i]):
            ratio = max(_least(problem, x, own, reach, i, skews) - asis, 0.0)
            found[i] = max(errors[i], abs(x[i]) / np.sqrt(ratio + (x[i] / reach[i]) ** 2))
    return found


def _least(
    problem: Problem, x: Array, own: Array, reach: Array, i: int, skews: Sequence[int]
) -> float:
    """Sum of squares of the innovations with no skew ``i``, all else adjusted."""
    held, now, least = reach.copy(), x.copy(), np.inf
    held[i], now[i] = HELD, 0.0
    start, prior = now, Normal(np.diag(held**-2.0), np.zeros(len(x)))
    for _ in range(1 + ROUNDS):
        parts = problem.whitened(problem.blocks(now, own))
        least = min(least, _size(parts))
        plain, flown = problem.normal(parts, own)
        step = Corrected(plain + prior.after(now - start), plain * 0.0).step()
        step[[*skews]] = np.clip(step[[*skews]], -LONGEST, LONGEST)
        now, own = now + step, own + [one.step(step) for one in flown]
    return least


def _size(parts: Sequence[Block]) -> float:
    return sum(float(rows[0] @ rows[0]) for *_, rows in parts)
