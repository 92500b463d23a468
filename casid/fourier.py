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

from casid.arrays import Array, ComplexArray
from casid.record import Record

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

    Inputs and outputs go through the same trapezoidal rule, so what it does to a signal between its
    samples cancels in their ratio.
    """
    found = []
    for record in records:
        pieces = max(int(np.ceil(record.duration / LONGEST)), 1)
        edges = np.linspace(0, record.N - 1, pieces + 1).astype(int)
        for start, end in pairwise(edges):
            cut = slice(start, end + 1)
            v = np.hstack([record.u[cut] / su, record.y[cut] / sy])
            omega, V = _transform(record.t[cut], v, highest, uniform=record.equidistant)
            found.append(Spectrum(omega, V[:, : record.nu], V[:, record.nu :]))
    return tuple(found)


def _transform(t: Array, v: Array, highest: float, *, uniform: bool) -> tuple[Array, ComplexArray]:
    T = t[-1] - t[0]
    n = min(int(highest * T / (2 * np.pi)), (len(t) - 1) // 2)
    omega = 2 * np.pi * np.arange(1, n + 1) / T
    if uniform:  # the two half end samples share one phase
        body = v[:-1].copy()
        body[0] = (v[0] + v[-1]) / 2
        V = np.fft.fft(body, axis=0)[1 : n + 1] * (T / (len(t) - 1))
    else:
        steps = np.diff(t)
        weight = np.concatenate([steps, [0.0]]) / 2 + np.concatenate([[0.0], steps]) / 2
        V = np.exp(-1j * np.outer(omega, t - t[0])) @ (weight[:, None] * v)
    return omega, V / np.sqrt(T)
