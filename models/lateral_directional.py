"""Lateral-directional motion of a helicopter, decoupled from pitch and heave.

Dutch roll, spiral and roll subsidence: G. D. Padfield, Helicopter Flight Dynamics, 2nd ed., section
4.3.2, the lateral sub-matrix, wings level in trim; as an identified structure M. B. Tischler and
R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 13.

What identifies it: lateral stick and pedals, each excited once (3-2-1-1 or a sweep over
0.2-12 rad/s), with ay, p, r and phi at the centre of gravity, pitch and speed held near trim.
Sticks as a fraction of full travel. Yp and Yr are told from p and r by ay alone: without it fix
them.
"""

from collections.abc import Mapping
from math import cos, tan

from casid import Model, Rows, Scalar, parameter


class LateralDirectional(Model):
    """Derivatives of the specific force Y and of the roll and yaw accelerations L and N."""

    states = ("v", "p", "r", "phi")
    inputs = ("lat", "ped")
    outputs = ("ay", "p", "r", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Lv: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Lr: Scalar = parameter(default=0.2, lower=-10.0, upper=10.0, unit="1/s")
    Nv: Scalar = parameter(default=0.03, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Np: Scalar = parameter(default=-0.2, lower=-10.0, upper=10.0, unit="1/s")
    Nr: Scalar = parameter(default=-0.6, lower=-5.0, upper=0.0, unit="1/s")

    Ylat: Scalar = parameter(default=2.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Yped: Scalar = parameter(default=-5.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Llat: Scalar = parameter(default=20.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=-2.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlat: Scalar = parameter(default=0.5, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=6.0, lower=-30.0, upper=30.0, unit="rad/s^2")

    tau_lat: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")
    tau_ped: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")

    # Trim: velocities [m/s], pitch attitude [rad]; never estimated.
    U0: float = 41.15
    W0: float = 0.0
    theta0: float = 0.0
    g: float = 9.80665

    def A(self) -> Rows:
        return [
            [self.Yv, self.Yp + self.W0, self.Yr - self.U0, self.g * cos(self.theta0)],
            [self.Lv, self.Lp, self.Lr, 0],
            [self.Nv, self.Np, self.Nr, 0],
            [0, 1, tan(self.theta0), 0],
        ]

    def B(self) -> Rows:
        return [
            [self.Ylat, self.Yped],
            [self.Llat, self.Lped],
            [self.Nlat, self.Nped],
            [0, 0],
        ]

    def C(self) -> Rows:
        return [
            [self.Yv, self.Yp, self.Yr, 0],
            [0, 1, 0, 0],
            [0, 0, 1, 0],
            [0, 0, 0, 1],
        ]

    def D(self) -> Rows:
        return [[self.Ylat, self.Yped], [0, 0], [0, 0], [0, 0]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"lat": self.tau_lat, "ped": self.tau_ped}
