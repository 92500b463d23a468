"""Whether attitudes have clocks of their own, and what an unknown pitch attitude leaves open.

Attitudes come from one source with one clock, unless a late θ or ψ is told by how they turn each
other: by r sin φ in θ', by q sin φ + r cos φ in φ' and ψ'. Where a body turns about one axis, or a
simulation has small angles (φ' = p, θ' = q), nothing of that is flown, and clocks of their own
would only take the place of what is not there. So it is asked first how many times the coupling
was flown: once, as of a rigid body, and surely so.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.consistency.flightpath import TILT, reconstruct
from casid.consistency.instruments import CLOCKS, Instruments
from casid.consistency.measured import Flight
from casid.consistency.voting import SKEW, significant

SURE = 2.5  # standard errors from none at all that the coupling is flown
OTHER = 0.3  # how far from once that may be, or
ERRORS = 3.0  # so many standard errors
STEEP = 0.45  # rad: the most of an unknown pitch attitude, root mean square


def reconstruct_apart(flights: Sequence[Flight], equations: Sequence[str]) -> Instruments:
    """The reconstruction, attitudes with clocks of their own where the flights tell them."""
    found = reconstruct(flights, equations)
    if found.parting < SKEW / 2 or not _coupled(found):
        return found
    other = reconstruct(flights, equations, parted=True)
    errors = np.sqrt(np.diag(other.covariance))[-len(CLOCKS) :]
    late = [*zip(other.clocks, errors, strict=True)][:-1]  # velocities may be apart anyhow
    return other if _coupled(other) and any(significant(*each) for each in late) else found


def _coupled(found: Instruments) -> bool:
    """Whether attitudes turn each other as those of a rigid body do."""
    more, error = found.coupled
    return 1 + more > SURE * error and abs(more) < max(OTHER, ERRORS * error)


def reconstruct_level(flights: Sequence[Flight], equations: Sequence[str]) -> Instruments:
    """The reconstruction; no unknown pitch attitude is beyond `STEEP`."""
    found = reconstruct_apart(flights, equations)
    # Beyond, none may stand in for what does not follow; should it be true, errors tell of it.
    numbers = np.unique([each.record for each in flights])
    held = {
        k: float(np.clip(tilts.mean(), -TILT, TILT))
        for k, tilts in zip(numbers, found.tilts, strict=True)
        if np.linalg.norm(tilts) > STEEP * len(tilts) ** 0.5
    }
    if not held:
        return found
    fixed = [
        replace(each, level={"theta": held[each.record]}) if each.record in held else each
        for each in flights
    ]
    solution = reconstruct_apart(fixed, equations)
    errors = np.hypot(solution.errors, found.unknowns - solution.unknowns)
    bias_errors = np.hypot(solution.bias_errors, found.biases - solution.biases)
    return replace(solution, errors=errors, bias_errors=bias_errors)
