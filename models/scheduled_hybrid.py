"""The rotor's flapping over airspeed: six degrees of freedom, derivatives by speed, trim curves.

As `scheduled_six_dof.py`, with the tip-path plane's tilt b1c, b1s [rad] from its trim as states, as
in `hybrid_flap.py`: p and q leave it behind, the thrust is normal to it, and its tilt moves the
body. Thrust Z Newton takes the forces along: Xtilt, Ytilt are the disk's tilt in trim, Lhub, Mhub
what more thrust adds to the moment of a tilt, by the hub's height; Mww is the moment by the square
of w, of a fuselage and a tail in the wake. So large motions are no linear ones, while what is slow
rests on few derivatives (R. K. Heffley, M. A. Mnich, NASA CR-177476; flapping: M. B. Tischler,
R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapter 15).

Derivatives are those at U0; each changes by its ``_V``, some in addition by the square of its
``_VV``, over ``span``. Xu ... Nu are what speed has beyond the trim curves, which are in balance:
hold them at 0, ``fixed=ScheduledHybrid.balance``, or see whether trims and manoeuvres agree.

What identifies it: sharp 3-2-1-1 of all four controls from three or more trim speeds, in total
values, at 20 Hz or more, with ax ay az p q r phi theta, and u.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import casadi as ca

from casid import NonlinearModel, Scalar, parameter, spline

CURVES = ("v", "w", "phi", "theta", "col", "lat", "lon", "ped")


class ScheduledHybrid(NonlinearModel):
    """Rigid body and flapping about balanced trim curves; see the module."""

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta", "b1c", "b1s")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "u")
    balance: ClassVar = tuple(f"{axis}u" for axis in "XYZLMN")

    Xu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Zu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Lu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nu: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Yv: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.0, unit="1/s")
    Yped: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Zb1c: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="m/s^2")
    Zcol: Scalar = parameter(default=-80.0, lower=-200.0, upper=0.0, unit="m/s^2")
    Lv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lr: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Lb1c: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lb1s: Scalar = parameter(default=30.0, lower=0.0, upper=200.0, unit="1/s^2")
    Lcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mq: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mb1c: Scalar = parameter(default=10.0, lower=0.0, upper=200.0, unit="1/s^2")
    Mb1s: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mcol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlat: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Np: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Nr: Scalar = parameter(default=-0.6, lower=-5.0, upper=0.0, unit="1/s")
    Nb1s: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Ncol: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=-3.0, lower=-30.0, upper=30.0, unit="rad/s^2")
    Mfb1c: Scalar = parameter(default=-12.0, lower=-40.0, upper=0.0, unit="1/s")
    Mfb1s: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Mfv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Mfw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Mfcol: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Mflat: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Mflon: Scalar = parameter(default=-5.0, lower=-20.0, upper=20.0, unit="rad/s")
    Lfb1c: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Lfb1s: Scalar = parameter(default=-12.0, lower=-40.0, upper=0.0, unit="1/s")
    Lfv: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Lfw: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Lfcol: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Lflat: Scalar = parameter(default=5.0, lower=-20.0, upper=20.0, unit="rad/s")
    Lflon: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Xtilt: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="-")
    Ytilt: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="-")
    Lhub: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="1/m")
    Mhub: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/m")
    Mww: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="rad/m^2")
    tau_col: Scalar = parameter(default=0.0, lower=0.0, upper=0.25, unit="s")
    tau_lat: Scalar = parameter(default=0.0, lower=0.0, upper=0.25, unit="s")
    tau_lon: Scalar = parameter(default=0.0, lower=0.0, upper=0.25, unit="s")
    tau_ped: Scalar = parameter(default=0.0, lower=0.0, upper=0.25, unit="s")
    Yv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="1/s")
    Yped_V: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Zw_V: Scalar = parameter(default=0.0, lower=-1.0, upper=1.0, unit="1/s")
    Zb1c_V: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="m/s^2")
    Zcol_V: Scalar = parameter(default=0.0, lower=-100.0, upper=100.0, unit="m/s^2")
    Lv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lb1c_V: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lcol_V: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llon_V: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mq_V: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Mb1c_V: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mcol_V: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nr_V: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Ncol_V: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nlon_V: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped_V: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mfb1c_V: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Mfv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Mfw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Mfcol_V: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Lfv_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Lfw_V: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Lfcol_V: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Xtilt_V: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="-")
    Ytilt_V: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="-")
    Mhub_V: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/m")
    Mww_V: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="rad/m^2")
    Zw_VV: Scalar = parameter(default=0.0, lower=-1.0, upper=1.0, unit="1/s")
    Zb1c_VV: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="m/s^2")
    Lv_VV: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mw_VV: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nv_VV: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Nr_VV: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="1/s")
    Ncol_VV: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Nped_VV: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mfw_VV: Scalar = parameter(default=0.0, lower=-0.5, upper=0.5, unit="rad/m")
    Mww_VV: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="rad/m^2")

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

    def at_speed(self, name: str, V: Any) -> Any:  # noqa: ANN401
        """A derivative at a speed."""
        faster = (V - self.U0) / self.span
        slope = getattr(self, f"{name}_V", 0.0) + getattr(self, f"{name}_VV", 0.0) * faster
        return getattr(self, name, 0.0) + slope * faster

    def linear(self, axis: str, x: Any, u: Any) -> Any:  # noqa: ANN401
        """Derivatives of an axis, at the speed, times what has left the trim curves."""
        rest, found = self.trim_at(x.u), getattr(self, f"{axis}u", 0.0) * (x.u - self.U0)
        for name in (*self.states[1:], *self.inputs):
            value = getattr(x if name in self.states else u, name)
            found += self.at_speed(f"{axis}{name}", x.u) * (value - rest.get(name, 0.0))
        return found

    def aerodynamics(self, x: Any, u: Any) -> list[Any]:  # noqa: ANN401
        """Specific forces and angular accelerations."""
        X, Y, more, L, M, N = (self.linear(axis, x, u) for axis in "XYZLMN")
        rest = self.trim_at(x.u)
        Z = more - self.g * ca.cos(rest["theta"]) * ca.cos(rest["phi"])
        X += self.g * ca.sin(rest["theta"]) + Z * x.b1c + self.at_speed("Xtilt", x.u) * more
        Y -= self.g * ca.cos(rest["theta"]) * ca.sin(rest["phi"]) + Z * x.b1s
        Y += self.at_speed("Ytilt", x.u) * more
        L -= self.at_speed("Lhub", x.u) * more * x.b1s
        M -= self.at_speed("Mhub", x.u) * more * x.b1c
        M += self.at_speed("Mww", x.u) * (x.w - rest["w"]) ** 2
        return [X, Y, Z, L, M, N]

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
            self.linear("Mf", x, u) - x.q,
            self.linear("Lf", x, u) - x.p,
        ]

    def measurements(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        return [*self.aerodynamics(x, u)[:3], x.p, x.q, x.r, x.phi, x.theta, x.u]

    def delays(self) -> Mapping[str, Scalar]:
        return {"col": self.tau_col, "lat": self.tau_lat, "lon": self.tau_lon, "ped": self.tau_ped}
