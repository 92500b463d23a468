"""Delays about whole numbers of samples, where the likelihood is not smooth in them.

With inputs held in steps the states have a kink in τ whenever a step passes a sample, and with a
direct term the output has a jump there; with straight lines and a direct term it has a kink. Within
the whole samples on both sides all is analytic. So an estimate near one, or any where the output
jumps, is compared with the best on the other side.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.free import Free
from casid.shooting.programme import Programme

NEAR = 0.1  # of a sampling interval: a kink that noise may have held an estimate on
EDGE = 1e-6  # of a sampling interval: on a whole sample


def neighbours(programme: Programme, lam: Array, solved: bool) -> Iterator[tuple[Free, Array]]:
    """Stretches between whole samples that a delay of its own parameter may belong to as well.

    Bounds that hold the parameter in the stretch, and for `Evaluator.within` the delay in its
    middle (nu,), NaN for other inputs. ``lam`` (nf,) is where a solve has ended, ``solved`` with
    success: its own stretch need not be tried.
    """
    m, free = programme.evaluator.matrices(lam), programme.free
    for a in range(len(free.index)):
        heard = np.flatnonzero(m.tau_lam[:, a])
        if not len(heard) or np.count_nonzero(m.tau_lam[heard]) > len(heard):
            continue
        steps, jump = _broken(programme, heard, m.D, m.D_lam)
        slope, tau = m.tau_lam[heard[0], a], m.tau[heard[0]]
        for low, high in _stretches(tau, steps, jump, solved):
            edges = lam[a] + (np.array([low, high]) - tau) / slope
            i = free.index[a]
            lower, upper = np.clip(np.sort(edges), free.lower[i], free.upper[i])
            if upper > lower or (jump and free.lower[i] == upper):
                within = np.full(len(m.tau), np.nan)
                within[heard] = (low + high) / 2
                upper = max(upper, lower + EDGE * (high - low) / abs(slope))
                bounds = free.lower.copy(), free.upper.copy()
                bounds[0][i], bounds[1][i] = lower, upper
                yield replace(free, lower=bounds[0], upper=bounds[1]), within


def _broken(
    programme: Programme, heard: np.ndarray, D: Array, D_lam: Array
) -> tuple[list[float], bool]:
    """Sampling intervals whose multiples break the likelihood in τ, and whether it jumps."""
    direct = bool(D[:, heard].any() or D_lam[:, heard].any())
    records = [r for r in programme.evaluator.layout.records if r.equidistant]
    steps = {r.dt for r in records if direct or r.hold == "zoh"}
    return sorted(steps), direct and any(r.hold == "zoh" for r in records)


def _stretches(
    tau: float, steps: list[float], jump: bool, solved: bool
) -> Iterator[tuple[float, float]]:
    """Stretches to try: across the whole samples near τ, and τ's own if that is not solved."""
    if not steps:
        return
    tiny = EDGE * min(steps)
    low, high = _stretch(tau + tiny, steps)
    below, above = (jump or abs(tau - edge) < NEAR * min(steps) for edge in (low, high))
    if below:
        yield _stretch(low - tiny, steps)
    if above:
        yield _stretch(high + tiny, steps)
    if (below or above) and (not solved or tau - low < tiny):
        yield low, high


def _stretch(tau: float, steps: list[float]) -> tuple[float, float]:
    """The multiples of the sampling intervals next to τ."""
    whole = [np.floor(tau / h) for h in steps]
    low = max(n * h for n, h in zip(whole, steps, strict=True))
    return float(low), float(min((n + 1) * h for n, h in zip(whole, steps, strict=True)))
