"""What instruments a flight path reconstruction found."""

from dataclasses import dataclass

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.clipping import Beside, Limit

OWN = dict(zip((*RATES, *FORCES), (*ATTITUDES, *VELOCITIES), strict=True))
CLOCKS = ("theta", "psi", "velocities")  # that may differ from the one of φ


@dataclass(frozen=True, eq=False, kw_only=True)
class Instruments:
    """Instruments with which the flights obey kinematics."""

    channels: tuple[str, ...]  # rates and specific forces
    unknowns: Array  # (channels, 2): gain 1/(1 + scale), skew [s]
    errors: Array  # (channels, 2) standard errors
    biases: Array  # (records, channels), after the gain
    bias_errors: Array  # (records, channels)
    tilts: Array  # (records, knots) pitch attitudes that are not known [rad]
    against: dict[str, tuple[str, ...]]  # the equations in which each channel stands
    left: dict[str, list[Array]]  # of each equation's attitude or velocity, one array a flight
    clocks: Array  # (3,) by how much `CLOCKS` are later than φ [s]; (4,) with the one alone
    drawn: Array  # (2, 2, records): how far each draws skews of rates, forces [s], its least error
    covariance: Array  # (channels + clocks,) squared, of all skews and, last, clocks [s^2]
    place: Array  # (3,) of the accelerometers, from where velocities are measured [m]
    place_errors: Array  # (3,)
    alone: str  # an attitude or velocity with one of its own, if any
    parted: bool  # whether θ and ψ have clocks of their own
    parting: float  # how far apart the first step makes them, or would [s]
    coupled: tuple[
        float, float
    ]  # how many times the coupling of attitudes is flown beside once, its error
    held: float  # for how long inputs were held from sample to sample [s]
    limits: dict[str, Limit]  # of sensors that were at one
    drifts: Beside  # how fast each skew and, last, that of velocities grow [s/s], their scatter
