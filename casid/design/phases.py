"""Phases of multisines with the least peak: of sticks, rates and responses over their limits.

The share s of its limit that a signal reaches, in any model at any sample, is linear in the cosines
and sines of the phases φ, so that

    minimise s   subject to   -s ≤ Σ_k a_ik cos φ_k + b_ik sin φ_k ≤ s

is a programme with exact derivatives, not convex, which IPOPT takes from Schroeder's phases. Of all
samples only those count at which a signal is large, and of their two sides that one; phases move a
little, then these are gathered anew (exchange: R. Hettich, K. O. Kortanek, SIAM Review 35, 1993).
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.design.optimise import Task
from casid.nlp import Problem, SolverOptions, solve

NEAR = 0.5  # share of the largest share from which a local extreme counts
MOST = 200  # extremes that count, the largest: the time of a programme grows with their square
EXCHANGES = 5
REACH = 0.4  # how far phases move in between [rad]
OPTIONS = SolverOptions(tolerance=1e-4, max_iterations=60)


def least_peak(task: Task, waves: Sequence[Array], phases: Array) -> Array:
    """Phases (n,), axis by axis, of the least peak found, no larger than at those given.

    ``waves`` (N, 2 n_j) are cosines, then sines, of each axis, as large as they are to be.
    """
    cut = np.cumsum([wave.shape[1] // 2 for wave in waves])[:-1]

    def flown(phases: Array) -> Array:
        parts = zip(waves, np.split(phases, cut), strict=True)
        return np.stack([w @ np.append(np.cos(p), -np.sin(p)) for w, p in parts], axis=1)

    best, now, places = phases, phases, list[tuple[int, int, int]]()
    least = float(task.peaks(flown(phases)).max())
    for _ in range(EXCHANGES):
        found = task.extremes(flown(now), NEAR)
        if not set(found) - set(places):
            break
        places = list({*places, *found})
        rows = task.rows(places)
        both = [np.split(rows[:, :, j] @ wave, 2, axis=1) for j, wave in enumerate(waves)]
        a, b = (np.concatenate([each[k] for each in both], axis=1) for k in range(2))
        now = _solved(a, -b, now)
        peak = float(task.peaks(flown(now)).max())
        if peak < least:
            best, least = now, peak
    return best


def _solved(a: Array, b: Array, phases: Array) -> Array:
    """Phases of the least |a cos φ + b sin φ| where it is largest, of the places (m,), (m, n) each.

    What is small at these phases does not count.
    """
    now = a @ np.cos(phases) + b @ np.sin(phases)
    top, most = float(np.abs(now).max()), np.argsort(-np.abs(now))[:MOST]
    a, b = (np.sign(now[most])[:, None] * each[most] for each in (a, b))
    m, n = a.shape
    x = ca.MX.sym("x", n + 1)
    share = ca.mtimes(ca.DM(a), ca.cos(x[:n])) + ca.mtimes(ca.DM(b), ca.sin(x[:n]))
    problem = Problem(
        x=x, f=x[n], g=share - x[n], x0=np.append(phases, 1.01 * top),
        lower_x=np.append(phases - REACH, 0.0), upper_x=np.append(phases + REACH, np.inf),
        lower_g=np.full(m, -np.inf), upper_g=np.zeros(m),
    )  # fmt: skip
    return solve(problem, OPTIONS, stage="phases").x[:n]
