"""Outputs that a model explains no better than their means do.

Residuals as large as an output moves are its noise, or what the model misses. Second differences
tell: those of white noise have six times its variance, whatever moves slowly beside it.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.display import listed

SHARE = 0.75  # of an output's variance about its means: residuals of more explain nothing
NOISY = 4.0  # times the variance from sample to sample: residuals of more are no white noise
FEWEST = 10  # samples of an output in a record, at least


def unexplained(outputs: Sequence[str], y: Sequence[Array], mean_square: Array) -> list[str]:
    """Outputs whose residuals are as large as they move and no noise, each in words.

    From samples (N, ny) of every record and the residuals' mean squares (ny,) over all.
    """
    found = []
    for name, size, parts in zip(outputs, mean_square, _by_channel(y), strict=True):
        spread, noise = spread_and_noise(parts)
        if size > SHARE * spread and size > NOISY * noise:
            left, moves, white = np.sqrt([size, spread, noise])
            beside = f"it moves by {moves:.2g}, its noise {white:.2g}"
            found.append(f"{name} (residuals of {left:.2g}; {beside})")
    return found


def spread_and_noise(parts: Sequence[Array]) -> tuple[float, float]:
    """Variance of a channel's parts, each about its mean, and at most that of its white noise.

    Missing samples are passed over; NaN if there are too few.
    """
    known = [each for part in parts if len(each := part[np.isfinite(part)]) >= FEWEST]
    if not known:
        return np.nan, np.nan
    spread = np.mean(np.concatenate([each - each.mean() for each in known]) ** 2)
    white = np.mean(np.concatenate([np.diff(each, 2) for each in known]) ** 2) / 6
    return float(spread), float(white)


def told(names: Sequence[str]) -> str:
    """Such outputs and what may be wrong, to be followed by a remedy."""
    return (
        f"nothing of {listed(names, 4)} is explained in the records of the fit: the residuals are "
        "not noise, and hardly smaller than deviations from the mean. The search may have ended "
        "far from the most likely parameters, the output may have another sign, unit or clock in "
        "the records than in the structure (kinematic_check may tell), or the structure lacks what "
        "moves it"
    )


def _by_channel(y: Sequence[Array]) -> list[list[Array]]:
    """Samples of every record by channel."""
    return [[each[:, i] for each in y] for i in range(y[0].shape[1])]
