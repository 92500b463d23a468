"""Whether records support a model at all, seen from what the best linear one leaves unexplained."""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.subspace import refinement
from casid.subspace.fourier import Spectrum
from casid.subspace.modal import covariance_factor, to_modal

CERTAIN = 2.8  # standard errors that a growth rate must be away from zero: 99.5 % of a normal one
COHERENCE = 0.6  # of inputs and an output, below which a response is not usable; T&R section 7.5


def explained_share(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array, band: tuple[float, float]
) -> Array:
    """Share of each output's power that a model explains at a typical frequency of a band, (ny,).

    One minus the geometric mean over frequencies of residual power over power, which is what a
    multiple coherence is: a resonance that is explained does not hide a band that is not.
    """
    omega, left = refinement.residual_powers(system, data, su, sy)
    whole = np.vstack([np.abs(spectrum.Y) ** 2 for spectrum in data])
    inside = (omega >= band[0]) & (omega <= band[1])
    ratio = np.maximum(left[inside], 1e-300) / np.maximum(whole[inside], 1e-300)
    return np.asarray(1 - np.exp(np.mean(np.log(ratio), axis=0)))


def doubtful_growth(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array, feedthrough: BoolArray
) -> ComplexArray:
    """Growing modes (Im >= 0) of a refined model that the likelihood of its data does not need.

    Those whose growth rate is not `CERTAIN` by its standard error, the larger one of that under the
    residual spectra and of that from how far record by record pulls the estimate apart, which what
    is nonlinear does; and those at the limit to which a mode that was found decaying may grow.
    """
    modal = to_modal(system, su, sy, feedthrough)
    growing = np.flatnonzero(modal.lam.real > 0)
    if not len(growing):
        return np.zeros(0, dtype=complex)
    free = np.argwhere(feedthrough)
    pairs = zip(data, refinement.noise_weights(modal, data), strict=True)
    parts = [refinement.normal_equations(modal, [lines], [weight], free) for lines, weight in pairs]
    factor = covariance_factor(np.sum([H for H, _ in parts], axis=0))[: len(modal.lam)]
    count = len(parts)
    plain = np.linalg.norm(factor, axis=1) / np.sqrt(2)
    whole = covariance_factor(np.sum([H for H, _ in parts], axis=0))
    pulls = factor @ (whole.T @ np.array([gradient for _, gradient in parts]).T)
    robust = np.linalg.norm(pulls, axis=1) * np.sqrt(count / max(count - 1, 1))
    error, limit = np.maximum(plain, robust), refinement.highest_growth(data)
    rates = modal.lam.real
    unsure = (rates < CERTAIN * error) | (np.abs(rates - limit) < 1e-3 * limit)
    return np.asarray(modal.lam[(rates > 0) & unsure])


def growth_doubts(modes: ComplexArray) -> tuple[str, ...]:
    """Why growing modes are not to be believed; empty for none."""
    if not len(modes):
        return ()
    names = ", ".join(
        f"{m.real:+.3g}" + (f" ± {m.imag:.3g}j" if m.imag else "") + " rad/s" for m in modes
    )
    return (
        f"The black box grows at {names}, which the likelihood does not need: what the records "
        "show there may as well decay. Do not take the aircraft for unstable because of that; "
        "another order, or longer records, shows what is true.",
    )


def data_doubts(explained: Array, outputs: Sequence[str]) -> tuple[str, ...]:
    """Why the records do not support a model; empty where they do."""
    # They do not where the inputs explain most outputs with a coherence below `COHERENCE`. A few
    # such outputs are common: attitudes hardly move at the upper end of the band.
    weak = [
        f"{name} {max(share, 0):.0%}"
        for name, share in zip(outputs, explained, strict=True)
        if share < COHERENCE
    ]
    if 2 * len(weak) <= len(explained):
        return ()
    return (
        "These data do not support a model: at a typical frequency of the band that the inputs "
        f"excite, the best linear model explains only so much of the outputs: {', '.join(weak)}; "
        f"{COHERENCE:.0%} is the least that is usable. Derivatives and handling-quality figures "
        "from them mean nothing. Look for vibration and wind, inputs that were not recorded, "
        "channels that disagree (kinematics), and fly stronger inputs one axis at a time.",
    )
