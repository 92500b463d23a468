"""Delays about whole samples in the frequency domain, where the likelihood has a kink in them.

Inputs held in steps have it wherever a delay passes a sample, straight lines where they act
directly. A solve that ends beside one, or on one without success, is compared with the best on
either side, where all is smooth.
"""

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.free import Free
from casid.nlp import SolverOptions
from casid.shooting.delays import Delay, Heard, breaking, own_prices
from casid.shooting.frequency import ROUGH, SpectralOutcome, SpectralProgramme, search
from casid.shooting.lines import Lines
from casid.shooting.reduced import SPARE
from casid.shooting.spectral import SpectralResiduals
from casid.shooting.spectrum import NoiseSpectrum

LOG = logging.getLogger("casid")

EDGE = 1e-4  # of a stretch between kinks, from these to where a side of them begins
GAIN = 1e-4  # of log-likelihood, that makes the other side better
CLEAR = 1.0  # of log-likelihood, that is no matter of spectra
GLANCE = 12  # iterations with nothing held where outputs jump: they tell where else to look
MOVES = 30  # across kinks, at most; each makes the records likelier
FIRST = 25  # iterations of a solve before the sides are looked at: on a kink none is the last


def searched(
    free: Free,
    lines: list[Lines],
    options: SolverOptions,
    held: tuple[NoiseSpectrum, ...] | None = None,
) -> SpectralOutcome:
    """The best end of `search`, from the guess and across kinks near where that ended.

    A side is judged by the spectra of that end, and has its own estimated only if it is better; one
    that a solution lies within is not tried again. What ends beside the next kink goes on there.
    Where outputs jump the search begins between the whole samples about the guess, and goes on to
    those next to them, whatever is better; then also from where it leads when nothing is held.
    """
    brief = replace(options, max_iterations=min(FIRST, options.max_iterations))
    around = _between(free, lines, free.guess)
    first = search(SpectralResiduals(around, lines), free.guess, brief, held)
    left: list[Array] = []
    ends = [_descent(free, lines, brief, held, _released(first, free), left)]
    if around is not free:
        glance = replace(options, max_iterations=min(GLANCE, options.max_iterations))
        end = search(SpectralResiduals(free, lines), free.guess, glance, held)
        ends.append(_descent(free, lines, brief, held, end, [*left, ends[0].lam]))
    best = ends[-1] if _better(ends[-1], ends[0]) else ends[0]
    if not best.solution.success and options.max_iterations > FIRST:
        start = free.guess if around is free else best.lam
        bounded = SpectralResiduals(_between(free, lines, start), lines)
        return _released(search(bounded, start, options, held), free)
    return best


def _descent(
    free: Free,
    lines: list[Lines],
    options: SolverOptions,
    held: tuple[NoiseSpectrum, ...] | None,
    best: SpectralOutcome,
    left: list[Array],
) -> SpectralOutcome:
    """Where moves across kinks from an end lead; the solutions ``left`` on the way join these."""
    for _ in range(MOVES):
        outcome = best
        best = _beside(free, lines, options, outcome, held, left)
        if best is outcome:
            break
        if done(outcome):  # else the side it ended in, on a kink, may be the better one
            left.append(outcome.lam)
        LOG.info("output error, delays across whole samples: %.6g, better", likelihood(best))
    return best


def _beside(
    free: Free,
    lines: list[Lines],
    options: SolverOptions,
    outcome: SpectralOutcome,
    held: tuple[NoiseSpectrum, ...] | None,
    left: list[Array],
) -> SpectralOutcome:
    """The best of an outcome and the sides of kinks next to it, but those ``left`` before."""
    best, known = outcome, outcome.programme.spectra if done(outcome) else held
    judging = (
        options if known is held else replace(options, tolerance=max(ROUGH, options.tolerance))
    )
    for side in sides(free, lines, outcome.lam):
        if done(best) and not done(outcome):
            break  # from a solution the other sides are judged in no time
        if any(side.allows(each) for each in left):
            continue
        residuals = SpectralResiduals(side, lines)
        start = np.clip(outcome.lam, side.lower[free.index], side.upper[free.index])
        if done(outcome) and _no_better(outcome, residuals, start):
            continue
        end = search(residuals, start, judging, known, outcome if done(outcome) else None)
        if known is not held:
            if not _better(end, best if done(best) else outcome):
                continue
            end = search(residuals, end.lam, options)
        if _better(end, best):
            best = _released(end, free)
    return best


def _no_better(outcome: SpectralOutcome, residuals: SpectralResiduals, start: Array) -> bool:
    """Whether a side is a solution's own, or surely less likely, from where it begins (nf,).

    By the quadratic model there, and half as much more; see `casid.shooting.reduced.Reduced.least`.
    """
    if (start == outcome.lam).all():
        return True
    own = outcome.programme
    programme = SpectralProgramme(residuals, own.spectra, own.scales, own.before)
    state = programme.state(start / programme.scales)
    if state is None:
        return False
    unit = 1 / np.sqrt(np.maximum(np.diag(state.F), 1e-300))
    F, g = state.F * np.outer(unit, unit), state.g * unit
    gain = float(g @ np.linalg.lstsq(F, g, rcond=None)[0]) / 2  # the more, bounds left out
    least = programme.likelihood(start / programme.scales) - SPARE * gain
    return least > likelihood(outcome) + GAIN


def _better(end: SpectralOutcome, than: SpectralOutcome) -> bool:
    """Whether an end is better than another: more likely, or a solution where that is none.

    Clearly so, if only one of them is a solution: costs of spectra not settled hardly compare.
    """
    gain = likelihood(than) - likelihood(end)
    if done(end) == done(than):
        return gain > GAIN
    return gain > -CLEAR or not than.settled if done(end) else end.settled and gain > CLEAR


def done(outcome: SpectralOutcome) -> bool:
    """Whether this is a solution."""
    return outcome.solution.success and outcome.settled


def likelihood(outcome: SpectralOutcome) -> float:
    """Negative log-likelihood at the end."""
    return outcome.programme.likelihood(outcome.solution.x)


def _edges(ends: tuple[float, float]) -> Array:
    """Bounds of a parameter that keep it within the ends of a stretch."""
    edge = EDGE * (ends[1] - ends[0])
    return np.array([ends[0] + edge, ends[1] - edge])


def heard(free: Free, lines: list[Lines], lam: Array) -> Heard:
    """Delays at free values (nf,)."""
    function = SpectralResiduals(free, lines).matrices
    m = function(lam)
    return Heard(m.tau, m.dtau, function.linear_delays, function.direct)


def _delays(free: Free, lines: list[Lines], lam: Array) -> Iterator[Delay]:
    """Delays with kinks at free values (nf,)."""
    return breaking([each.record for each in lines], heard(free, lines, lam), lam)


def _between(free: Free, lines: list[Lines], lam: Array) -> Free:
    """Bounds that hold delays between whole samples where outputs jump; the same if none do."""
    bounded = free
    for delay in _delays(free, lines, lam):
        if delay.jump:
            bounded = next(_within(bounded, delay.a, _edges(delay.own()), jump=False), bounded)
    return bounded


def sides(free: Free, lines: list[Lines], lam: Array) -> Iterator[Free]:
    """Bounds on either side of the kinks next to free values (nf,).

    Where outputs jump the stretch of the delay is among them, with those below and above.
    """
    around = _between(free, lines, lam)
    for delay in _delays(free, lines, lam):
        i = free.index[delay.a]
        own = replace(around, lower=around.lower.copy(), upper=around.upper.copy())
        own.lower[i], own.upper[i] = free.lower[i], free.upper[i]
        for ends in delay.around():
            yield from _within(own, delay.a, _edges(ends), jump=delay.jump)


def _within(free: Free, a: int, ends: Array, jump: bool) -> Iterator[Free]:
    """The bounds with one free parameter between two values, if that leaves any room.

    Or none on its bound, where outputs ``jump``: what is there may belong to the side beyond.
    """
    i = free.index[a]
    lower, upper = free.lower.copy(), free.upper.copy()
    lower[i], upper[i] = np.clip(ends, lower[i], upper[i])
    if jump or lower[i] < upper[i]:
        yield replace(free, lower=lower, upper=upper)


def _released(end: SpectralOutcome, free: Free) -> SpectralOutcome:
    """The outcome under its own bounds; the ends of a side have no price."""
    last, solution = end.programme, end.solution
    found = solution.multipliers_x, solution.multipliers_g
    prices, ties = own_prices(found, last.residuals.free, free, end.lam, last.scales)
    solution = replace(solution, multipliers_x=prices, multipliers_g=ties)
    return replace(end, programme=last.released(free), solution=solution)
