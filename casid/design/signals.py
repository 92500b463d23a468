"""Inputs that need no optimisation, and the waves that multisines are made of."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from casid.arrays import Array

UNITS = np.repeat([1.0, -1.0, 1.0, -1.0], [3, 2, 1, 1])  # a 3-2-1-1, one value a unit


def turns(N: int, nu: int, first: int) -> list[slice]:
    """Samples in which each of nu axes has its turn, after ``first`` of rest."""
    edges = np.linspace(first, N, nu + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def multistep(t: Array, start: float, unit: float, rise: float) -> Array:
    """A 3-2-1-1 of amplitude one, (N,), that begins at ``start`` [s]; its edges take ``rise`` s."""
    levels = np.concatenate([[0.0], UNITS, [0.0]])
    edges = start + unit * np.arange(len(levels) - 1)
    jumps = np.diff(levels)
    ramps = np.clip((t[:, None] - edges) / max(rise, 1e-9), 0.0, 1.0)
    return np.asarray(ramps @ jumps)


def longest_unit(turn: float) -> float:
    """Of a 3-2-1-1 for which there is so much time [s], a tenth of it rest."""
    return 0.9 * turn / len(UNITS)


def turns_of_3211(
    t: Array, amplitudes: Array, rest: float, unit: float, rise: Array, *, often: bool = True
) -> Array:
    """3-2-1-1 on one axis after the other, (N, nu), as often as there is time for, or once each.

    Each has a unit of rest behind it; from round to round the sign changes. The unit is shorter
    where not every axis would have its turn.
    """
    nu = len(amplitudes)
    r, room = np.zeros((len(t), nu)), float(t[-1]) - rest
    fit = int(room / ((len(UNITS) + 1) * unit + float(rise.max())))
    parts = turns(len(t), max(nu, fit) if often else nu, int(np.searchsorted(t, rest)))
    for k, part in enumerate(parts):
        j, sign = k % nu, (-1.0) ** (k // nu)
        width = min(unit, longest_unit(float(t[part][-1] - t[part][0])))
        one = multistep(t[part], float(t[part][0]), width, float(rise[j]))
        r[part, j] = sign * amplitudes[j] * one
    return r


def turns_of_sweeps(t: Array, amplitudes: Array, rest: float, band: Sequence[float]) -> Array:
    """Logarithmic sweeps over a band [rad/s] on one axis after the other, (N, nu)."""
    r = np.zeros((len(t), len(amplitudes)))
    for j, part in enumerate(turns(len(t), r.shape[1], int(np.searchsorted(t, rest)))):
        s = (t[part] - t[part][0]) / (t[part][-1] - t[part][0])
        length, ratio = float(t[part][-1] - t[part][0]), np.log(band[1] / band[0])
        phase = band[0] * length / ratio * (np.exp(ratio * s) - 1.0)
        fade = np.clip(s / 0.08, 0.0, 1.0) * np.clip((1 - s) / 0.05, 0.0, 1.0)
        r[part, j] = amplitudes[j] * fade * np.sin(phase)
    return r


def harmonics(band: Sequence[float], length: float) -> Array:
    """Frequencies 2πk/T [rad/s] of a band, (K,)."""
    first = max(1, int(np.ceil(band[0] * length / (2 * np.pi) - 1e-9)))
    last = int(np.floor(band[1] * length / (2 * np.pi) + 1e-9))
    return np.asarray(2 * np.pi / length * np.arange(first, last + 1))


def wave_family(t: Array, rest: float, omega: Array) -> Array:
    """Cosines and sines of frequencies ω (K,) from ``rest`` on: (N, 2 K)."""
    phase = np.maximum(t - rest, 0.0)[:, None] * omega
    on = (t >= rest)[:, None]
    return np.asarray(np.concatenate([on * np.cos(phase), on * np.sin(phase)], axis=1))


def taper(t: Array, rest: float, fade: float) -> Array:
    """One, (N,), but for cubics s² (3 - 2 s) from zero and back to it, ``fade`` [s] at either end.

    It begins after ``rest`` and ends with the time, so that what it multiplies begins and ends in
    trim.
    """
    s = np.clip(np.minimum(t - rest, t[-1] - t) / fade, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))
