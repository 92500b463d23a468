"""Residual spectra from the residuals themselves, and what weights by them are worth."""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.subspace.fourier import Spectrum

WIDTH = 0.35  # of the smoothing, in natural logarithms of ω
FINE = 25  # intervals in that width


def known_weights(data: Sequence[Spectrum], weights: Sequence[Array]) -> list[Array]:
    """Weights as they count in a covariance, less where few lines tell a residual spectrum."""
    # Of n lines, 1/Φ is estimated too large by n/(n - 1) in the mean, and estimates weighed by it
    # scatter by (n + 1)/n more than those weighed by Φ itself.
    omega = np.log(np.concatenate([s.omega for s in data]))
    worth = {}
    for grid, at in {spectrum.grid: np.log(spectrum.omega) for spectrum in data}.items():
        kernel, count, _ = _nearness(at, omega, omega[:, None])
        n = (kernel @ count) ** 2 / (kernel**2 @ count)
        worth[grid] = np.sqrt(np.maximum(n - 1, 0.1) / (n + 1))[:, None]
    known: dict[tuple[object, ...], Array] = {}  # spectra that share weights go on sharing them
    for spectrum, w in zip(data, weights, strict=True):
        known.setdefault((spectrum.grid, id(w)), w * worth[spectrum.grid])
    return [known[spectrum.grid, id(w)] for spectrum, w in zip(data, weights, strict=True)]


def lines_near(omega: Array, seconds: float) -> Array:
    """How many lines, 2π over each record's length apart, tell a residual spectrum at ω (K,)."""
    # (Σ k)²/Σ k² of the Gaussian kernel k in ln ω, of lines that are even in ω.
    return np.asarray(np.exp(0.75 * WIDTH**2) * WIDTH * omega * seconds / np.sqrt(np.pi))


def smoothed(at: Array, omega: Array, power: Array) -> Array:
    """Local mean of power (K, ny) over logarithms of frequency, at those asked for."""
    kernel, count, sums = _nearness(at, omega, power)
    return np.asarray(kernel @ sums / (kernel @ count)[:, None])


def _nearness(at: Array, omega: Array, power: Array) -> tuple[Array, Array, Array]:
    """Weights of intervals of ω at every frequency asked for, how many lines are in each, and sums.

    The intervals are much narrower than the kernel, so that the work is linear in the lines.
    """
    place = np.floor(omega / (WIDTH / FINE)).astype(int)
    _, which, count = np.unique(place, return_inverse=True, return_counts=True)
    sums = [np.bincount(which, weights=column) for column in (omega, *power.T)]
    kernel = np.exp(-0.5 * ((at[:, None] - sums[0] / count) / WIDTH) ** 2)
    return kernel, np.asarray(count, dtype=float), np.array(sums[1:]).T.astype(float)
