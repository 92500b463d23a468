"""How far windows of finite length bias a frequency response.

A window of length L smears the response over a bandwidth of 1/L and cuts off what began before it:
both leave an error that falls as 1/L². Two lengths of ratio √2 therefore differ by about as much as
the longer one is biased; what noise makes of that difference is known from their random errors.

A window of few periods resolves no mode of that frequency: the error then falls as 1/L at best,
and two windows may be biased alike. All pairs share their poles, so that what the median of
them shows holds for each at least.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, BoolArray
from casid.frequency.composite import window_weights
from casid.frequency.spectra import Conditioned

RATIO = np.sqrt(2)  # of the two lengths that are compared
FEW = 4.0  # periods in the longest window
SHORTER = 0.9  # as a share of a length: the other one of its pair at most


def leakage(
    parts: Sequence[Conditioned], usable: BoolArray, lengths: Sequence[float], omega: Array
) -> Array:
    """Bias of the composite's response relative to its magnitude, (K, ny, nu).

    It may be all in the gain or all in the phase [rad], so it counts in full for both. Smoothed
    over three neighbouring frequencies; zero where it is less than noise would show, and where a
    single length leaves nothing to compare. Lengths [s] and parts increase; ``usable`` is (windows,
    K), ``omega`` (K,) in rad/s.
    """
    L = np.array(lengths)
    pairs = {i: j for i in range(len(L)) if (j := _shorter(L, i)) is not None}
    W = window_weights(parts, usable)
    total = np.zeros(W.shape[1:])
    for w in range(len(L) if pairs else 0):
        i = w if w in pairs else min(pairs)
        total += W[w] * _squared(parts[i], parts[pairs[i]], L[i] / L[pairs[i]]) * (L[i] / L[w]) ** 4
    smooth = over_three(total)
    few = (omega * L[-1] / (2 * np.pi) < FEW)[:, None, None]
    least = np.maximum(smooth, np.median(smooth, axis=(1, 2), keepdims=True))
    smooth = np.where(few, (1 + RATIO) ** 2 * least, smooth)  # (RATIO² - 1)/(RATIO - 1)
    return np.asarray(np.sqrt(smooth))


def over_three(x: Array) -> Array:
    """Means (K, ...) over three neighbouring frequencies; the ends count twice for themselves."""
    padded = np.concatenate([x[:1], x, x[-1:]])
    return np.asarray((padded[:-2] + padded[1:-1] + padded[2:]) / 3)


def _shorter(lengths: Array, i: int) -> int | None:
    """Position of the length nearest to that of i over √2, if there is a shorter one."""
    found = np.flatnonzero(lengths < SHORTER * lengths[i])
    if not len(found):
        return None
    return int(found[np.argmin(np.abs(np.log(lengths[found] * RATIO / lengths[i])))])


def _squared(part: Conditioned, shorter: Conditioned, ratio: float) -> Array:
    """Squared relative bias of a window's response, less what its noise alone would show."""
    size = np.abs(part.response) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = np.abs(part.response - shorter.response) ** 2 / size - part.random_error**2
    return np.asarray(np.fmax(np.nan_to_num(difference, posinf=0.0), 0.0) / (ratio**2 - 1) ** 2)
