"""Several clocks, each late by so much: which of them are one, and by how much others are apart."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from casid.arrays import Array
from casid.channels import FORCES, RATES

SIGNIFICANT = 4.0  # standard errors, of the largest of some twenty, known from few stretches
DISAGREE = 3.5  # standard errors between clocks of a group
SKEW = 0.01  # s: what matters

Late = tuple[float, float]  # by so much [s], its standard error


def significant(late: float, error: float, surely: float = SIGNIFICANT) -> bool:
    """Whether a delay [s] matters and is no noise."""
    return abs(late) > max(SKEW, surely * error)


def mean(lates: Sequence[Late]) -> Late:
    """Of several, by their errors."""
    values, errors = np.transpose(lates)
    weights = 1 / np.maximum(errors, 1e-6) ** 2
    return float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)


def shared(
    late: Array, C: Array, names: Sequence[tuple[str, ...]], votes: Sequence[float]
) -> list[list[int]]:
    """Which of them agree: those with most ``votes`` first, at a draw the first of them.

    They have ``names``, and are ``late`` (n,) with the covariance ``C`` (n, n). Those of which too
    little is told for a vote go with their kind, or with most, unless they are apart from all.
    """

    def order(one: Sequence[int]) -> tuple[float, int]:
        return -round(sum(votes[i] for i in one), 6), one[0]

    sure = np.sqrt(np.diag(C)) <= SKEW
    rest, found = [*map(int, np.flatnonzero(sure))], []
    while rest:
        sets = [[*each] for n in range(len(rest), 0, -1) for each in combinations(rest, n)]
        sets.sort(key=order)
        found.append(next(one for one in sets if _agree(late, C, names, one)))
        rest = [i for i in rest if i not in found[-1]]
    for i in map(int, np.flatnonzero(~sure)):
        near = [group for group in found if not significant(*apart(late, C, [i], group), DISAGREE)]
        if near:
            near.sort(key=lambda one: (-sum(_alike(names[i], names[j]) for j in one), *order(one)))
            near[0].append(i)
        else:
            found.append([i])
    return sorted(map(sorted, found), key=order)


def _alike(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether both are rates, or specific forces."""
    return any({*one, *other} <= {*kind} for kind in (RATES, FORCES))


def _agree(late: Array, C: Array, names: Sequence[tuple[str, ...]], among: Sequence[int]) -> bool:
    """Whether neither one nor all rates or all forces among them are apart from the rest."""
    kinds = [[j for j in among if _alike(names[i], names[j])] for i in among]
    for part in (*([i] for i in among), *kinds):
        others = [i for i in among if i not in part]
        if part and others and significant(*apart(late, C, part, others), DISAGREE):
            return False
    return True


def apart(late: Array, C: Array, one: Sequence[int], other: Sequence[int]) -> Late:
    """How much later one clock is than another [s], by generalised least squares, and its error."""
    both = [*one, *other]
    # With a third of what matters of each by itself, so that nothing is known too well.
    P = np.linalg.inv(C[np.ix_(both, both)] + (SKEW / 3) ** 2 * np.eye(len(both)))
    X = np.column_stack([np.ones(len(both)), np.arange(len(both)) < len(one)])
    weights = np.linalg.solve(X.T @ P @ X, X.T @ P)[1]
    return float(weights @ late[both]), float(np.sqrt(weights @ C[np.ix_(both, both)] @ weights))
