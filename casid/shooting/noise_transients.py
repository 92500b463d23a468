"""What noise from before and from the end of a record leaves on the lines of its transform.

Noise of a power Φ is white noise w, of variance one, through h, Φ = |H|². On the lines of N samples
of it stands, beside H W,

    (1/√N) Σ_{m≥1} (w_{-m} − w_{N−m}) Σ_{j≥0} h_{m+j} z^{-j}:

it was under way when the record began, and what is under way at the end is cut off (Pintelon and
Schoukens, System Identification, 2012, section 6.3). White noise has none of it. Of noise that
rises towards low frequencies it is one signal over many lines, which slow parameters take for
theirs; it lies in few directions, and they are eliminated with the transients of the states.
h follows from Φ by its cepstrum, the directions from those singular values of the sums over j, as
whitened noise has them, that matter.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

from casid.arrays import Array, ComplexArray
from casid.shooting.lines import Lines

DIFFERENCE = 2.0  # variance of w_{-m} − w_{N−m}
DOUBTED = 4.0 * DIFFERENCE  # the same as it is taken: Φ is known least where it rises
SLIGHT = 0.05  # Σ m c_m² of a cepstrum below which noise counts as white
LEAST = 0.05  # variance of a direction, in units of whitened noise, that matters
PASTS = 6  # of noise, decaying at different speeds, from which directions are sought
SWEEPS = 1  # of the search


class Outside(NamedTuple):
    """Directions of one record that such noise lies in, each of one output."""

    columns: ComplexArray  # (K, n) on the lines, in units whose variance is `DIFFERENCE`
    output: tuple[int, ...]  # the place of each, (n,)


def on_lines(lines: Lines, shapes: Sequence[Array]) -> Outside:
    """Signals in time of every output, (n, J) each, on the lines of a record."""
    N, found = lines.record.N, [np.zeros((len(lines.z), 0), dtype=complex)]
    output: list[int] = []
    for i, shape in enumerate(shapes):
        if not lines.seen[i] or not len(shape):
            continue
        count, J = shape.shape
        whole = np.zeros((count, -(-J // N) * N))
        whole[:, :J] = shape
        folded = whole.reshape(count, -1, N).sum(axis=1)  # z^{-j} has period N
        found.append(np.fft.rfft(folded)[:, 1 : len(lines.z) + 1].T / np.sqrt(N))
        output += [i] * count
    return Outside(np.hstack(found), tuple(output))


def directions(omega: Array, power: Array, dt: float, N: int) -> Array:
    """Signals (n, J) in time that noise of a power (k,) at frequencies (k,) leaves of its past.

    Of a record of at most N samples; none (0, 0) of noise that is white.
    """
    half = scipy.fft.next_fast_len(N, real=True)  # of longer memory nothing is seen
    n = 2 * half
    cepstrum = scipy.fft.irfft(_log_power(omega, power, dt, n), n)
    m = np.arange(1, half)
    if float(m @ cepstrum[1:half] ** 2) < SLIGHT:  # Szegő: by how much ends matter in all
        return np.zeros((0, 0))
    causal = np.concatenate([cepstrum[:1] / 2, cepstrum[1:half], np.zeros(n - half)])
    H: ComplexArray = np.exp(scipy.fft.rfft(causal)).astype(complex)
    inverse: ComplexArray = 1 / H
    h = scipy.fft.irfft(H, n)
    h[half:] = 0.0
    carried, past = scipy.fft.rfft(h), _basis(_pasts(half))
    for _ in range(SWEEPS):
        white = _basis(_filtered(inverse, _met(carried, past)))
        past = _met(carried, _filtered(inverse.conj(), white))
        past[:, 0] = 0.0  # m ≥ 1
        past = _basis(past)
    future = _met(carried, past)
    axes, sizes, _ = np.linalg.svd(_filtered(inverse, future), full_matrices=False)
    return axes[:, DIFFERENCE * sizes**2 > LEAST].T @ future


def _log_power(omega: Array, power: Array, dt: float, n: int) -> Array:
    """Logarithm of the power on the lines of n samples, (n//2 + 1,), even beyond what is known."""
    grid = 2 * np.pi * np.arange(1, n // 2 + 1) / (n * dt)
    logs = np.interp(np.log(grid), np.log(omega), np.log(power))
    return np.concatenate([logs[:1], logs])


def _pasts(half: int) -> Array:
    """Noise of the past (PASTS, half), of place m at m, that grew at different speeds."""
    past = np.exp(-np.arange(half) / np.geomspace(1.0, half / 2, PASTS)[:, None])
    past[:, 0] = 0.0
    return past


def _basis(rows: Array) -> Array:
    """Orthonormal rows."""
    return np.asarray(np.linalg.qr(rows.T)[0].T)


def _met(carried: ComplexArray, x: Array) -> Array:
    """Σ_m h_{m+j} x_m of rows x (k, half), j = 0 .. half - 1, by the transform of h."""
    n, half = 2 * x.shape[1], x.shape[1]
    return np.asarray(scipy.fft.irfft(carried * scipy.fft.rfft(x, n).conj(), n)[:, :half])


def _filtered(H: ComplexArray, x: Array) -> Array:
    """Rows (k, half) through a filter."""
    n, half = 2 * x.shape[1], x.shape[1]
    return np.asarray(scipy.fft.irfft(H * scipy.fft.rfft(x, n), n)[:, :half])
