"""Whether records support a model at all, seen from what the best linear one leaves unexplained."""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.linear import StateSpace
from casid.subspace.fourier import Spectrum
from casid.subspace.refinement import residual_powers

COHERENCE = 0.6  # of inputs and an output, below which a response is not usable; T&R section 7.5


def explained_share(
    system: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    band: tuple[float, float],
) -> Array:
    """Share of each output's power that a model explains at a typical frequency of a band, (ny,).

    One minus the geometric mean over frequencies of residual power over power, which is what a
    multiple coherence is: a resonance that is explained does not hide a band that is not.
    """
    omega, left = residual_powers(system, data, su, sy)
    whole = np.vstack([np.abs(spectrum.Y) ** 2 for spectrum in data])
    inside = (omega >= band[0]) & (omega <= band[1])
    ratio = np.maximum(left[inside], 1e-300) / np.maximum(whole[inside], 1e-300)
    return np.asarray(1 - np.exp(np.mean(np.log(ratio), axis=0)))


def data_doubts(explained: Array, outputs: Sequence[str]) -> tuple[str, ...]:
    """Why the records do not support a model; empty where they do.

    They do not where the inputs explain most outputs with a coherence below `COHERENCE`. A few such
    outputs are common: attitudes hardly move at the upper end of the band.
    """
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
