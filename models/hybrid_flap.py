"""Six degrees of freedom and the rotor's flapping: the hybrid model of an articulated rotor.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 15.
The tip-path plane tilts by b1c, b1s [rad] with first-order dynamics; p and q leave it behind (their
coefficient -1 fixes its scale), and its tilt moves the body, so Lp, Lq, Mp, Mq of `six_dof.py` are
gone. Mfs and Lfc hold the off-axis response. Unlike there each axis has its own flapping rate,
forces keep derivatives of p and q, and all controls tilt the disk and act on the body at once. Xr,
Yu, Yw, Zu, Zv, Zq, Lu, Lped, Nlat and Mflat are left out: on a UH-60 they change J by 2 % together.

What identifies it: records of all four controls with energy from 0.3 to 15 rad/s (the flapping is
at 3-15 rad/s: sweeps to 2.5 Hz, sharp 3-2-1-1), with ax ay az p q r phi theta at the centre of
gravity; flapping need not be measured. Sticks as a fraction of full travel.
"""

from collections.abc import Mapping
from math import cos, sin

from casid import Model, Rows, Scalar, parameter


class HybridFlap(Model):
    """Rigid-body and flapping derivatives."""

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta", "b1c", "b1s")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")

    Xu: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.5, unit="1/s")
    Xv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xb1c: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xcol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yb1s: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ycol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ylat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ylon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Yped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zcol: Scalar = parameter(default=-80.0, lower=-200.0, upper=0.0, unit="m/s^2")
    Zlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Lv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Lb1c: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lb1s: Scalar = parameter(default=50.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llat: Scalar = parameter(default=20.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Llon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mb1c: Scalar = parameter(default=20.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mb1s: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlat: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlon: Scalar = parameter(default=8.0, lower=-30.0, upper=30.0, unit="rad/s^2")
    Mped: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Np: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Nq: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Nr: Scalar = parameter(default=-0.6, lower=-5.0, upper=0.0, unit="1/s")
    Nb1c: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="1/s^2")
    Nb1s: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="1/s^2")
    Ncol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=6.0, lower=-30.0, upper=30.0, unit="rad/s^2")
    Mfc: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Mfs: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Mfcol: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Mflon: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Mfped: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lfc: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Lfs: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Lfcol: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lflat: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lflon: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lfped: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    tau_col: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")
    tau_lat: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")
    tau_lon: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")
    tau_ped: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")

    # Trim of straight flight: velocities [m/s], attitudes [rad]; never estimated.
    U0: float = 41.15
    V0: float = 0.0
    W0: float = 0.0
    phi0: float = 0.0
    theta0: float = 0.0
    g: float = 9.80665

    def A(self) -> Rows:
        s, U0, V0, W0, g = self, self.U0, self.V0, self.W0, self.g
        sphi, cphi, sth, cth = sin(s.phi0), cos(s.phi0), sin(s.theta0), cos(s.theta0)
        gy, gz = (g * cphi * cth, -g * sphi * sth), (-g * sphi * cth, -g * cphi * sth)
        return [
            [s.Xu, s.Xv, s.Xw, s.Xp, s.Xq - W0, V0, 0, -g * cth, s.Xb1c, 0],
            [0, s.Yv, 0, s.Yp + W0, s.Yq, s.Yr - U0, *gy, 0, s.Yb1s],
            [0, 0, s.Zw, s.Zp - V0, U0, s.Zr, *gz, 0, 0],
            [0, s.Lv, s.Lw, 0, 0, s.Lr, 0, 0, s.Lb1c, s.Lb1s],
            [s.Mu, s.Mv, s.Mw, 0, 0, s.Mr, 0, 0, s.Mb1c, s.Mb1s],
            [s.Nu, s.Nv, s.Nw, s.Np, s.Nq, s.Nr, 0, 0, s.Nb1c, s.Nb1s],
            [0, 0, 0, 1, sphi * sth / cth, cphi * sth / cth, 0, 0, 0, 0],
            [0, 0, 0, 0, cphi, -sphi, 0, 0, 0, 0],
            [0, 0, 0, 0, -1, 0, 0, 0, s.Mfc, s.Mfs],
            [0, 0, 0, -1, 0, 0, 0, 0, s.Lfc, s.Lfs],
        ]

    def B(self) -> Rows:
        return [
            [self.Xcol, self.Xlat, self.Xlon, self.Xped],
            [self.Ycol, self.Ylat, self.Ylon, self.Yped],
            [self.Zcol, self.Zlat, self.Zlon, self.Zped],
            [self.Lcol, self.Llat, self.Llon, 0],
            [self.Mcol, self.Mlat, self.Mlon, self.Mped],
            [self.Ncol, 0, self.Nlon, self.Nped],
            *[[0] * 4] * 2,
            [self.Mfcol, 0, self.Mflon, self.Mfped],
            [self.Lfcol, self.Lflat, self.Lflon, self.Lfped],
        ]

    def C(self) -> Rows:
        return [
            [self.Xu, self.Xv, self.Xw, self.Xp, self.Xq, 0, 0, 0, self.Xb1c, 0],
            [0, self.Yv, 0, self.Yp, self.Yq, self.Yr, 0, 0, 0, self.Yb1s],
            [0, 0, self.Zw, self.Zp, 0, self.Zr, 0, 0, 0, 0],
            *([float(i == j) for j in range(10)] for i in range(3, 8)),  # p q r phi theta
        ]

    def D(self) -> Rows:
        return [*self.B()[:3], *[[0] * 4] * 5]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lat": self.tau_lat, "lon": self.tau_lon, "ped": self.tau_ped}
