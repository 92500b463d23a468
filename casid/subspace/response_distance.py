"""Whether another model responds farther away than a black box's stated errors allow.

An order that cannot follow a delay leaves hardly more of an acceleration where noise is strong, or
makes direct terms of it that were asked to be zero: its response is then many stated errors off.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace import refinement
from casid.subspace.fourier import Spectrum
from casid.subspace.prediction import SampledUncertainty, prediction_errors, stretches
from casid.subspace.trust import Missed
from casid.subspace.weighing import smoothed

POINTS = 12  # frequencies of the band at which two models are compared
SELDOM = 0.01  # level of the test of a likelihood, all outputs together
PART = 3  # of these, over which a distance is averaged: what is missed may be a quarter of the band
FAR = 3.0  # stated errors, rms: clearly more than a 95 % interval has to either side
ROUNDING = 1e-8  # relative errors of a response that are of arithmetic, whatever is stated

Uncertainty = refinement.ResponseUncertainty | SampledUncertainty


def stated_errors(uncertainty: Uncertainty, omega: Array) -> Array:
    """Standard deviations of ln abs(G) and of the phase [rad], (2, K, ny, nu)."""
    factor = uncertainty.response_factor(omega)
    parts = [np.linalg.norm(part, axis=-1) for part in (factor.real, factor.imag)]
    return np.hypot(parts, ROUNDING)


def errors_apart(
    system: StateSpace, other: StateSpace, uncertainty: Uncertainty, omega: Array
) -> Array:
    """Distance of another response in stated errors, rms of magnitude and phase, (K, ny, nu)."""
    off = np.log(other.response(omega) / system.response(omega))
    z = np.array([off.real, off.imag]) / stated_errors(uncertainty, omega)
    return np.asarray(np.sqrt(np.mean(z**2, axis=0)))


def missed_response(
    system: StateSpace,
    uncertainty: Uncertainty,
    richer: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    band: tuple[float, float],
) -> Missed | None:
    """Where a refined model of a higher order that is needed responds otherwise; None for nowhere.

    What is needed but moves no response far, as of nonlinear aircraft, does not matter.
    """
    # Needed by the likelihood of an output, 2 Σ |E|²/Φ: two more states have a pole, a residue for
    # every input and a transient for every piece of a record, which take χ² of as many complex
    # numbers off it by chance. A richer model that has not converged takes off less.
    omega, left = refinement.residual_powers(system, data, su, sy)
    less = refinement.residual_powers(richer, data, su, sy)[1]
    level = smoothed(np.log(omega), np.log(omega), left) + 1e-300
    gain = 2 * np.sum((left - less) / level, axis=0)
    needed = gain > scipy.special.chdtri(2 * (1 + system.nu + len(data)), SELDOM / len(sy))
    ratio = left.sum(axis=0) / np.maximum(less.sum(axis=0), 1e-300)
    return _farthest(system, richer, uncertainty, band, needed, ratio)


def missed_of_samples(
    system: StateSpace,
    uncertainty: SampledUncertainty,
    richer: tuple[StateSpace, SampledUncertainty],
    records: Sequence[Record],
    su: Array,
    sy: Array,
    band: tuple[float, float],
) -> Missed | None:
    """As `missed_response`, of a discrete model refined by one-step prediction errors."""
    # Needed by the likelihood of all outputs together, N log det Σ e eᵀ, and by those outputs whose
    # errors it makes less. An innovation model has n (nu + 2 ny) parameters beside D, and the state
    # that every stretch starts from. More states go where noise looks most like a mode, of as many
    # places as there are samples, so that chance makes the likelihood so large somewhere.
    other, its = richer
    data = stretches(records, su, sy, other.nx + 2)
    white = np.eye(len(sy))
    E, less = (np.vstack(prediction_errors(u.modal, data, white)) for u in (uncertainty, its))
    gain = len(E) * (np.linalg.slogdet(E.T @ E)[1] - np.linalg.slogdet(less.T @ less)[1])
    more = (other.nx - system.nx) * (system.nu + 2 * system.ny + len(data))
    ratio = (np.sum(E**2, axis=0) + 1e-300) / (np.sum(less**2, axis=0) + 1e-300)
    needed = (ratio > 1) & (gain > scipy.special.chdtri(more, SELDOM / len(E)))
    return _farthest(system, other, uncertainty, band, needed, ratio)


def missed_direct(
    system: StateSpace, direct: StateSpace, uncertainty: Uncertainty, band: tuple[float, float]
) -> Missed | None:
    """Where a model responds otherwise than before its masked direct terms were taken out."""
    return _farthest(system, direct, uncertainty, band, np.ones(system.ny, dtype=bool))


def _farthest(
    system: StateSpace,
    other: StateSpace,
    uncertainty: Uncertainty,
    band: tuple[float, float],
    needed: BoolArray,
    ratio: Array | None = None,
) -> Missed | None:
    """The pair of a needed output whose responses are farthest apart; None where none is `FAR`."""
    at = np.geomspace(*band, POINTS)
    z = errors_apart(system, other, uncertainty, at)
    near = np.lib.stride_tricks.sliding_window_view(z, PART, axis=0)
    far = np.where(needed[:, None], np.sqrt(np.mean(near**2, axis=-1)).max(axis=0), 0.0)
    i, j = np.unravel_index(np.argmax(far), far.shape)
    if not far[i, j] > FAR:
        return None
    return Missed(
        output=system.outputs[i],
        omega=float(at[np.argmax(z[:, i, j])]),
        ratio=None if ratio is None else float(ratio[i]),
        order=system.nx + 2,
        errors=float(far[i, j]),
    )
