"""Sensors at the end of their range and sticks at their stops: samples that rest on an extreme."""

import numpy as np

from casid.arrays import Array
from casid.repeated_samples import least_step
from casid.samples import runs

CLIPPED = 5  # equal samples in a row at a channel's largest or smallest value
TURN = 3.0  # times as long as on the next digit that a channel is on its last where it turns
ROUNDING = 1e-9  # of a channel's range: differences of equal digits
LEVELS = 8  # of a channel that is counted in steps, of which an extreme is no chance


def longest_stop(values: Array, *, stick: bool) -> int:
    """Longest run of equal samples at an extreme of a channel (n,), if it is one of saturation."""
    # A stick rests where the pilot holds it, so only its stops count: 0, 1 and -1 of full travel.
    longest, step = 0, least_step(values)
    if not len(values) or np.ptp(values) == 0 or (not stick and np.ptp(values) < LEVELS * step):
        return 0
    for extreme in (values.min(), values.max()):
        if stick and abs(extreme) not in (0.0, 1.0):
            continue
        start, end = runs(values == extreme).T
        inside = (start > 0) & (end < len(values))  # trim at either end is no stop
        # Where a channel of few digits turns, it is on the next digit about as long.
        digit = np.abs(values - extreme) <= 1.5 * _digit(values)
        first, last = runs(digit).T
        of = np.searchsorted(first, start[inside], side="right") - 1
        length = (end - start)[inside]
        around = (last - first)[of] - length
        longest = max(longest, int(length[length > TURN * around].max(initial=0)))
    # A slower source is repeated at its extremes as elsewhere. A channel that is counted in coarse
    # steps rests on each of them, also on the last of a few.
    at = np.flatnonzero(np.diff(values, prepend=np.nan, append=np.nan))
    usual = 0 if stick else TURN * np.median(np.diff(at))
    if step and not stick:
        inner = (values[at[:-1]] > values.min()) & (values[at[:-1]] < values.max())
        usual = max(usual, np.diff(at)[inner].max(initial=0))
    return longest if longest >= max(CLIPPED, usual) else 0


def _digit(values: Array) -> float:
    """The least difference of a channel's samples: of one that is not rounded none to speak of."""
    moves = np.diff(np.unique(values))
    return float(moves[moves > ROUNDING * np.ptp(values)].min(initial=np.inf))


def saturated(record: str, channel: str, count: int, *, stick: bool) -> str:
    """What is said of a channel that stays on an extreme for so many samples."""
    return (
        f"{record}: {channel} stays at its extreme {'stop' if stick else 'value'} for {count} "
        "samples: saturated? Cut the record there or leave it out"
    )
