"""Delays about whole numbers of samples, where the likelihood is not smooth in them.

With inputs held in steps the states have a kink in τ whenever a step passes a sample, and with a
direct term the output has a jump there; with straight lines and a direct term it has a kink. Within
the whole samples on both sides all is analytic. So an estimate near one, or any where the output
jumps, is compared with the best on the other side.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, BoolArray
from casid.errors import warn
from casid.free import Free
from casid.record import Record
from casid.shooting.programme import Programme
from casid.shooting.sensitivity import Evaluator
from casid.shooting.unknowns import FilterMatrices

NEAR = 0.1  # of a sampling interval: a kink that noise may have held an estimate on
EDGE = 1e-6  # of a sampling interval: on a whole sample


@dataclass(frozen=True, eq=False)
class Delay:
    """A free parameter that is the delay of inputs of its own, and where the likelihood breaks."""

    a: int  # its place among the free parameters
    heard: np.ndarray  # the inputs
    tau: float
    slope: float  # of the delay by the parameter
    steps: list[float]  # sampling intervals whose multiples break the likelihood
    jump: bool  # outputs jump there

    def own(self) -> tuple[float, float]:
        """The stretch between whole samples that the delay is in, or begins."""
        return stretch(self.tau + EDGE * min(self.steps), self.steps)

    def edges(self, value: float, ends: tuple[float, float]) -> Array:
        """Values (2,) of the parameter, now ``value``, for these delays, the lower first."""
        return np.sort(value + (np.array(ends) - self.tau) / self.slope)

    def held(self, free: Free, value: float) -> bool:
        """Whether a whole sample is so near, between bounds, that it may hold a solve.

        ``value`` is the parameter's.
        """
        i, edge = free.index[self.a], EDGE * min(self.steps)
        for kink in self.own():
            if abs(self.tau - kink) < NEAR * min(self.steps):
                low, high = self.edges(value, (kink - edge, kink + edge))
                if free.lower[i] < low and high < free.upper[i]:
                    return True
        return False


def held(programme: Programme, lam: Array) -> tuple[Free, Array]:
    """Bounds, and delays within, that hold what makes outputs jump in its stretch; as neighbours'.

    Nothing is held, and all is NaN, where no output jumps.
    """
    free, within = programme.free, np.full(programme.evaluator.nu, np.nan)
    for delay in _delays(programme, lam):
        if delay.jump:
            low, high = delay.own()
            below = stretch(low - EDGE * min(delay.steps), delay.steps)
            for ends in ((low, high), below):  # the last on the upper bound
                found = _within(programme, free, within, delay, lam, ends)
                if found:
                    free, within = found
                    break
    return free, within


class Side(NamedTuple):
    """Bounds that hold a free parameter ``a`` in a stretch, for `Evaluator.within` (nu,) in it."""

    free: Free
    delays: Array
    a: int


def neighbours(programme: Programme, lam: Array, solved: bool) -> Iterator[Side]:
    """Stretches between whole samples that a delay of its own parameter may belong to as well.

    The delays for `Evaluator.within` are in the middle of their stretch, NaN for other inputs but
    those that stay `calm`. ``lam`` (nf,) is where a solve has ended, ``solved`` with success: its
    own stretch need not be tried.
    """
    for delay in _delays(programme, lam):
        for ends in _stretches(delay, solved):
            found = _within(programme, *calm(programme, lam, but=delay.a), delay, lam, ends)
            if found:
                yield Side(*found, delay.a)


def calm(programme: Programme, lam: Array, but: int | None = None) -> tuple[Free, Array]:
    """As `held`, with all delays near a kink in their stretch, lest it hold the solve.

    All ``but`` that of one free parameter.
    """
    free, within = held(programme, lam)
    for delay in _delays(programme, lam):
        if delay.a == but or delay.jump or not delay.held(programme.free, lam[delay.a]):
            continue
        if found := _within(programme, free, within, delay, lam, delay.own()):
            free, within = found
    return free, within


def stuck(programme: Programme, lam: Array) -> bool:
    """Whether a kink within the bounds may hold a solve that ends at free values (nf,)."""
    return any(each.held(programme.free, lam[each.a]) for each in _delays(programme, lam))


def _within(
    programme: Programme,
    free: Free,
    within: Array,
    delay: Delay,
    lam: Array,
    ends: tuple[float, float],
) -> tuple[Free, Array] | None:
    """Bounds and delays within, of a delay between two more; None if that leaves no room."""
    i, given = programme.free.index[delay.a], programme.free
    lower, upper = np.clip(delay.edges(lam[delay.a], ends), given.lower[i], given.upper[i])
    if not (upper > lower or (delay.jump and given.lower[i] == upper)):
        return None
    middle, bounds = within.copy(), (free.lower.copy(), free.upper.copy())
    middle[delay.heard] = sum(ends) / 2
    upper = max(upper, lower + EDGE * (ends[1] - ends[0]) / abs(delay.slope))
    bounds[0][i], bounds[1][i] = lower, upper
    return replace(free, lower=bounds[0], upper=bounds[1]), middle


def _delays(programme: Programme, lam: Array) -> Iterator[Delay]:
    """The delays in which the likelihood breaks at free values (nf,)."""
    m = programme.evaluator.matrices(lam)
    records = [r for r in programme.evaluator.layout.records if r.equidistant]
    return breaking(records, m.tau, m.tau_lam.T, _direct(m))


def _direct(m: FilterMatrices) -> BoolArray:
    """Inputs (nu,) that outputs feel at once."""
    return np.asarray(m.D.any(axis=0) | m.D_lam.any(axis=(0, 2)))


def warn_of_jumps(evaluator: Evaluator, lam: Array) -> None:
    """Warn of delays in which outputs jump at so many places that any may hold an estimate."""
    m = evaluator.matrices(lam)
    felt = np.flatnonzero(_direct(m) & m.tau_lam.any(axis=1))
    for record in evaluator.layout.records:
        if record.hold == "zoh" and not record.equidistant and len(felt):
            names = ", ".join(record.inputs[j] for j in felt)
            warn(
                f"record {record.name!r} is sampled unevenly and outputs feel {names}, held in "
                "steps, at once: the likelihood jumps in the delay where a step passes a sample, "
                "so that its estimate may be many standard errors off; resample() the record, or "
                "hold the delay and compare costs"
            )
            return


def breaking(
    records: Iterable[Record], tau: Array, slopes: Array, direct: BoolArray
) -> Iterator[Delay]:
    """Of the delays (nu,), by their derivatives (nf, nu), those in which the likelihood breaks.

    It does at whole samples of inputs held in steps, and of those that outputs feel directly.
    """
    for a, slope in enumerate(slopes):
        heard = np.flatnonzero(slope)
        if not len(heard) or np.count_nonzero(slopes[:, heard]) > len(heard):
            continue
        felt = bool(direct[heard].any())
        kinked = [record for record in records if felt or record.hold == "zoh"]
        steps = sorted({float(f"{record.dt:.9g}") for record in kinked})  # not each rounding of one
        jump = felt and any(record.hold == "zoh" for record in kinked)
        if steps:
            yield Delay(a, heard, tau[heard[0]], slope[heard[0]], steps, jump)


def own_prices(prices: Array, bounded: Free, free: Free) -> Array:
    """Multipliers (nf,) of bounds; the ends of a stretch, which are no own bounds, have none."""
    same = (bounded.lower == free.lower)[free.index], (bounded.upper == free.upper)[free.index]
    return np.asarray(prices * np.where(prices < 0, *same))


def _stretches(delay: Delay, solved: bool) -> Iterator[tuple[float, float]]:
    """Stretches to try: across the whole samples near τ, and τ's own if that is not solved."""
    low, high = delay.own()
    tau, steps, least = delay.tau, delay.steps, min(delay.steps)
    below, above = (delay.jump or abs(tau - edge) < NEAR * least for edge in (low, high))
    if below:
        yield stretch(low - EDGE * least, steps)
    if above:
        yield stretch(high + EDGE * least, steps)
    if (below or above) and (not solved or tau - low < EDGE * least):
        yield low, high


def stretch(tau: float, steps: list[float]) -> tuple[float, float]:
    """The multiples of the sampling intervals next to τ."""
    whole = [np.floor(tau / h) for h in steps]
    low = max(n * h for n, h in zip(whole, steps, strict=True))
    return float(low), float(min((n + 1) * h for n, h in zip(whole, steps, strict=True)))
