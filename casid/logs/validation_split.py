"""Which stretches of a log judge, while the others identify."""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, BoolArray

KEPT = 4  # of as many stretches one is kept for validation
FLOWN = 0.25  # of what an input moves in the stretch that moves it most: it is flown


def unseen(moved: Sequence[Array]) -> list[int]:
    """Places of the stretches for validation, given how much each moves every input, (nu,).

    Every fourth, or the last, where these move what the others do. An output whose input rests in
    all that judges would not be judged: stretches that move what lacks are taken beside or instead,
    of all that can be spared the one that moves most inputs, the last of several. None can be that
    alone moves an input: what does not identify needs no verdict.
    """
    flown = np.array([np.asarray(each, dtype=float) for each in moved])
    largest = flown.max(axis=0)
    flies = (flown >= FLOWN * largest) & (largest > 0)
    n = len(flies)
    usual = list(range(KEPT - 1, n, KEPT)) or [n - 1]
    kept = [k for k in usual if _spared(flies, [*usual[: usual.index(k)], k])]
    while left := _best(flies, kept):
        kept.append(left[0])
    for k in list(kept):
        rest = [each for each in kept if each != k]
        if len(rest) >= len(usual) and (flies[rest].any(0) >= flies[kept].any(0)).all():
            kept = rest
    return sorted(kept) or usual


def _spared(flies: BoolArray, kept: Sequence[int]) -> bool:
    """Whether the stretches (n, nu) that are not kept still move every input."""
    rest = np.delete(flies, list(kept), axis=0)
    return bool(len(rest) and (rest.any(axis=0) >= flies.any(axis=0)).all())


def _best(flies: BoolArray, kept: Sequence[int]) -> list[int]:
    """The stretch to be kept next, in a list; [] where those kept lack nothing that can be had."""
    lacking = ~flies[list(kept)].any(axis=0)
    able = [
        k
        for k in range(len(flies))
        if k not in kept and (flies[k] & lacking).any() and _spared(flies, [*kept, k])
    ]
    return sorted(able, key=lambda k: (flies[k].sum(), k))[-1:]
