"""Delays about whole numbers of samples, where the likelihood is not smooth in them.

With inputs held in steps the states have a kink in τ whenever a step passes a sample, and with a
direct term the output has a jump there; with straight lines and a direct term it has a kink. Within
the whole samples on both sides all is analytic. So an estimate near one, or any where the output
jumps, is compared with the best on the other side. A parameter that delays several inputs has the
whole samples of all of them for ends of its stretches.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, BoolArray
from casid.errors import warn
from casid.free import Free
from casid.record import Record
from casid.shooting.programme import Programme
from casid.shooting.sensitivity import Evaluator

NEAR = 0.1  # of the way from break to break: a kink that noise may have held an estimate on
ROUNDING = 1e-9  # of a price, that a tie does not take over
EDGE = 1e-6  # of the least such way: on a whole sample


class Heard(NamedTuple):
    """The delays that inputs are heard with at some λ."""

    tau: Array  # (nu,) [s]
    slopes: Array  # (nf, nu) their derivatives by λ
    linear: BoolArray  # (nu,) whether these are the same at every λ
    direct: BoolArray  # (nu,) whether outputs may feel the input at once

    @property
    def own(self) -> BoolArray:
        """Inputs (nu,) that one free parameter alone delays, and linearly."""
        return np.asarray(self.linear & (np.count_nonzero(self.slopes, axis=0) == 1))


@dataclass(frozen=True, eq=False)
class Delay:
    """A free parameter v, now v_0, that alone delays inputs, and where the likelihood breaks in it.

    It does where one of them is any whole number n of samples of a record late:

        τ_j + τ'_j (v - v_0) = n h,    so that    v = v_0 - τ_j / τ'_j + n h / τ'_j.

    All values and stretches are the parameter's.
    """

    a: int  # its place among the free parameters
    value: float  # v_0
    inputs: np.ndarray  # (n,)
    tau: Array  # (n,)
    slope: Array  # (n,)
    first: Array  # (m,) where the breaks of every input and record begin, n = 0,
    apart: Array  # (m,) how far they are apart,
    rising: BoolArray  # (m,) and whether the delay grows with the parameter
    jump: bool  # outputs jump there

    @property
    def edge(self) -> float:
        """From here to a break this is on it."""
        return EDGE * float(self.apart.min())

    def stretch(self, value: float) -> tuple[float, float]:
        """The breaks next to a value, the lower first."""
        below = np.floor((value - self.first) / self.apart)
        low, high = (self.first + n * self.apart for n in (below, below + 1))
        return float(low.max()), float(high.min())

    def own(self) -> tuple[float, float]:
        """The stretch between breaks that the parameter is in, or begins."""
        return self.stretch(self.value + self.edge)

    def around(self) -> Iterator[tuple[float, float]]:
        """Its own stretch and those across breaks nearby, or across any where outputs jump."""
        low, high = self.own()
        near = self.near()
        below, above = near < (low + high) / 2, near > (low + high) / 2
        if self.jump or below.any():
            yield self.stretch(low - self.edge)
        if self.jump or len(near):
            yield low, high
        if self.jump or above.any():
            yield self.stretch(high + self.edge)

    def near(self) -> Array:
        """Breaks so near that noise may hold an estimate on them."""
        found = self._nearest(self.value)
        return np.asarray(found[np.abs(self.value - found) < NEAR * self.apart])

    def _nearest(self, value: float) -> Array:
        """The break (m,) of every kind that is nearest to a value."""
        n = np.round((value - self.first) / self.apart)
        return np.asarray(self.first + n * self.apart)

    def held(self, free: Free) -> bool:
        """Whether a break is so near, between bounds, that it may hold a solve."""
        i, near = free.index[self.a], self.near()
        inside = (free.lower[i] < near - self.edge) & (near + self.edge < free.upper[i])
        return bool(inside.any())

    def reaches(self, ends: tuple[float, float], bounds: tuple[float, float]) -> bool:
        """Whether a stretch beyond the parameter's bounds ends on one of these, and holds it.

        A step that is whole samples late is felt at its sample: where outputs jump, a break belongs
        to what is less late.
        """
        for end, bound, below in ((ends[1], bounds[0], True), (ends[0], bounds[1], False)):
            on = np.abs(self._nearest(bound) - bound) < self.edge
            if self.jump and abs(end - bound) < self.edge and (self.rising[on] == below).all():
                return True
        return False

    def late(self, ends: tuple[float, float]) -> Array:
        """Delays (n,) of the inputs in the middle of a stretch."""
        return self.tau + self.slope * (sum(ends) / 2 - self.value)


def held(programme: Programme, lam: Array) -> tuple[Free, Array]:
    """Bounds, and delays within, that hold what makes outputs jump in its stretch; as neighbours'.

    Nothing is held, and all is NaN, where no output jumps.
    """
    free, within = programme.free, np.full(programme.evaluator.nu, np.nan)
    for delay in _delays(programme, lam):
        if delay.jump:
            low, high = delay.own()
            below = delay.stretch(low - delay.edge)
            for ends in ((low, high), below):  # the last on the upper bound
                found = _within(programme, free, within, delay, ends)
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
        own = delay.own()
        done = solved and delay.value - own[0] >= delay.edge
        for ends in delay.around():
            if done and ends == own:
                continue
            found = _within(programme, *calm(programme, lam, but=delay.a), delay, ends)
            if found:
                yield Side(*found, delay.a)


def calm(programme: Programme, lam: Array, but: int | None = None) -> tuple[Free, Array]:
    """As `held`, with all delays near a kink in their stretch, lest it hold the solve.

    All ``but`` that of one free parameter.
    """
    free, within = held(programme, lam)
    for delay in _delays(programme, lam):
        if delay.a == but or delay.jump or not delay.held(programme.free):
            continue
        if found := _within(programme, free, within, delay, delay.own()):
            free, within = found
    return free, within


def stuck(programme: Programme, lam: Array) -> bool:
    """Whether a kink within the bounds may hold a solve that ends at free values (nf,)."""
    return any(each.held(programme.free) for each in _delays(programme, lam))


def _within(
    programme: Programme,
    free: Free,
    within: Array,
    delay: Delay,
    ends: tuple[float, float],
) -> tuple[Free, Array] | None:
    """Bounds and delays within, of a delay between two more; None if that leaves no room."""
    i, room = programme.free.index[delay.a], EDGE * (ends[1] - ends[0])
    given = float(programme.free.lower[i]), float(programme.free.upper[i])
    lower, upper = np.clip(ends, *given)
    if upper - lower < room:
        if not delay.reaches(ends, given):
            return None
        lower, upper = np.clip((lower - room, upper + room), *given)
    middle, bounds = within.copy(), (free.lower.copy(), free.upper.copy())
    middle[delay.inputs] = delay.late(ends)
    bounds[0][i], bounds[1][i] = lower, upper
    return replace(free, lower=bounds[0], upper=bounds[1]), middle


def _delays(programme: Programme, lam: Array) -> Iterator[Delay]:
    """The delays in which the likelihood breaks at free values (nf,)."""
    records = [r for r in programme.evaluator.layout.records if r.equidistant]
    return breaking(records, heard(programme.evaluator, lam), lam)


def heard(evaluator: Evaluator, lam: Array) -> Heard:
    """Delays at free values (nf,)."""
    m = evaluator.matrices(lam)
    return Heard(m.tau, m.tau_lam.T, evaluator.matrices.linear_delays, evaluator.direct)


def warn_of_jumps(records: Sequence[Record], delays: Heard) -> None:
    """Warn of delays in which outputs jump where bounds of no parameter hold them.

    There are too many jumps where a record is sampled unevenly; and whole samples of what several
    parameters delay, or one not linearly, are no values of one.
    """
    felt, names = delays.direct & delays.slopes.any(axis=0), records[0].inputs
    stepped = [record for record in records if record.hold == "zoh"]
    for record in stepped:
        if felt.any() and not record.equidistant:
            warn(
                f"record {record.name!r} is sampled unevenly and outputs feel "
                f"{', '.join(names[j] for j in np.flatnonzero(felt))}, held in "
                "steps, at once: the likelihood jumps in the delay where a step passes a sample, "
                "so that its estimate may be many standard errors off; resample() the record, or "
                "hold the delay and compare costs"
            )
            break
    loose = np.flatnonzero(felt & ~delays.own)
    if stepped and len(loose):
        warn(
            f"outputs feel {', '.join(names[j] for j in loose)}, held in steps, at once, after a "
            "delay that depends on several free parameters, or not linearly on one: the likelihood "
            "jumps at whole samples of it, between which nothing holds it, so that estimates may "
            "be many standard errors off; give the delay one parameter of its own, or hold those "
            "it depends on and compare costs"
        )


def breaking(records: Iterable[Record], delays: Heard, lam: Array) -> Iterator[Delay]:
    """Of free parameters, at values (nf,), the delays in which the likelihood breaks.

    It does at whole samples of inputs held in steps, and of those that outputs feel directly.
    """
    records = list(records)
    steps = sorted({float(f"{record.dt:.9g}") for record in records})  # not each rounding of one
    stepped = any(record.hold == "zoh" for record in records)
    broken = delays.own & (delays.direct | stepped)
    for a, slope in enumerate(delays.slopes):
        inputs = np.flatnonzero(slope * broken)
        if len(inputs) and steps:
            tau, rate, value = delays.tau[inputs], slope[inputs], float(lam[a])
            apart = np.divide.outer(steps, np.abs(rate))
            first, rising = np.tile(value - tau / rate, len(steps)), np.tile(rate > 0, len(steps))
            jump = stepped and bool(delays.direct[inputs].any())
            yield Delay(a, value, inputs, tau, rate, first, apart.ravel(), rising, jump)


def own_prices(
    prices: tuple[Array, Array], bounded: Free, free: Free, lam: Array, scales: Array
) -> tuple[Array, Array]:
    """Multipliers of bounds (nf,) and constraints (m,) without those of the ends of a stretch.

    These are no own bounds. What an end bears beside a tie that holds the same parameter is the
    tie's: only their sum is told. ``lam`` (nf,) are values, multipliers those of these in units of
    ``scales`` and of the constraints over their sizes.
    """
    bounds, constraints = prices
    same = (bounded.lower == free.lower)[free.index], (bounded.upper == free.upper)[free.index]
    own = np.asarray(bounds * np.where(bounds < 0, *same))
    gone, (lower, upper) = bounds - own, free.constraint_limits
    ties = np.flatnonzero(lower == upper)
    if not gone.any() or not len(ties):
        return own, constraints
    slopes = (free.constraint_slopes(lam) * scales / free.constraint_sizes[:, None])[ties]
    more = np.linalg.lstsq(slopes.T, gone, rcond=None)[0]
    if np.abs(slopes.T @ more - gone).max() > ROUNDING * np.abs(gone).max():
        return own, constraints
    all_of_them = constraints.copy()
    all_of_them[ties] += more
    return own, all_of_them
