"""Finite Fourier transforms of records, exact for linear models with free end states.

Of N equidistant samples, with z = exp(jω h) at the frequencies ω_k = 2πk/((N - 1) h), the first
N - 1 obey, for a mode dx/dt = λ x + b u whose input is held between the samples,

    X(z) = ρ(z) b U(z) + z/(z - e^{λh}) δ        Y(z) = Σ c X(z) + D U(z)

with ρ the hold-equivalent pole factor and δ, one number a mode, whatever the initial and the final
state were: the transient is one more linear unknown, and an unstable model is no special case.
Without equidistant samples the same holds in continuous time, ρ = 1/(jω - λ), with the integral
of the held input and the outputs moved to equidistant instants by a cubic spline. Source:
R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., section 6.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.record import Hold, Record

LINES, SAMPLES = 500, 12_000  # of a piece, about: what is held at once does not grow with a record


class Lines(Protocol):
    """Transforms of inputs and outputs, and what a mode makes of them."""

    @property
    def U(self) -> ComplexArray:
        """Inputs, (K, nu)."""

    @property
    def Y(self) -> ComplexArray:
        """Outputs, (K, ny)."""

    def pole_factors(self, lam: ComplexArray) -> tuple[ComplexArray, ...]:
        """Factors of the input and of the transient, each with its derivative by λ; (K, nm)."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Transforms of one stretch, divided by √T and the channels' standard deviations."""

    omega: Array  # (K,) [rad/s]
    U: ComplexArray  # (K, nu)
    Y: ComplexArray  # (K, ny)
    h: float | None  # sampling interval [s], None for the continuous form
    hold: Hold

    @property
    def grid(self) -> tuple[object, ...]:
        """What pole factors depend on: records of one length and sampling share them."""
        return len(self.omega), self.omega[0], self.h, self.hold

    def pole_factors(self, lam: ComplexArray) -> tuple[ComplexArray, ...]:
        """Factors of the input and of the transient, each with its derivative by λ; (K, nm)."""
        if self.h is None:
            r = 1 / (1j * self.omega[:, None] - lam)
            return r, r**2, r, r**2
        z = np.exp(1j * self.omega * self.h)[:, None]
        phi, dphi = _hold_weights(lam * self.h, self.hold)
        E = np.exp(lam * self.h)
        weight = self.h * (phi[0] + phi[1] * z)
        slope = self.h**2 * (dphi[0] + dphi[1] * z)
        rest = 1 / (z - E)
        r, transient, grow = weight * rest, self.h * z * rest, self.h * E * rest
        return r, slope * rest + r * grow, transient, transient * grow


def spectra(records: Sequence[Record], su: Array, sy: Array, top: float) -> tuple[Spectrum, ...]:
    """Transforms of every record up to ``top`` [rad/s]; outputs must have no NaN.

    Records too short for a line, as between two gaps, have none.
    """
    found = [spectrum(part, su, sy, top) for record in records for part in parts(record, top)]
    return tuple(each for each in found if len(each.omega))


def parts(record: Record, top: float) -> list[Record]:
    """Pieces of a record that are transformed by themselves."""
    lines = top * record.duration / (2 * np.pi)
    pieces = int(np.ceil(max(lines / LINES, record.N / SAMPLES)))
    if pieces < 2 or record.N < 8:
        return [record]
    # All but the last of a length that is transformed fast, which one with a large prime is not.
    length = scipy.fft.next_fast_len(max((record.N - 1) // pieces, 4), real=True)
    edges = [*range(0, record.N - 1 - length // 2, length), record.N - 1]
    return [record.take(slice(start, end + 1)) for start, end in pairwise(edges)]


def spectrum(record: Record, su: Array, sy: Array, highest: float) -> Spectrum:
    """Transforms of a piece of a record up to ``highest`` [rad/s]."""
    t = record.t - record.t[0]
    u, y = record.u / su, record.y / sy
    T, n = float(f"{t[-1]:.12g}"), len(t)  # pieces are alike but for the rounding of their clock
    K = min(int(highest * T / (2 * np.pi)), (n - 1) // 2)
    omega = 2 * np.pi * np.arange(1, K + 1) / T
    h = T / (n - 1)
    even = record.equidistant
    Y = transformed(t, y, K, even=even)
    if even:
        return Spectrum(omega, transformed(t, u, K, even=even), Y, h, record.hold)
    U = _held_transform(omega, t, u, record.hold) / np.sqrt(T)
    return Spectrum(omega, U, Y, None, record.hold)


def transformed(t: Array, y: Array, K: int, *, even: bool) -> ComplexArray:
    """The first ``K`` transforms of outputs (N, ny) over √T, equidistant if ``even``; (K, ny)."""
    T, n = float(t[-1] - t[0]), len(t)
    if not even:
        y = scipy.interpolate.CubicSpline(t, y)(np.linspace(t[0], t[-1], n))
        y[0] = (y[0] + y[-1]) / 2  # both ends share one phase: the trapezoidal sum
    return np.asarray(scipy.fft.rfft(y[:-1], axis=0)[1 : K + 1] * (np.sqrt(T) / (n - 1)))


def _hold_weights(x: ComplexArray, hold: Hold) -> tuple[ComplexArray, ComplexArray]:
    """Weights of u(t) and u(t + h) in one step over h, and their derivatives by x = λh; (2, nm)."""
    small = np.abs(x) < 0.01
    safe = np.where(small, 1.0, x)
    one = np.where(small, 1 + x / 2 + x**2 / 6 + x**3 / 24, np.expm1(safe) / safe)
    two = np.where(small, 1 / 2 + x / 6 + x**2 / 24 + x**3 / 120, (np.expm1(safe) - safe) / safe**2)
    done = np.where(small, 1 / 2 + x / 3 + x**2 / 8, (np.exp(safe) - one) / safe)
    dtwo = np.where(small, 1 / 6 + x / 12 + x**2 / 40, (one - 2 * two) / safe)
    if hold == "zoh":
        return np.array([one, 0 * one]), np.array([done, 0 * done])
    return np.array([one - two, two]), np.array([done - dtwo, dtwo])


def _held_transform(omega: Array, t: Array, u: Array, hold: Hold) -> ComplexArray:
    """∫ u(t) exp(-jωt) dt, exact for steps or straight lines between the samples."""
    s = 1j * omega[:, None]
    E = np.exp(-1j * np.outer(omega, t))
    if hold == "zoh":
        return np.asarray(E @ _jumps(u[:-1]) / s)
    slopes = np.diff(u, axis=0) / np.diff(t)[:, None]  # by parts: the derivative is made of steps
    return np.asarray((E @ _jumps(slopes) / s + u[0] - u[-1]) / s)


def _jumps(steps: Array) -> Array:
    """Jumps at every sample of a signal that is a step per interval and zero outside."""
    return np.diff(steps, axis=0, prepend=0.0, append=0.0)
