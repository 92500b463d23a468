"""Six degrees of freedom over airspeed: scheduled derivatives and trim curves, in total values.

Derivatives as in `models/rigid_body.py`, at U0; each but the forces by rates changes by its ``_V``
over ``span`` (a subclass may add ``_VV``, parabolas). Forces and moments count from trim curves
over V = u, splines through measured trims of v, w, phi, theta, sticks, and are in balance on them:

    f(x0(V), u0(V), λ) = 0,    so that    A(V) x0′(V) + B(V) u0′(V) = 0

gives the speed derivatives, whatever the others are (G. D. Padfield, Helicopter Flight Dynamics,
2nd ed., section 4.3). Xu ... Nu are what they have beyond that: hold them at 0, as Xtrim ... Ntrim,
or estimate them and see whether trims and manoeuvres agree.

What identifies it: records of all four controls from two or more trim speeds, in total values, with
u among the outputs; ``fixed=ScheduledSixDof.balance`` holds the balance.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import casadi as ca

from casid import NonlinearModel, Scalar, parameter, spline

CURVES = ("v", "w", "phi", "theta", "col", "lat", "lon", "ped")


class ScheduledSixDof(NonlinearModel):
    """Derivatives linear in airspeed about balanced trim curves; see the module."""

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")
    balance: ClassVar = tuple(f"{axis}{name}" for axis in "XYZLMN" for name in ("u", "trim"))

    Xu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Lu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Xv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Xr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Yr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zp: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zq: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Zr: Scalar = parameter(default=0.0, lower=-15.0, upper=15.0, unit="m/(s rad)")
    Lv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Lq: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Lr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mp: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mq: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")
    Mr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
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
    Xtrim: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="m/s^2")
    Ytrim: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="m/s^2")
    Ztrim: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="m/s^2")
    Ltrim: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/s^2")
    Mtrim: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/s^2")
    Ntrim: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/s^2")
    Xv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Xcol_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Xlat_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Xlon_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Xped_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Yv_V: Scalar = parameter(default=0.0, lower=-0.4, upper=0.4, unit="1/s")
    Yw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Ycol_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Ylat_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Ylon_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Yped_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Zv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zw_V: Scalar = parameter(default=0.0, lower=-1.5, upper=1.5, unit="1/s")
    Zcol_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Zlat_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Zlon_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Zped_V: Scalar = parameter(default=0.0, lower=-100, upper=100, unit="m/s^2")
    Lv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp_V: Scalar = parameter(default=0.0, lower=-12.5, upper=12.5, unit="1/s")
    Lq_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="1/s")
    Lr_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="1/s")
    Lcol_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Llat_V: Scalar = parameter(default=0.0, lower=-30, upper=30, unit="rad/s^2")
    Llon_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Lped_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Mv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mp_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="1/s")
    Mq_V: Scalar = parameter(default=0.0, lower=-5, upper=5, unit="1/s")
    Mr_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="1/s")
    Mcol_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Mlat_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Mlon_V: Scalar = parameter(default=0.0, lower=-30, upper=30, unit="rad/s^2")
    Mped_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Nv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Np_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="1/s")
    Nq_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="1/s")
    Nr_V: Scalar = parameter(default=0.0, lower=-2.5, upper=2.5, unit="1/s")
    Ncol_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Nlat_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Nlon_V: Scalar = parameter(default=0.0, lower=-60, upper=60, unit="rad/s^2")
    Nped_V: Scalar = parameter(default=0.0, lower=-30, upper=30, unit="rad/s^2")

    U0: float = 41.15  # m/s
    g: float = 9.80665
    span: float = 10.0  # m/s
    speeds: tuple[float, ...] = (30.0, 50.0)  # m/s, of the trims
    curves: tuple[tuple[float, ...], ...] = ((0.0, 0.0),) * 8  # trims at them, as CURVES

    def trim_at(self, V: Any) -> dict[str, Any]:  # noqa: ANN401
        """States and inputs on the trim curves at a speed [m/s]."""
        named = zip(CURVES, self.curves, strict=True)
        return {"u": V} | {name: spline(V, self.speeds, curve) for name, curve in named}

    def reference(self) -> dict[str, Any]:
        return self.trim_at(self.U0)

    def linear(self, axis: str, x: Any, u: Any) -> Any:  # noqa: ANN401
        """Derivatives of an axis, at the speed, times what has left the trim curves."""
        rest, faster = self.trim_at(x.u), (x.u - self.U0) / self.span
        found = getattr(self, f"{axis}trim", 0.0) + getattr(self, f"{axis}u", 0.0) * (x.u - self.U0)
        for name in (*self.states[1:], *self.inputs):
            own, value = f"{axis}{name}", getattr(x if name in self.states else u, name)
            slope = getattr(self, f"{own}_V", 0.0) + getattr(self, f"{own}_VV", 0.0) * faster
            found += (getattr(self, own, 0.0) + slope * faster) * (value - rest.get(name, 0.0))
        return found

    def aerodynamics(self, x: Any, u: Any) -> list[Any]:  # noqa: ANN401
        """Specific forces and angular accelerations."""
        X, Y, Z, *moments = (self.linear(axis, x, u) for axis in "XYZLMN")
        rest = self.trim_at(x.u)
        X += self.g * ca.sin(rest["theta"])
        Y -= self.g * ca.cos(rest["theta"]) * ca.sin(rest["phi"])
        Z -= self.g * ca.cos(rest["theta"]) * ca.cos(rest["phi"])
        return [X, Y, Z, *moments]

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
