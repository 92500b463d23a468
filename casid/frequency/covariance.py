"""How the errors of a measured frequency response hang together, and how to make them independent.

The errors of neighbouring frequencies come from overlapping parts of the spectrum: with spectral
windows of standard deviation b they correlate by

    ρ_kl = √(2 b_k b_l/(b_k² + b_l²)) exp(−(ω_k − ω_l)²/(2 (b_k² + b_l²))),

those of two outputs as their noise does, those of two inputs as the inverse of the inputs' spectra
(J. S. Bendat, A. G. Piersol, Random Data, 4th ed., chapters 8 and 9). The covariance of all points
is A_k ρ_kl A_lᴴ, with A_k A_kᴴ that of the pairs at one frequency.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray, ComplexArray
from casid.frequency.response import FED_BACK, UNDRIVEN, FrequencyResponse

ALONE = 0.03  # of a variance that other pairs do not share
ALONG = 0.15  # nor neighbours, which are less alike than their spectral windows
DENSE = 5.0  # points in a spectral window from which on more of them share that
LEAST = 1e-4  # of a response, the smallest error believed
NEAR = 0.7  # standard deviation of the weights of neighbours [nepers of frequency]
BESIDE = 0.15  # of those that say how large a response is
FLAT = 1e-6  # of the places' variance, of two points that say no slope
REACH = 0.35  # over which residuals' power is smoothed [nepers of frequency]
SURE = 4.0  # standard errors of a mean power above one that noise does not explain


@dataclass(frozen=True, eq=False)
class Whitener:
    """Makes the errors of a response's usable points independent, of unit variance."""

    omega: Array  # (K,) frequencies [rad/s]
    used: BoolArray  # (K, ny, nu) points that count: measured, with a stated error, not flagged
    across: ComplexArray  # (K, ny nu, ny nu) A_k⁻¹ of a frequency's pairs, triangular; zero unused
    along: tuple[tuple[int, NDArray[np.intp], Array], ...]  # pair, its places, inverse root of ρ
    std: Array  # (K, ny, nu) stated errors of the points; 1 unused
    independent: float  # so many independent points have a mean power that scatters as theirs

    def __call__(self, values: ComplexArray) -> ComplexArray:
        """Values (K, ny, nu, ...) as rows (points, ...) whose errors are independent.

        Real and imaginary part of each have unit variance.
        """
        flat = values.reshape(len(values), -1, *values.shape[3:])
        flat = np.where(self.used.reshape(flat.shape[:2] + (1,) * (flat.ndim - 2)), flat, 0.0)
        mixed = np.einsum("kpq,kq...->kp...", self.across, flat)
        return np.concatenate(
            [np.tensordot(root, mixed[at, pair], 1) for pair, at, root in self.along]
        )

    def excess(self, power: Array) -> Array:
        """By what factors (points,) residuals exceed the stated errors, 1 where that is not sure.

        ``power`` (points,) is that of independent ones, half their squared modulus: 1 on average
        where errors are as stated. Smoothed over frequency, pair by pair.
        """
        found = np.empty(len(power))
        for _, at, own in self.runs():
            place = np.log(self.omega[at])
            near = np.abs(place[:, None] - place) <= REACH
            count = near.sum(axis=1)
            mean = near @ power[own] / count
            found[own] = np.where(mean > 1 + SURE / np.sqrt(count), np.sqrt(mean), 1.0)
        return found

    def runs(self) -> Iterator[tuple[int, NDArray[np.intp], slice]]:
        """Of every pair its number, its frequencies' places, and where its points are among all."""
        first = 0
        for pair, at, _ in self.along:
            yield pair, at, slice(first, first := first + len(at))

    def spread(self, gains: ComplexArray) -> Array:
        """Covariance (m, m) of m numbers Re Σ c ΔG that errors cause, c (K, ny, nu, m) the gains.

        Gains of points that do not count are left out.
        """
        c = gains.reshape(*self.across.shape[:2], -1)
        idle = ~self.used.reshape(c.shape[:2])
        A = np.linalg.inv(self.across + idle[:, :, None] * np.eye(c.shape[1]))
        mixed = np.einsum("kqp,kqm->kpm", A, np.where(idle[:, :, None], 0.0, c))
        total = np.zeros((c.shape[2], c.shape[2]))
        for pair, at, root in self.along:
            part = scipy.linalg.solve_triangular(root, mixed[at, pair], trans="T", lower=True)
            total += (part.T @ part.conj()).real
        return total


def whitener(response: FrequencyResponse, wanted: BoolArray) -> Whitener:
    """The whitener of a response's stated errors, of pairs ``wanted`` (ny, nu).

    ValueError: no such point with a stated error.
    """
    used = wanted & np.isfinite(response.G) & np.isfinite(response.error) & (np.abs(response.G) > 0)
    pairwise = [word.format(name) for word in (FED_BACK, UNDRIVEN) for name in response.inputs]
    for why, at in response.flags.items():
        used[list(at)] &= why in pairwise
    if not used.any():
        raise ValueError(
            f"the response from {', '.join(response.records) or 'elsewhere'} states no error at "
            "any usable point of the model's pairs: give random_error, the relative standard "
            "deviation of its gain"
        )
    std = np.where(used, np.maximum(response.error, LEAST) * np.abs(response.G), 1.0)
    K, ny, nu = used.shape
    pairs, std = used.reshape(K, -1), std.reshape(K, -1)
    S = np.einsum("kil,kjm->kijlm", response.output_correlation, response.input_correlation)
    S = S.reshape(K, ny * nu, ny * nu)
    both = pairs[:, :, None] & pairs[:, None, :]
    S = np.where(both, S, np.eye(ny * nu))
    alike = np.sum(np.abs(np.where(both, S, 0.0)) ** 2, axis=2)  # (K, ny nu) shared with all pairs
    inverse = np.linalg.inv(np.linalg.cholesky((1 - ALONE) * S + ALONE * np.eye(ny * nu)))
    across = np.where(both, inverse / std[:, None, :], 0.0)
    width = response.resolution.reshape(K, -1)
    places = [(p, np.flatnonzero(pairs[:, p])) for p in range(ny * nu)]
    along = [(p, at, _root(response.omega[at], width[at, p])) for p, at in places if len(at)]
    shared = sum(
        np.mean(alike[at, p]) * np.sum(np.linalg.inv(root.T @ root) ** 2) for p, at, root in along
    )
    independent = float(used.sum() ** 2 / shared)
    std = std.reshape(used.shape)
    return Whitener(response.omega, used, across, tuple(along), std, independent)


def _root(omega: Array, width: Array) -> Array:
    """Inverse root (n, n) of the correlation of errors at frequencies with spectral windows."""
    b = np.maximum(width, 1e-9 * omega)
    square = b[:, None] ** 2 + b**2
    rho = np.sqrt(2 * np.outer(b, b) / square)
    rho *= np.exp(-((omega[:, None] - omega) ** 2) / (2 * square))
    # The more points, the less would be left of their own shares, and of what leakage makes unlike.
    own = ALONG * np.maximum(1.0, rho.sum(axis=1) / DENSE)
    rho = (1 - ALONG) * rho + np.diag(own)
    lower = np.linalg.cholesky(rho)
    return np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(b)), lower=True))


def steadied(response: FrequencyResponse) -> FrequencyResponse:
    """The response with no random error below that of its neighbours, root mean square.

    Of points that state a coherence, as estimates do: their errors rest on few lines of the records
    and come out too small at some points by chance, which would count for far more than they tell
    if weighed by them. Neighbours' relative or absolute errors, whichever say less; how large the
    response is say the points beside, lest one that came out small by chance count for more.
    """
    size, log = np.abs(response.G), np.log(response.omega)
    apart = log - log[:, None]
    told = np.isfinite(response.random_error) & (size > 0) & (response.coherence < 1)
    power = np.where(told, size, 1.0) ** 2
    square = np.where(told, response.random_error, 0.0) ** 2 * power
    near = np.exp(-((apart / NEAR) ** 2) / 2)
    beside = np.exp(-((apart / BESIDE) ** 2) / 2) * (apart != 0)
    usual = np.exp(_straight(beside, apart, told, np.log(power)))
    with np.errstate(invalid="ignore", divide="ignore"):
        level, share = (
            np.tensordot(near, told * x, 1) / np.tensordot(near, 1.0 * told, 1)
            for x in (square, square / usual)
        )
        error = np.sqrt(np.maximum(square, np.fmin(level, share * usual))) / size
    return replace(response, random_error=np.where(told, error, response.random_error))


def _straight(weight: Array, x: Array, told: BoolArray, values: Array) -> Array:
    """Values at zero of straight lines (K, ny, nu) through those at places x (K, K) that are told.

    Their mean where that is all that is known, infinite where nothing is.
    """
    m0, m1, m2 = (np.tensordot(weight * x**n, 1.0 * told, 1) for n in range(3))
    v0, v1 = (np.tensordot(weight * x**n, told * values, 1) for n in range(2))
    determinant = m0 * m2 - m1**2
    with np.errstate(invalid="ignore", divide="ignore"):
        line, mean = (m2 * v0 - m1 * v1) / determinant, v0 / m0
    return np.where(m0 > 0, np.where(determinant > FLAT * m0 * m2, line, mean), np.inf)
