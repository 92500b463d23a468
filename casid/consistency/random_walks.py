"""How far white noise of rates, forces and what multiplies them walks once it is integrated.

The noise of a sample stays in the integral for good: from one sample to the next it moves by

    s² = Δt² Σ gain² mean(∂f/∂x)² σ_x²,    x: every channel on the right-hand side f.

About its mean a walk of N steps has, in the orthonormal cosine transform c (DCT-II), independent
coefficients of variance s²/(2 sin(π k/2N))², k = 1 … N − 1: cosines are the eigenvectors of second
differences (G. Strang, The discrete cosine transform, SIAM Review 41, 1999). Most of a walk is in
the lowest frequencies; what does not follow for another reason is where aircraft move, too.

The noise of a channel is read at frequencies above those at which aircraft fly, by a median:
vibration, lines in its spectrum, is no noise and does not walk.
"""

from collections.abc import Mapping

import numpy as np
import scipy

from casid.arrays import Array
from casid.consistency.innovations import BAND
from casid.consistency.instruments import Instruments
from casid.consistency.measured import Flight
from casid.consistency.rigid import TURNED, terms_of, tilted
from casid.consistency.voting import SIGNIFICANT

MEDIAN = 0.4549364  # of chi-square of one degree of freedom
UPPER = 0.5  # of all frequencies, of which noise is read where they end below the flight's


def cosine_powers(x: Array) -> Array:
    """Squares (N − 1,) of the orthonormal cosine transform of x (N,), but for its mean."""
    return np.asarray(scipy.fft.dct(x, norm="ortho")[1:] ** 2)


def walk_powers(n: int) -> Array:
    """Expected `cosine_powers` (n − 1,) of a walk of n samples whose steps have the variance 1."""
    return np.asarray((2 * np.sin(np.pi * np.arange(1, n) / (2 * n))) ** -2.0)


def noise_floor(x: Array, dt: float) -> float:
    """Variance of a channel's white noise, from above the frequencies of flight."""
    powers = cosine_powers(x)
    share = min(2 * BAND * dt, UPPER)
    return float(np.median(powers[int(share * len(powers)) :]) / MEDIAN)


def step_variance(equation: str, flight: Flight, gains: Mapping[str, float]) -> float:
    """By what noise moves the integral of an equation from one own sample to the next, squared."""
    level = np.zeros(len(flight.t))
    known = {name: level + flight.level.get(name, 0.0) for name in TURNED} | flight.values
    slopes = terms_of(equation, flight, known)[0]
    slopes |= tilted(equation, known)
    total = 0.0
    for name, slope in slopes.items():
        if name not in flight.values:
            continue
        step = flight.step(name)
        noise = step * noise_floor(flight.own(name), flight.dt * step)
        total += gains.get(name, 1.0) ** 2 * float(np.mean(slope**2)) * noise
    return flight.dt**2 * flight.step(equation) * total


def walked(equation: str, left: Array, flight: Flight, found: Instruments) -> float:
    """Mean square of what is ``left`` (N,) of an equation that may be the noise's walk.

    Of every frequency as much as is within `SIGNIFICANT` standard deviations of a walk.
    """
    gains = dict(zip(found.channels, map(float, found.unknowns[:, 0]), strict=True))
    most = SIGNIFICANT**2 * step_variance(equation, flight, gains) * walk_powers(len(left))
    return float(np.minimum(cosine_powers(left), most).sum() / len(left))
