"""What filters leave of an integral of noisy rates that is seen in noise: innovations."""

import numpy as np
from scipy.linalg.lapack import dtbtrs

from casid.arrays import Array

BAND = 4.0  # Hz: above that rates and forces are more noise and vibration than flight


def integral(f: Array, dt: float) -> Array:
    """Running integral of columns from the first sample, of fourth order inside."""
    rows = f.T  # each in one piece of memory, here and in what follows
    found = np.zeros(rows.shape)
    step = found[:, 1:]
    np.add(rows[:, 1:], rows[:, :-1], out=step)
    step *= 13
    step[:, 1:] -= rows[:, :-2]
    step[:, :-1] -= rows[:, 2:]
    step[:, 0] -= 2 * rows[:, 0] - rows[:, 1]
    step[:, -1] -= 2 * rows[:, -1] - rows[:, -2]
    step *= dt / 24
    np.cumsum(step, axis=1, out=step)
    return found.T


def growing(slopes: Array, dt: float, begin: float) -> Array:
    """Integrals (n, N) of slopes times time, from ``begin`` on, of the integrals of slopes."""
    t = begin + dt * np.arange(slopes.shape[1])
    return np.asarray(slopes * t - integral(slopes.T, dt).T)  # by parts


def steady_gain(ratio: float) -> float:
    """Kalman's for a random walk seen in noise, ``ratio`` the variance of its steps to that."""
    return float((np.sqrt(ratio**2 + 4 * ratio) - ratio) / 2)


def innovations(gain: float, rows: Array, dt: float = 0.0) -> Array:
    """What a filter of this gain leaves of residual and slopes (n, N), initial state projected out.

    e[k] − e[k−1] + (1 − K) ε[k−1] is the error of predicting a sum of white noise (in the rates)
    that is seen through white noise (in the attitude) one sample ahead. A sampling interval asks
    for them up to `BAND`.
    """
    found = np.vstack([rows, np.ones(rows.shape[1])])
    b, a = np.array([[1.0, -1.0], [1.0, gain - 1.0]] if gain > 0 else [[1.0], [1.0]])
    if 0 < dt < 0.4 / BAND:
        b, a = map(np.convolve, (b, a), _low_pass(dt))
    if len(a) > 1:
        found = _filtered(b, a, found)
    found, z = found[:-1], found[-1]
    return np.asarray(found - np.outer(found @ z / (z @ z), z))


def _filtered(b: Array, a: Array, rows: Array) -> Array:
    """Rows (n, N) through the filter b/a from rest, a[0] being 1."""
    moving = b[0] * rows
    for k in range(1, len(b)):
        moving[:, k:] += b[k] * rows[:, :-k]
    # The recursion is a banded triangular system: SciPy's filters would import most of it.
    band = np.asfortranarray(np.tile(a[:, None], moving.shape[1]))
    found = dtbtrs(band, moving.T, uplo="L", diag="U", overwrite_b=True)[0]
    return np.asarray(found.T)


def _low_pass(dt: float) -> tuple[Array, Array]:
    """Butterworth's filter of second order that lets pass what is below `BAND`, b and a."""
    w = np.tan(np.pi * BAND * dt)
    whole = 1 + np.sqrt(2) * w + w**2
    a = np.array([whole, 2 * (w**2 - 1), 1 - np.sqrt(2) * w + w**2])
    return w**2 / whole * np.array([1.0, 2.0, 1.0]), a / whole
