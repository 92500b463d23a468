"""A rigid body in total values: full Euler kinematics and gravity, linear aerodynamics.

G. D. Padfield, Helicopter Flight Dynamics, 2nd ed., appendix 4A: specific forces and angular
accelerations are linear about a reference condition in velocities, rates and controls, as in
`models/six_dof.py`, whose parameters these are: large manoeuvres at one speed.

What identifies it: records of all four controls in total values (u, v, w as outputs too if they are
measured), all at the reference condition. `RigidBody().at(trim)` is `SixDof` at that trim.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from casid import NonlinearModel, Scalar, parameter


class RigidBody(NonlinearModel):
    """Rigid-body derivatives of a helicopter in total values; moments are over the inertias."""

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
    # What the trim of the records leaves of the balance at the reference condition.
    Xtrim: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="m/s^2")
    Ytrim: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="m/s^2")
    Ztrim: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="m/s^2")
    Ltrim: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/s^2")
    Mtrim: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/s^2")
    Ntrim: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/s^2")
    # The reference condition: velocities [m/s], rates [rad/s], attitudes [rad], controls.
    U0: float = 41.15
    V0: float = 0.0
    W0: float = 0.0
    P0: float = 0.0
    Q0: float = 0.0
    R0: float = 0.0
    phi0: float = 0.0
    theta0: float = 0.0
    col0: float = 0.0
    lat0: float = 0.0
    lon0: float = 0.0
    ped0: float = 0.0
    g: float = 9.80665

    def reference(self) -> Mapping[str, Scalar]:
        names = {"u": "U0", "v": "V0", "w": "W0", "p": "P0", "q": "Q0", "r": "R0"}
        names |= {name: f"{name}0" for name in ("phi", "theta", *self.inputs)}
        return {name: getattr(self, constant) for name, constant in names.items()}

    def aerodynamics(self, x: Any, u: Any) -> list[Any]:  # noqa: ANN401
        """Specific forces [m/s^2] and angular accelerations [rad/s^2] along and about each axis."""
        s, sth, cth = self, ca.sin(self.theta0), ca.cos(self.theta0)
        at_rest = {
            "X": s.Q0 * s.W0 - s.R0 * s.V0 + s.g * sth,
            "Y": s.R0 * s.U0 - s.P0 * s.W0 - s.g * cth * ca.sin(s.phi0),
            "Z": s.P0 * s.V0 - s.Q0 * s.U0 - s.g * cth * ca.cos(s.phi0),
        }
        rest = self.reference()
        moved = {n: getattr(x, n) - rest[n] for n in self.states[:6]}
        moved |= {n: getattr(u, n) - rest[n] for n in self.inputs}
        return [
            at_rest.get(axis, 0.0) + getattr(s, f"{axis}trim")
            + sum(getattr(s, f"{axis}{name}") * step for name, step in moved.items())
            for axis in "XYZLMN"
        ]  # fmt: skip

    def derivatives(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        (X, Y, Z, *moments), tth = self.aerodynamics(x, u), ca.tan(x.theta)
        sphi, cphi, sth, cth = ca.sin(x.phi), ca.cos(x.phi), ca.sin(x.theta), ca.cos(x.theta)
        return [
            X - x.q * x.w + x.r * x.v - self.g * sth,
            Y - x.r * x.u + x.p * x.w + self.g * cth * sphi,
            Z - x.p * x.v + x.q * x.u + self.g * cth * cphi,
            *moments,
            x.p + (x.q * sphi + x.r * cphi) * tth,
            x.q * cphi - x.r * sphi,
        ]

    def measurements(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        return [*self.aerodynamics(x, u)[:3], x.p, x.q, x.r, x.phi, x.theta]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lat": self.tau_lat, "lon": self.tau_lon, "ped": self.tau_ped}
