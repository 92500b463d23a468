"""Longitudinal motion of a fixed wing by aerodynamic coefficients, in total values.

    V' = (T cos α − q̄ S CD)/m − g sin γ,    α' = q − (q̄ S CL + T sin α)/(m V) + g cos γ / V,
    q' = q̄ S c Cm / Iy,    θ' = q,          q̄ = ρ V²/2,  γ = θ − α

CL and Cm are linear in angle of attack, elevator, pitch rate and the rate of the angle of attack,
drag is a parabola over lift; speed enters through q̄ and, as compressibility or slipstream, through
CL_V and Cm_V. R. C. Nelson, Flight Stability and Automatic Control, 2nd ed., chapters 3 and 4: the
guesses and constants are those of its Navion at sea level and 176 ft/s.

What identifies it: elevator doublets and 3-2-1-1 from several trim speeds (one speed leaves CL0,
CL_V and thrust, and Cm0 and Cm_V, told apart by the phugoid alone), with V, alpha, q, theta and the
specific forces ax, az measured at the centre of gravity.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import casadi as ca

from casid import NonlinearModel, Scalar, parameter


class LongitudinalAero(NonlinearModel):
    """Coefficients of lift, drag and pitching moment; elevator [rad], thrust over mass held."""

    states = ("V", "alpha", "q", "theta")
    inputs = ("elevator",)
    outputs = ("V", "alpha", "q", "theta", "ax", "az")
    units: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"V": "m/s", "alpha": "rad", "q": "rad/s", "theta": "rad", "elevator": "rad"}
    )

    CL0: Scalar = parameter(default=0.406, lower=-0.5, upper=1.5, unit="-")
    CLalpha: Scalar = parameter(default=4.44, lower=1.0, upper=8.0, unit="1/rad")
    CLelevator: Scalar = parameter(default=0.355, lower=0.0, upper=2.0, unit="1/rad")
    CL_V: Scalar = parameter(default=0.0, lower=-1.0, upper=1.0, unit="-")
    CDmin: Scalar = parameter(default=0.035, lower=0.005, upper=0.2, unit="-")
    CDlift: Scalar = parameter(default=0.0906, lower=0.0, upper=0.5, unit="-")
    Cm0: Scalar = parameter(default=0.0, lower=-0.3, upper=0.3, unit="-")
    Cmalpha: Scalar = parameter(default=-0.683, lower=-4.0, upper=1.0, unit="1/rad")
    Cmalphadot: Scalar = parameter(default=-4.36, lower=-20.0, upper=0.0, unit="1/rad")
    Cmq: Scalar = parameter(default=-9.96, lower=-60.0, upper=0.0, unit="1/rad")
    Cmelevator: Scalar = parameter(default=-0.923, lower=-4.0, upper=0.0, unit="1/rad")
    Cm_V: Scalar = parameter(default=0.0, lower=-1.0, upper=1.0, unit="-")
    thrust: Scalar = parameter(default=1.207, lower=-1.0, upper=10.0, unit="m/s^2")

    m: float = 1247.4  # kg
    Iy: float = 4067.5  # kg m^2
    S: float = 17.09  # m^2
    c: float = 1.737  # m, mean chord
    rho: float = 1.225  # kg/m^3
    g: float = 9.80665
    V0: float = 53.645  # m/s, the speed about which CL_V and Cm_V count
    alpha0: float = 0.0  # rad
    theta0: float = 0.0  # rad
    elevator0: float = 0.0  # rad

    def reference(self) -> Mapping[str, Scalar]:
        held = {"V": self.V0, "alpha": self.alpha0, "theta": self.theta0}
        return held | {"elevator": self.elevator0}

    def _loads(self, x: Any, u: Any) -> tuple[Any, Any, Any]:  # noqa: ANN401
        """Lift and drag over mass [m/s^2], q̄ S c/Iy [1/s^2]."""
        faster = x.V / self.V0 - 1
        CL = self.CL0 + self.CLalpha * x.alpha + self.CLelevator * u.elevator + self.CL_V * faster
        load = self.rho * x.V**2 / 2 * self.S
        CD = self.CDmin + self.CDlift * CL**2
        return load * CL / self.m, load * CD / self.m, load * self.c / self.Iy

    def derivatives(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        lift, drag, moment = self._loads(x, u)
        climb, half = x.theta - x.alpha, self.c / (2 * x.V)
        alpha_rate = x.q - (lift + self.thrust * ca.sin(x.alpha)) / x.V
        alpha_rate += self.g * ca.cos(climb) / x.V
        Cm = self.Cm0 + self.Cmalpha * x.alpha + self.Cmelevator * u.elevator
        Cm += self.Cm_V * (x.V / self.V0 - 1)
        Cm += half * (self.Cmq * x.q + self.Cmalphadot * alpha_rate)
        return [
            self.thrust * ca.cos(x.alpha) - drag - self.g * ca.sin(climb),
            alpha_rate,
            moment * Cm,
            x.q,
        ]

    def measurements(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        lift, drag, _ = self._loads(x, u)
        sin, cos = ca.sin(x.alpha), ca.cos(x.alpha)
        ax, az = self.thrust + lift * sin - drag * cos, -lift * cos - drag * sin
        return [x.V, x.alpha, x.q, x.theta, ax, az]
