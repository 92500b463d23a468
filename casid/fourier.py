"""Finite Fourier transforms of records, exact for linear models with free end states.

Over a record of duration T, at ω_k = 2πk/T, a model dx/dt = A x + B u, y = C x + D u gives

    Y(ω_k) = G(jω_k) U(ω_k) + C (jω_k I - A)⁻¹ δ,        δ = x(0) - x(T),

for any initial and final state, of a stable or an unstable model: the transient is one more linear
unknown. Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach,
2nd ed., section 6.3.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from casid.arrays import Array, ComplexArray
from casid.record import Hold, Record

LONGEST = 120.0  # s; a longer record is cut, so that the work stays linear in samples


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Transforms of one stretch, divided by √T and the channels' standard deviations.

    ``omega`` is (K,) [rad/s], ``U`` (K, nu) and ``Y`` (K, ny) complex.
    """

    omega: Array
    U: ComplexArray
    Y: ComplexArray


def spectra(
    records: Sequence[Record], su: Array, sy: Array, highest: float
) -> tuple[Spectrum, ...]:
    """Transforms of every record up to ``highest`` [rad/s]; outputs must have no NaN.

    The inputs' integrals are exact for their hold. The outputs' are trapezoidal sums, whose error
    for equidistant samples of a smooth signal is that of its ends; other samples are first moved
    to equidistant instants by a cubic spline.
    """
    found = []
    for record in records:
        pieces = max(int(np.ceil(record.duration / LONGEST)), 1)
        edges = np.linspace(0, record.N - 1, pieces + 1).astype(int)
        for start, end in pairwise(edges):
            found.append(_spectrum(record, slice(start, end + 1), su, sy, highest))
    return tuple(found)


def _spectrum(record: Record, cut: slice, su: Array, sy: Array, highest: float) -> Spectrum:
    t = record.t[cut] - record.t[cut][0]
    u, y = record.u[cut] / su, record.y[cut] / sy
    T, n = t[-1], len(t)
    K = min(int(highest * T / (2 * np.pi)), (n - 1) // 2)
    omega = 2 * np.pi * np.arange(1, K + 1) / T
    uniform = record.equidistant
    U = _held_transform(omega, t, u, record.hold, uniform=uniform)
    if not uniform:
        y = CubicSpline(t, y)(np.linspace(0.0, T, n))
    h = T / (n - 1)
    weighted = h * y
    weighted[[0, -1]] /= 2
    Y = _point_sum(omega, t, weighted, uniform=True)
    return Spectrum(omega, U / np.sqrt(T), Y / np.sqrt(T))


def _held_transform(omega: Array, t: Array, u: Array, hold: Hold, *, uniform: bool) -> ComplexArray:
    """∫ u(t) exp(-jωt) dt, exact for steps or straight lines between the samples."""
    s = 1j * omega[:, None]
    if hold == "zoh":
        return _point_sum(omega, t, _jumps(u[:-1]), uniform=uniform) / s
    slopes = np.diff(u, axis=0) / np.diff(t)[:, None]  # by parts: the derivative is made of steps
    derivative = _point_sum(omega, t, _jumps(slopes), uniform=uniform) / s
    return (derivative + u[0] - u[-1]) / s


def _jumps(steps: Array) -> Array:
    """Jumps at every sample of a signal that is a step per interval and zero outside."""
    return np.diff(steps, axis=0, prepend=0.0, append=0.0)


def _point_sum(omega: Array, t: Array, c: Array, *, uniform: bool) -> ComplexArray:
    """Σ c_k exp(-jω t_k); equidistant samples share a phase at both ends of the record."""
    if not uniform:
        return np.asarray(np.exp(-1j * np.outer(omega, t)) @ c)
    folded = c[:-1].copy()
    folded[0] += c[-1]
    return np.asarray(np.fft.fft(folded, axis=0)[1 : len(omega) + 1])
