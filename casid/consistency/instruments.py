"""What instruments a flight path reconstruction found."""

from dataclasses import dataclass

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.limits import Beside, Limit

OWN = dict(zip((*RATES, *FORCES), (*ATTITUDES, *VELOCITIES), strict=True))


@dataclass(frozen=True, eq=False, kw_only=True)
class Instruments:
    """Instruments with which the flights obey kinematics."""

    channels: tuple[str, ...]  # rates and specific forces
    unknowns: Array  # (channels, 2): gain 1/(1 + scale), skew [s]
    errors: Array  # (channels, 2) standard errors
    biases: Array  # (records, channels), after the gain
    bias_errors: Array  # (records, channels)
    against: dict[str, tuple[str, ...]]  # the equations in which each channel stands
    left: dict[str, list[Array]]  # of each equation's attitude or velocity, one array a flight
    clock: tuple[float, float]  # by how much velocities are later than attitudes [s], its error
    drawn: Array  # (2, 2, records): how far each draws skews of rates, forces [s], its least error
    covariance: Array  # (channels + 1,) squared, of all skews and, last, of that clock [s^2]
    place: Array  # (3,) of the accelerometers, from where velocities are measured [m]
    place_errors: Array  # (3,)
    limits: dict[str, Limit]  # of sensors that were at one
    drifts: Beside  # how fast each skew and, last, the clock grow [s/s], their scatter
