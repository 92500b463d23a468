"""Six degrees of freedom about a trimmed flight condition, quasi-steady rotor.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 4: eight rigid-body states, four controls, 36 stability and 24 control derivatives; a pure
delay of each control stands for rotor and actuator lags. Small-perturbation equations as in
G. D. Padfield, Helicopter Flight Dynamics, 2nd ed., appendix 4A, here with trim rates P0, Q0, R0.

What identifies it: 3-2-1-1 or sweep records of all four controls, 0.3-12 rad/s, with ax ay az p q r
phi theta measured at (or moved to) the centre of gravity. Guesses and bounds are per full travel
of a stick: read sticks recorded in % with ``units={"lat": "%"}``, which makes them fractions.
"""

from collections.abc import Mapping
from math import cos, sin

from casid import Model, Rows, Scalar, parameter


class SixDof(Model):
    """Rigid-body derivatives of a helicopter.

    Those of moments are over the inertias, L and N the primed ones: with Ixz included.
    """

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")

    Xu: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.0, unit="1/s")
    Xv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")

    Yu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")

    Zu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")

    Lu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Lq: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Lr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")

    Mu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mp: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mq: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")
    Mr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")

    Nu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Np: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Nq: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Nr: Scalar = parameter(default=-0.6, lower=-5.0, upper=0.0, unit="1/s")

    Xcol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ycol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ylat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ylon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Yped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zcol: Scalar = parameter(default=-80.0, lower=-200.0, upper=0.0, unit="m/s^2")
    Zlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Lcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llat: Scalar = parameter(default=20.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Llon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlat: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlon: Scalar = parameter(default=8.0, lower=-30.0, upper=30.0, unit="rad/s^2")
    Mped: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Ncol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlat: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=6.0, lower=-30.0, upper=30.0, unit="rad/s^2")

    tau_col: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")
    tau_lat: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")
    tau_lon: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")
    tau_ped: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")

    # Trim: velocities [m/s], rates [rad/s], attitudes [rad]; never estimated.
    U0: float = 41.15
    V0: float = 0.0
    W0: float = 0.0
    P0: float = 0.0
    Q0: float = 0.0
    R0: float = 0.0
    phi0: float = 0.0
    theta0: float = 0.0
    g: float = 9.80665

    def A(self) -> Rows:
        s, U0, V0, W0, P0, Q0, R0 = self, self.U0, self.V0, self.W0, self.P0, self.Q0, self.R0
        sphi, cphi, sth, cth = sin(s.phi0), cos(s.phi0), sin(s.theta0), cos(s.theta0)
        gx, gy, gz = -s.g * cth, s.g * cphi * cth, -s.g * sphi * cth
        turn, bank, tth = Q0 * sphi + R0 * cphi, Q0 * cphi - R0 * sphi, sth / cth
        return [
            [s.Xu, s.Xv + R0, s.Xw - Q0, s.Xp, s.Xq - W0, s.Xr + V0, 0, gx],
            [s.Yu - R0, s.Yv, s.Yw + P0, s.Yp + W0, s.Yq, s.Yr - U0, gy, -s.g * sphi * sth],
            [s.Zu + Q0, s.Zv - P0, s.Zw, s.Zp - V0, s.Zq + U0, s.Zr, gz, -s.g * cphi * sth],
            [s.Lu, s.Lv, s.Lw, s.Lp, s.Lq, s.Lr, 0, 0],
            [s.Mu, s.Mv, s.Mw, s.Mp, s.Mq, s.Mr, 0, 0],
            [s.Nu, s.Nv, s.Nw, s.Np, s.Nq, s.Nr, 0, 0],
            [0, 0, 0, 1, sphi * tth, cphi * tth, bank * tth, turn / cth**2],
            [0, 0, 0, 0, cphi, -sphi, -turn, 0],
        ]

    def B(self) -> Rows:
        return [
            [self.Xcol, self.Xlat, self.Xlon, self.Xped],
            [self.Ycol, self.Ylat, self.Ylon, self.Yped],
            [self.Zcol, self.Zlat, self.Zlon, self.Zped],
            [self.Lcol, self.Llat, self.Llon, self.Lped],
            [self.Mcol, self.Mlat, self.Mlon, self.Mped],
            [self.Ncol, self.Nlat, self.Nlon, self.Nped],
            *[[0] * 4] * 2,
        ]

    def C(self) -> Rows:
        return [
            [self.Xu, self.Xv, self.Xw, self.Xp, self.Xq, self.Xr, 0, 0],
            [self.Yu, self.Yv, self.Yw, self.Yp, self.Yq, self.Yr, 0, 0],
            [self.Zu, self.Zv, self.Zw, self.Zp, self.Zq, self.Zr, 0, 0],
            *([float(i == j) for j in range(8)] for i in range(3, 8)),  # p q r phi theta
        ]

    def D(self) -> Rows:
        return [*self.B()[:3], *[[0] * 4] * 5]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lat": self.tau_lat, "lon": self.tau_lon, "ped": self.tau_ped}
