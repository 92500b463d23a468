"""Longitudinal and heave motion of a helicopter, decoupled from roll and yaw.

Phugoid, pitch and heave in three degrees of freedom: G. D. Padfield, Helicopter Flight Dynamics,
2nd ed., section 4.3.2, the longitudinal sub-matrix; as an identified structure M. B. Tischler and
R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 13.

What identifies it: collective and longitudinal stick, each excited once (3-2-1-1 or a sweep from
0.1 rad/s, where the phugoid lives, to about 10 rad/s), with ax, az, q and theta at the centre of
gravity, roll and yaw held near trim. Sticks as a fraction of full travel. Where roll follows the
longitudinal stick within a factor of five, take `six_dof.py`.
"""

from collections.abc import Mapping
from math import cos, sin

from casid import Model, Rows, Scalar, parameter


class Longitudinal(Model):
    """Derivatives of the specific forces X, Z and of the pitch acceleration M."""

    states = ("u", "w", "q", "theta")
    inputs = ("col", "lon")
    outputs = ("ax", "az", "q", "theta")

    Xu: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.0, unit="1/s")
    Xw: Scalar = parameter(default=0.02, lower=-0.5, upper=0.5, unit="1/s")
    Xq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zu: Scalar = parameter(default=-0.05, lower=-0.5, upper=0.5, unit="1/s")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Mu: Scalar = parameter(default=0.005, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw: Scalar = parameter(default=0.01, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")

    Xcol: Scalar = parameter(default=2.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlon: Scalar = parameter(default=-5.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zcol: Scalar = parameter(default=-80.0, lower=-200.0, upper=0.0, unit="m/s^2")
    Zlon: Scalar = parameter(default=-20.0, lower=-200.0, upper=200.0, unit="m/s^2")
    Mcol: Scalar = parameter(default=1.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlon: Scalar = parameter(default=8.0, lower=-30.0, upper=30.0, unit="rad/s^2")

    tau_col: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")
    tau_lon: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")

    # Trim: velocities [m/s], pitch attitude [rad]; never estimated.
    U0: float = 41.15
    W0: float = 0.0
    theta0: float = 0.0
    g: float = 9.80665

    def A(self) -> Rows:
        gx, gz = -self.g * cos(self.theta0), -self.g * sin(self.theta0)
        return [
            [self.Xu, self.Xw, self.Xq - self.W0, gx],
            [self.Zu, self.Zw, self.Zq + self.U0, gz],
            [self.Mu, self.Mw, self.Mq, 0],
            [0, 0, 1, 0],
        ]

    def B(self) -> Rows:
        return [
            [self.Xcol, self.Xlon],
            [self.Zcol, self.Zlon],
            [self.Mcol, self.Mlon],
            [0, 0],
        ]

    def C(self) -> Rows:
        return [
            [self.Xu, self.Xw, self.Xq, 0],
            [self.Zu, self.Zw, self.Zq, 0],
            [0, 0, 1, 0],
            [0, 0, 0, 1],
        ]

    def D(self) -> Rows:
        return [[self.Xcol, self.Xlon], [self.Zcol, self.Zlon], [0, 0], [0, 0]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lon": self.tau_lon}
