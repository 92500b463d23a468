"""Six degrees of freedom with flapping and the regressing lag mode.

`hybrid_flap.py` and lead-lag: M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System
Identification, 2nd ed., chapter 15; M. Tischler, M. Cauffman, J. American Helicopter Society 37(3),
1992. Of the two cyclic lag modes in the fixed frame the regressing one, at the rotor speed less the
lag frequency, lies in the band of flight control. It is a whirl, so two states hold it,

    lc' = Mgc lc + Mgs ls + lon        ls' = Lgc lc + Lgs ls + lat

whose inertia forces reach the hub as moments Llc, Lls, Mlc, Mls. (The source appends a quadratic
dipole to each cyclic instead: four states.) The unit coefficients of the sticks fix the scale of
lc and ls, which are no angles but stick times second [s].

What identifies it: what `hybrid_flap.py` asks for, with energy to 20 rad/s. Where the lag mode's
dip in p/lat and q/lon is not seen in the data, use `hybrid_flap.py`.
"""

from collections.abc import Mapping
from math import cos, sin, tan

from casid import Model, Rows, Scalar, parameter


class HybridFlapLag(Model):
    """Rigid-body, flapping and lag derivatives."""

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta", "b1c", "b1s", "lc", "ls")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")

    Xu: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.5, unit="1/s")
    Xv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xb1c: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xcol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Xped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")

    Yu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yb1s: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ycol: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ylat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Ylon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Yped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")

    Zu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zcol: Scalar = parameter(default=-80.0, lower=-200.0, upper=0.0, unit="m/s^2")
    Zlat: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zlon: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")

    Lu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Lb1c: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lb1s: Scalar = parameter(default=50.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Llc: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="rad/s^3")
    Lls: Scalar = parameter(default=-30.0, lower=-200.0, upper=200.0, unit="rad/s^3")
    Lcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llat: Scalar = parameter(default=20.0, lower=0.0, upper=60.0, unit="rad/s^2")
    Llon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")

    Mu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mb1c: Scalar = parameter(default=20.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mb1s: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mlc: Scalar = parameter(default=40.0, lower=-200.0, upper=200.0, unit="rad/s^3")
    Mls: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="rad/s^3")
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
    Nlat: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=6.0, lower=-30.0, upper=30.0, unit="rad/s^2")

    Mfc: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Mfs: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Mfcol: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Mflat: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Mflon: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Mfped: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lfc: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Lfs: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Lfcol: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lflat: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lflon: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Lfped: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s")
    Mgc: Scalar = parameter(default=-3.0, lower=-20.0, upper=0.0, unit="1/s")
    Mgs: Scalar = parameter(default=-8.0, lower=-30.0, upper=30.0, unit="1/s")
    Lgc: Scalar = parameter(default=8.0, lower=-30.0, upper=30.0, unit="1/s")
    Lgs: Scalar = parameter(default=-3.0, lower=-20.0, upper=0.0, unit="1/s")

    tau_col: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")
    tau_lat: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")
    tau_lon: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")
    tau_ped: Scalar = parameter(default=0.02, lower=0.0, upper=0.25, unit="s")

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

    def loads(self) -> list[list[Scalar]]:
        """Rows X Y Z of specific force and L M N of angular acceleration over the states."""
        body: list[list[Scalar]] = [
            [self.Xu, self.Xv, self.Xw, self.Xp, self.Xq, self.Xr, 0, 0],
            [self.Yu, self.Yv, self.Yw, self.Yp, self.Yq, self.Yr, 0, 0],
            [self.Zu, self.Zv, self.Zw, self.Zp, self.Zq, self.Zr, 0, 0],
            [self.Lu, self.Lv, self.Lw, 0, 0, self.Lr, 0, 0],
            [self.Mu, self.Mv, self.Mw, 0, 0, self.Mr, 0, 0],
            [self.Nu, self.Nv, self.Nw, self.Np, self.Nq, self.Nr, 0, 0],
        ]
        rotor: list[list[Scalar]] = [
            [self.Xb1c, 0, 0, 0],
            [0, self.Yb1s, 0, 0],
            [0, 0, 0, 0],
            [self.Lb1c, self.Lb1s, self.Llc, self.Lls],
            [self.Mb1c, self.Mb1s, self.Mlc, self.Mls],
            [self.Nb1c, self.Nb1s, 0, 0],
        ]
        return [a + b for a, b in zip(body, rotor, strict=True)]

    def controls(self) -> list[list[Scalar]]:
        """The same rows over the controls."""
        return [
            [self.Xcol, self.Xlat, self.Xlon, self.Xped],
            [self.Ycol, self.Ylat, self.Ylon, self.Yped],
            [self.Zcol, self.Zlat, self.Zlon, self.Zped],
            [self.Lcol, self.Llat, self.Llon, self.Lped],
            [self.Mcol, self.Mlat, self.Mlon, self.Mped],
            [self.Ncol, self.Nlat, self.Nlon, self.Nped],
        ]

    def A(self) -> Rows:
        U0, V0, W0, P0, Q0, R0 = self.U0, self.V0, self.W0, self.P0, self.Q0, self.R0
        sphi, cphi = sin(self.phi0), cos(self.phi0)
        sth, cth, tth, g = sin(self.theta0), cos(self.theta0), tan(self.theta0), self.g
        turn, bank = Q0 * sphi + R0 * cphi, Q0 * cphi - R0 * sphi
        rest = [0] * 4
        inertial: Rows = [
            [0, R0, -Q0, 0, -W0, V0, 0, -g * cth, *rest],
            [-R0, 0, P0, W0, 0, -U0, g * cphi * cth, -g * sphi * sth, *rest],
            [Q0, -P0, 0, -V0, U0, 0, -g * sphi * cth, -g * cphi * sth, *rest],
        ]
        loads = self.loads()
        return [
            *(
                [a + f for a, f in zip(*rows, strict=True)]
                for rows in zip(inertial, loads[:3], strict=True)
            ),
            *loads[3:],
            [0, 0, 0, 1, sphi * tth, cphi * tth, bank * tth, turn / cth**2, *rest],
            [0, 0, 0, 0, cphi, -sphi, -turn, 0, *rest],
            [0, 0, 0, 0, -1, 0, 0, 0, self.Mfc, self.Mfs, 0, 0],
            [0, 0, 0, -1, 0, 0, 0, 0, self.Lfc, self.Lfs, 0, 0],
            [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, self.Mgc, self.Mgs],
            [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, self.Lgc, self.Lgs],
        ]

    def B(self) -> Rows:
        return [
            *self.controls(),
            [0, 0, 0, 0],
            [0, 0, 0, 0],
            [self.Mfcol, self.Mflat, self.Mflon, self.Mfped],
            [self.Lfcol, self.Lflat, self.Lflon, self.Lfped],
            [0, 0, 1, 0],
            [0, 1, 0, 0],
        ]

    def C(self) -> Rows:
        measured = range(3, 8)  # p q r phi theta
        rates = [[float(i == j) for j in range(len(self.states))] for i in measured]
        return [*self.loads()[:3], *rates]

    def D(self) -> Rows:
        return [*self.controls()[:3], *([0, 0, 0, 0] for _ in range(5))]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lat": self.tau_lat, "lon": self.tau_lon, "ped": self.tau_ped}
