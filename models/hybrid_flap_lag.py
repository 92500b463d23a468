"""Six degrees of freedom with flapping and the regressing lag mode.

`hybrid_flap.py` and lead-lag: M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System
Identification, 2nd ed., chapter 15. Of the two cyclic lag modes in the fixed frame the regressing
one, a whirl at the rotor speed less the lag frequency, lies in the band of flight control: two
states lc, ls (stick times second; the sticks' unit coefficients fix their scale), whose inertia
forces reach the hub as the moments Llc, Mls. (The source appends a quadratic dipole to each cyclic
instead: four states.) Of the derivatives of `hybrid_flap.py` those of forces and disk that a UH-60
can do without are left out; J rises from 26 to 32.

What identifies it: what `hybrid_flap.py` asks for, with energy to 20 rad/s. Where the lag mode's
dip in p/lat and q/lon is not seen in the data, use `hybrid_flap.py`.
"""

from collections.abc import Mapping
from math import cos, sin

from casid import Model, Rows, Scalar, parameter


class HybridFlapLag(Model):
    """Rigid-body, flapping and lag derivatives."""

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta", "b1c", "b1s", "lc", "ls")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")

    Xu: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.5, unit="1/s")
    Xw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xb1c: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xcol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
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
    Lb1c: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lb1s: Scalar = parameter(default=50.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Llc: Scalar = parameter(default=40.0, lower=-200.0, upper=200.0, unit="rad/s^3")
    Lcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llat: Scalar = parameter(default=20.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Llon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mb1c: Scalar = parameter(default=20.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mls: Scalar = parameter(default=10.0, lower=-200.0, upper=200.0, unit="rad/s^3")
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
    Mfped: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lfc: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Lfs: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Lflat: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lflon: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lfped: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    lag_damping: Scalar = parameter(default=3.0, lower=0.0, upper=20.0, unit="1/s")
    lag_rate: Scalar = parameter(default=8.0, lower=-30.0, upper=30.0, unit="rad/s")
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
            [s.Xu, 0, s.Xw, 0, s.Xq - W0, V0, 0, -g * cth, s.Xb1c, 0, 0, 0],
            [0, s.Yv, 0, W0, s.Yq, -U0, *gy, 0, s.Yb1s, 0, 0],
            [0, 0, s.Zw, s.Zp - V0, U0, s.Zr, *gz, 0, 0, 0, 0],
            [0, s.Lv, s.Lw, 0, 0, 0, 0, 0, s.Lb1c, s.Lb1s, s.Llc, 0],
            [s.Mu, s.Mv, s.Mw, 0, 0, s.Mr, 0, 0, s.Mb1c, 0, 0, s.Mls],
            [s.Nu, s.Nv, s.Nw, s.Np, s.Nq, s.Nr, 0, 0, s.Nb1c, s.Nb1s, 0, 0],
            [0, 0, 0, 1, sphi * sth / cth, cphi * sth / cth, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, cphi, -sphi, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, -1, 0, 0, 0, s.Mfc, s.Mfs, 0, 0],
            [0, 0, 0, -1, 0, 0, 0, 0, s.Lfc, s.Lfs, 0, 0],
            [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, -s.lag_damping, -s.lag_rate],
            [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, s.lag_rate, -s.lag_damping],
        ]

    def B(self) -> Rows:
        return [
            [self.Xcol, self.Xlat, self.Xlon, 0],
            [self.Ycol, self.Ylat, self.Ylon, self.Yped],
            [self.Zcol, self.Zlat, self.Zlon, self.Zped],
            [self.Lcol, self.Llat, self.Llon, self.Lped],
            [self.Mcol, self.Mlat, self.Mlon, self.Mped],
            [self.Ncol, 0, self.Nlon, self.Nped],
            *[[0] * 4] * 2,
            [self.Mfcol, 0, 0, self.Mfped],
            [0, self.Lflat, self.Lflon, self.Lfped],
            [0, 0, 1, 0],
            [0, 1, 0, 0],
        ]

    def C(self) -> Rows:
        return [
            [self.Xu, 0, self.Xw, 0, self.Xq, 0, 0, 0, self.Xb1c, 0, 0, 0],
            [0, self.Yv, 0, 0, self.Yq, 0, 0, 0, 0, self.Yb1s, 0, 0],
            [0, 0, self.Zw, self.Zp, 0, self.Zr, 0, 0, 0, 0, 0, 0],
            *([float(i == j) for j in range(12)] for i in range(3, 8)),  # p q r phi theta
        ]

    def D(self) -> Rows:
        return [*self.B()[:3], *[[0] * 4] * 5]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lat": self.tau_lat, "lon": self.tau_lon, "ped": self.tau_ped}
