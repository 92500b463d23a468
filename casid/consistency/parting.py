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

from casid.consistency.flightpath import reconstruct
from casid.consistency.instruments import CLOCKS, Instruments
from casid.consistency.measured import Flight
from casid.consistency.voting import SKEW, significant

SURE = 2.5  # standard errors from none at all that the coupling is flown
OTHER = 0.3  # how far from once that may be, or
ERRORS = 3.0  # so many standard errors
TILT = 0.1  # rad: what an unknown pitch attitude may be


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
    """The reconstruction; errors are wider where pitch attitude is neither recorded nor given."""
    solution = reconstruct_apart(flights, equations)
    if not {"phi", "r"} <= {*flights[0].values} or any(
        each.level.get("theta", TILT) for each in flights
    ):
        return solution
    other = reconstruct_apart([replace(each, level={"theta": TILT}) for each in flights], equations)
    apart = np.hypot(solution.errors, other.unknowns - solution.unknowns)
    biases_apart = np.hypot(solution.bias_errors, other.biases - solution.biases)
    return replace(solution, errors=apart, bias_errors=biases_apart)
