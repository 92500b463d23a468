"""Instants of a record that do not increase: what became of them, and what mends that."""

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray

LASTING = 16  # samples between places where time goes back, from which on they are records
FEW = 4  # samples on either side without which nobody knows whether a clock stays behind
UNLIKE = 0.05  # of the samples, at most, that have an instant of the one before and other values
RARE = 0.05  # of the steps, at most, that go ahead where time runs backward
BEHIND = 0.5  # of the usual interval: what stays further behind is displaced
CROWDED = 1.5  # times as many samples as usual where two stretches overlap: they are of two clocks
SINGLE = 4.0  # usual intervals of an overlap, which too few samples fill to be counted


def stamp(t: Array, k: int) -> str:
    """One of the instants (N,) [s], with the digits that tell it from its neighbours."""
    steps = np.diff(t)
    finest = float(np.min(steps[steps > 0], initial=1.0))
    digits = np.ceil(np.log10(max(np.abs(t[k]) / finest, 1.0))) + 2
    return f"{t[k]:.{int(np.clip(digits, 6, 17))}g}"


def check_time(record: str, t: Array, values: Array) -> None:
    """Refuse time that is none, goes back, or stands still for samples with other values.

    ``values`` are those of all channels, (N, n).
    """
    if not np.isfinite(t).all():
        k = int(np.flatnonzero(~np.isfinite(t))[0])
        raise ValueError(f"record {record!r}: t[{k}] = {t[k]}; time must be finite")
    steps, known = np.diff(t), np.isfinite(values)
    moves, differ = bool((steps > 0).any()), known[1:] & known[:-1] & (values[1:] != values[:-1])
    stands = (steps == 0) & (differ.any(axis=1) | (not moves))
    if moves and stands.sum() <= UNLIKE * len(t):
        stands[:] = False  # the first is kept, as of samples close together
    back = np.flatnonzero((steps < 0) | stands)
    if back.size:
        k = int(back[0]) + 1
        raise ValueError(
            f"record {record!r}: time does not increase at sample {k} "
            f"({stamp(t, k - 1)} s, then {stamp(t, k)} s); {_remedy(t, values, back, stands)}"
        )


def _remedy(t: Array, values: Array, back: NDArray[np.intp], stands: BoolArray) -> str:
    """What became of time that goes ``back`` after these samples, and what to do."""
    steps = np.diff(t)
    if (steps < 0).any() and (steps > 0).sum() <= RARE * (steps < 0).sum():
        return "it runs backward: reverse the order of the rows"
    if told := _repeated(t, values):
        return told
    if (steps > 0).any() and not stands.any():
        usual = float(np.median(steps[steps > 0]))
        more = f", and at {len(back) - 1} places more" * (len(back) > 1)
        parts = np.diff([0, *(back + 1), len(t)])
        # Samples out of order are passed by soon after; a second flight begins where the first did.
        begins = t[back + 1] < t[0] + LASTING * usual
        if parts.min() >= LASTING and begins.all() and (t[back + 1 + LASTING // 2] < t[back]).all():
            return (
                "a second flight, or what a logger wrote after it started again, seems to stand "
                f"below the first: cut the file there{more}, and read each part as its own record"
            )
        late = np.array([behind(t, int(b), usual) for b in back])
        if (late > BEHIND * usual).all():
            return (
                f"the clock seems to have stepped back by {late[0]:.3g} s and to stay there. Cut "
                f"the file there{more}, and read each part as its own record, or add {late[0]:.3g} "
                f"s to all instants that follow{' (at each place its own)' * (len(back) > 1)}"
            )
    again = "sort the samples and drop repeated ones"
    if stands.any():
        again += f", or write time with more digits if it is rounded ({stands.sum()} samples)"
    return again


def behind(t: Array, b: int, usual: float) -> float:
    """By how much what follows sample b stays behind what led to it [s]; 0 of rows out of order."""
    n = min(LASTING, b + 1, len(t) - b - 1)
    overlap = float(t[b] - t[b + 1])
    within = np.sum((t >= t[b + 1]) & (t <= t[b]))
    if n < FEW or (overlap > SINGLE * usual and within < CROWDED * (overlap / usual + 1)):
        return 0.0  # each has its own place: they need sorting only
    even = usual * np.arange(n)
    before, after = (
        float(np.median(part - even)) for part in (t[b + 1 - n : b + 1], t[b + 1 :][:n])
    )
    return before + n * usual - after


def _repeated(t: Array, values: Array) -> str:
    """What to do about rows that stand twice, cell by cell; "" where time would not increase."""
    rows = np.nan_to_num(np.column_stack([t, values]), nan=np.finfo(float).max)
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    kept = np.sort(first)
    if len(kept) == len(t) or not (np.diff(t[kept]) > 0).all():
        return ""
    again = np.setdiff1d(np.arange(len(t)), kept)
    n = int(np.argmax(np.append(np.diff(again) > 1, True))) + 1
    begin, end = int(again[0]), int(again[n - 1])
    own = int(first[which.reshape(-1)[begin]])
    those = (
        f"samples {begin} to {end} are those from {own} on" if n > 1 else f"sample {begin} is {own}"
    )
    return (
        f"{len(again)} of {len(t)} rows repeat others cell by cell ({those} once more): drop the "
        "repeated rows"
    )
