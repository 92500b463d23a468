"""Delays about whole samples in the frequency domain, where the likelihood has a kink in them.

Inputs held in steps have it wherever a delay passes a sample, straight lines where they act
directly. A solve that ends beside one, or on one without success, is compared with the best on
either side, where all is smooth.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.free import Free
from casid.nlp import SolverOptions
from casid.shooting.frequency import ROUGH, SpectralOutcome, SpectralProgramme, search
from casid.shooting.lines import Lines
from casid.shooting.spectral import SpectralResiduals
from casid.shooting.spectrum import NoiseSpectrum

NEAR = 0.1  # of a sampling interval: a kink that noise may have held an estimate on
EDGE = 1e-4  # of a sampling interval, from a kink to where a side of it begins
GAIN = 1e-4  # of log-likelihood, that makes the other side better
MOVES = 12  # across kinks, at most
FIRST = 40  # iterations of a solve before the sides are looked at: on a kink none is the last


def searched(
    free: Free,
    lines: list[Lines],
    options: SolverOptions,
    held: tuple[NoiseSpectrum, ...] | None = None,
) -> SpectralOutcome:
    """The best end of `search`, from the guess and across kinks near where that ended.

    A side is judged by the spectra of that end, and has its own estimated only if it is better; one
    that a solution lies within is not tried again. What ends beside the next kink goes on there.
    """
    brief = replace(options, max_iterations=min(FIRST, options.max_iterations))
    best = search(SpectralResiduals(free, lines), free.guess, brief, held)
    first = best.lam
    for _ in range(MOVES):
        outcome = best
        best = _beside(free, lines, options, outcome, held)
        if best is outcome:
            break
    if not best.solution.success and options.max_iterations > FIRST:
        return search(SpectralResiduals(free, lines), first, options, held)
    return best


def _beside(
    free: Free,
    lines: list[Lines],
    options: SolverOptions,
    outcome: SpectralOutcome,
    held: tuple[NoiseSpectrum, ...] | None,
) -> SpectralOutcome:
    """The best of an outcome and the sides of kinks next to it."""
    best, known = outcome, outcome.programme.spectra if done(outcome) else held
    judging = (
        options if known is held else replace(options, tolerance=max(ROUGH, options.tolerance))
    )
    for side in sides(free, lines, outcome.lam):
        residuals = SpectralResiduals(side, lines)
        start = np.clip(outcome.lam, side.lower[free.index], side.upper[free.index])
        if done(outcome) and (start == outcome.lam).all():
            continue
        end = search(residuals, start, judging, known, outcome if done(outcome) else None)
        if known is not held:
            if not _better(end, outcome):
                continue
            end = search(residuals, end.lam, options)
        if _better(end, best):
            best = _released(end, free)
    return best


def _better(end: SpectralOutcome, than: SpectralOutcome) -> bool:
    """Whether an end is a solution, and another is none or less likely."""
    return done(end) and (not done(than) or likelihood(end) < likelihood(than) - GAIN)


def done(outcome: SpectralOutcome) -> bool:
    """Whether this is a solution."""
    return outcome.solution.success and outcome.settled


def likelihood(outcome: SpectralOutcome) -> float:
    """Negative log-likelihood at the end."""
    return outcome.programme.likelihood(outcome.solution.x)


def sides(free: Free, lines: list[Lines], lam: Array) -> Iterator[Free]:
    """Bounds on either side of the kinks next to free values (nf,)."""
    m = SpectralResiduals(free, lines).matrices(lam)
    D, slopes = m.blocks[3], m.slopes[:, m.nx :, m.nx :]
    for a, slope in enumerate(m.dtau):
        heard = np.flatnonzero(slope)
        if not len(heard) or np.count_nonzero(m.dtau[:, heard]) > len(heard):
            continue
        direct = bool(D[:, heard].any() or slopes[:, :, heard].any())
        kinked = [each.record for each in lines if direct or each.record.hold == "zoh"]
        jump = direct and any(record.hold == "zoh" for record in kinked)
        steps = {float(f"{record.dt:.9g}") for record in kinked}  # not each rounding of one
        tau = m.tau[heard[0]]
        for h in sorted(steps):
            whole = round(tau / h)
            if abs(tau / h - whole) < NEAR:
                for low in (whole - 1, whole):
                    ends = h * np.array([low + EDGE, low + 1 - EDGE])
                    edges = np.sort(lam[a] + (ends - tau) / slope[heard[0]])
                    yield from _within(free, a, edges, jump)


def _within(free: Free, a: int, ends: Array, jump: bool) -> Iterator[Free]:
    """The bounds with one free parameter between two values, if that leaves any room.

    Or none on its bound, where outputs ``jump``: what is there belongs to the side beyond.
    """
    i = free.index[a]
    lower, upper = free.lower.copy(), free.upper.copy()
    lower[i], upper[i] = np.clip(ends, lower[i], upper[i])
    if lower[i] < upper[i] or (jump and upper[i] == free.lower[i]):
        yield replace(free, lower=lower, upper=upper)


def _released(end: SpectralOutcome, free: Free) -> SpectralOutcome:
    """The outcome under its own bounds; the ends of a side have no price."""
    last, solution = end.programme, end.solution
    side = last.residuals.free
    same = (side.lower == free.lower)[free.index], (side.upper == free.upper)[free.index]
    prices = solution.multipliers_x
    prices = prices * np.where(prices < 0, same[0], same[1])
    residuals = SpectralResiduals(free, last.residuals.lines)
    programme = SpectralProgramme(residuals, last.spectra, last.scales)
    return replace(end, programme=programme, solution=replace(solution, multipliers_x=prices))
