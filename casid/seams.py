"""Where a record is of two flights, one after the other, though its time goes on.

An aircraft has no other attitude or speed from one sample to the next. Where several of them leap
at one instant, each several times as far as it ever does else, and stay there, two flights were
joined, or an estimator that computes them was set anew. Neither is flown.
"""

import numpy as np

from casid.arrays import Array
from casid.channels import AIR, ATTITUDES, VELOCITIES
from casid.display import instant, listed
from casid.record import Record

LEAPS = 4.0  # times the largest leap elsewhere
MOVES = 2.0  # times what it moves by from sample to sample elsewhere: a rate may begin at once
SEVERAL = 2  # channels that leap together
WIDTHS = (2, 5, 10, 20)  # samples of lines on either side: wider ones see through noise
NEAR = 1  # sample by which noise may move a leap
STAYS, LASTING = 5, 0.5  # samples on either side whose means are apart by so much of the leap
FEWEST = 50  # samples
LOST = 0.1  # share of missing samples from which on a channel is left out
APART = 1.5  # usual intervals: in a gap all may change


def seam(record: Record) -> tuple[float, tuple[str, ...]] | None:
    """Instant [s] of the second flight's first sample and what leaps there; None of one flight.

    It is the only one: of several flights in one record each has the others for what leaps else.
    """
    known = [name for name in (*ATTITUDES, *VELOCITIES, *AIR) if name in record.outputs]
    places = {name: _leap(record.t, record.channel(name)) for name in known}
    leaps = {name: k for name, k in places.items() if k is not None}
    if not leaps:
        return None
    k = int(np.median([*leaps.values()]))
    names = tuple(name for name, own in leaps.items() if abs(own - k) <= NEAR)
    return (float(record.t[k]), names) if len(names) >= SEVERAL else None


def seams_told(record: Record) -> list[str]:
    """What to say of a seam, in a list; none without."""
    if (found := seam(record)) is None:
        return []
    at, names = found
    return [
        f"{listed(names)} leap at {instant(at)} s, all at once, more than {LEAPS:g} times as far "
        "as anywhere else, and stay there: two flights joined, or an estimator set anew? Cut the "
        "record there"
    ]


def _leap(t: Array, x: Array) -> int | None:
    """The sample before which a channel (N,) leaps as nowhere else, and stays."""
    known = np.isfinite(x)
    if len(t) < FEWEST or known.mean() < 1 - LOST:
        return None
    x = np.interp(t, t[known], x[known])
    gaps: list[int] = np.flatnonzero(np.diff(t) > APART * np.median(np.diff(t))).tolist()
    for n in WIDTHS:
        leaps = np.abs(_leaps(x, n))
        for gap in gaps:
            leaps[max(gap - n, 0) : gap + n + 1] = 0.0
        k = int(np.argmax(leaps))
        others = np.delete(leaps, slice(max(k - n, 0), k + n + 1)).max(initial=0.0)
        means = np.convolve(x, np.full(n, 1 / n), mode="valid")
        moves = np.abs(np.delete(np.diff(means), slice(max(k - 2 * n, 0), k + n + 1)))
        least = max(LEAPS * others, MOVES * moves.max(initial=0.0))
        if leaps[k] > least and _stays(x, k, leaps[k]):
            return k + 1
    return None


def _leaps(x: Array, n: int) -> Array:
    """From every sample to the next (N - 1,), between lines through n samples on either side."""
    place = np.arange(n) - (n - 1) / 2
    line = 1 / n + place * (n / 2) / (place @ place)  # its end half a sample on, of n samples
    found = np.zeros(len(x) - 1)
    left = np.convolve(x, line[::-1], mode="valid")  # of samples k - n + 1 to k
    right = np.convolve(x, line, mode="valid")  # of samples k + 1 to k + n
    found[n - 1 : len(x) - n] = right[n:] - left[:-n]
    return found


def _stays(x: Array, k: int, leap: float) -> bool:
    """Whether a channel is elsewhere some samples after its leap: an outlier is not."""
    before, after = x[max(k + 1 - STAYS, 0) : k + 1], x[k + 1 : k + 1 + STAYS]
    return bool(abs(np.median(after) - np.median(before)) > LASTING * leap)
