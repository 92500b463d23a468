"""A helicopter by its components: one structure for all speeds above transition, no schedules.

Thrust by blade elements, flapping, flat-plate fuselage in the wake, tailplane that the wake may
reach, fin that may stall, torque by power, Euler's equations: R. K. Heffley, M. A. Mnich (NASA
CR-177476). Inflows lag by the mass of air that a rotor moves (G. J. Carpenter, B. Fridovich, NACA
TN 3044; D. M. Pitt, D. A. Peters, Vertica 5, 1981). Gravity, geometry and inertia are known.

What identifies it: total values of all four controls from two or more speeds, trims in them, with
ax ay az p q r phi theta u, sharp enough for the rotor (20 Hz or more).
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from casid import NonlinearModel, Scalar, parameter


def blade_flow(through: Any, squared: Any, pitch: Any, tip: float, twist: float) -> Any:  # noqa: ANN401
    """Flow down through a disk as its blades meet it, without the one they induce [m/s]."""
    return through + 2 / 3 * tip * pitch + squared / tip * (pitch - twist / 4)


def smooth_size(value: Any, width: float = 0.1) -> Any:  # noqa: ANN401
    """|value|, rounded within its width."""
    return ca.sqrt(value**2 + width**2)


class MinimumComplexity(NonlinearModel):
    """Forces per mass, M and N per own inertia, Lixz over Ix; blade pitch at 3/4 radius [rad]."""

    states = ("u", "v", "w", "p", "q", "r", "phi", "theta", "b1c", "b1s", "vi", "vi_tail")
    inputs = ("col", "lat", "lon", "ped")
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "u")

    # Thrust by the flow through a disk, and inflow by thrust (disk: m / (2 rho pi R^2)).
    lift: Scalar = parameter(default=1.0, lower=0.2, upper=3.0, unit="1/s")
    col_0: Scalar = parameter(default=0.0, lower=-0.3, upper=0.3, unit="rad")
    col_gain: Scalar = parameter(default=0.3, lower=0.1, upper=0.6, unit="rad")
    disk: Scalar = parameter(default=10.0, lower=3.0, upper=40.0, unit="m")
    inflow: Scalar = parameter(default=0.4, lower=0.05, upper=2.0, unit="1/m")
    shaft: Scalar = parameter(default=0.1, lower=-0.2, upper=0.3, unit="rad")
    # Flapping: own rate, cross rate, coupling, cyclic, flapback by speed.
    flap: Scalar = parameter(default=15.0, lower=2.0, upper=40.0, unit="1/s")
    cross: Scalar = parameter(default=7.0, lower=-20.0, upper=20.0, unit="1/s")
    lat_0: Scalar = parameter(default=-0.15, lower=-0.6, upper=0.6, unit="rad")
    lat_gain: Scalar = parameter(default=0.3, lower=-0.8, upper=0.8, unit="rad")
    lon_0: Scalar = parameter(default=-0.2, lower=-0.6, upper=0.6, unit="rad")
    lon_gain: Scalar = parameter(default=0.4, lower=-0.8, upper=0.8, unit="rad")
    coupling: Scalar = parameter(default=0.1, lower=-1.0, upper=1.0, unit="-")
    back: Scalar = parameter(default=3.0, lower=0.0, upper=10.0, unit="-")
    side: Scalar = parameter(default=0.7, lower=0.0, upper=2.0, unit="-")
    # Moments of a tilted rotor, its stiffness the same in roll and pitch; of thrust, profile drag.
    Mb1c: Scalar = parameter(default=4.0, lower=0.0, upper=200.0, unit="1/s^2")
    Mb1s: Scalar = parameter(default=3.0, lower=-50.0, upper=50.0, unit="1/s^2")
    Mthrust: Scalar = parameter(default=-0.04, lower=-1.0, upper=1.0, unit="1/m")
    Nprofile: Scalar = parameter(default=0.3, lower=0.0, upper=2.0, unit="1/s^2")
    Lixz: Scalar = parameter(default=0.4, lower=-0.8, upper=0.8, unit="-")
    tail_lift: Scalar = parameter(default=0.04, lower=0.005, upper=0.5, unit="1/s")
    tail_disk: Scalar = parameter(default=350.0, lower=50.0, upper=2000.0, unit="m")
    tail_inflow: Scalar = parameter(default=1.5, lower=0.3, upper=5.0, unit="1/m")
    ped_0: Scalar = parameter(default=-0.1, lower=-0.8, upper=0.8, unit="rad")
    ped_gain: Scalar = parameter(default=0.5, lower=-1.5, upper=1.5, unit="rad")
    Xuu: Scalar = parameter(default=-0.0002, lower=-0.01, upper=0.0, unit="1/m")
    Yvv: Scalar = parameter(default=-0.003, lower=-0.05, upper=0.0, unit="1/m")
    Zwake: Scalar = parameter(default=0.002, lower=-0.02, upper=0.02, unit="1/m")
    Mwake: Scalar = parameter(default=0.002, lower=-0.02, upper=0.02, unit="1/m^2")
    Muw: Scalar = parameter(default=-0.001, lower=-0.02, upper=0.0, unit="1/m^2")
    plane_0: Scalar = parameter(default=0.0, lower=-0.3, upper=0.3, unit="rad")
    Yfin: Scalar = parameter(default=-0.001, lower=-0.02, upper=0.0, unit="1/m")
    fin_0: Scalar = parameter(default=-0.05, lower=-0.5, upper=0.5, unit="rad")
    fin_stalled: Scalar = parameter(default=0.5, lower=0.0, upper=1.0, unit="-")

    g: float = 9.80665
    tip: float = 220.0  # m/s, of the blades
    tail_tip: float = 205.0  # m/s
    twist: float = -0.1  # rad, root to tip
    tail_twist: float = -0.1  # rad
    radius: float = 5.5  # m
    hub: float = 1.5  # m, above the centre of gravity
    tail: float = 6.0  # m, arms behind and above it
    tail_up: float = 0.9  # m
    plane: float = 5.0  # m
    plane_down: float = 1.1  # m, below the hub
    fin: float = 6.3  # m
    fin_up: float = 1.1  # m
    Iyx: float = 4.0  # Iy / Ix
    Izx: float = 4.0  # Iz / Ix
    gyration: float = 3.7  # m^2, Iy / m
    stall: float = 0.3  # rad, of the fin
    stall_width: float = 0.03  # rad, over which its slope changes
    trim: tuple[float, ...] = (31.0, 0.05, 0.32, 0.37, 0.65, 0.43)  # u, theta, sticks

    def reference(self) -> dict[str, Any]:
        (u, theta), names = self.trim[:2], ("u", "theta", *self.inputs)
        pitch, share = self.ped_0 + self.ped_gain * self.trim[-1], self.tail_lift * self.tail_disk
        flow = blade_flow(0.0, u**2, pitch, self.tail_tip, self.tail_twist)
        inflows = {"vi": self.g * self.disk / u, "vi_tail": flow * share / (u + share)}
        return {"w": u * theta, "b1c": 0.04} | inflows | dict(zip(names, self.trim, strict=True))

    def rotor(self, x: Any, u: Any) -> tuple[Any, Any, Any]:  # noqa: ANN401
        """Thrust per mass, flow down through the disk by motion alone, square of the speed."""
        squared, pitch = x.u**2 + x.v**2, self.col_0 + self.col_gain * u.col
        through = x.w + (x.b1c - self.shaft) * x.u - x.b1s * x.v
        flow = blade_flow(through, squared, pitch, self.tip, self.twist)
        return self.lift * (flow - x.vi), through, squared

    def tail_rotor(self, x: Any, u: Any) -> tuple[Any, Any, Any]:  # noqa: ANN401
        """Thrust to the right per mass, flow through the disk by motion, square of the speed."""
        squared, pitch = x.u**2 + (x.w + x.q * self.tail) ** 2, self.ped_0 + self.ped_gain * u.ped
        through = -(x.v - x.r * self.tail + x.p * self.tail_up)
        flow = blade_flow(through, squared, pitch, self.tail_tip, self.tail_twist)
        return self.tail_lift * (flow - x.vi_tail), through, squared

    def inflows(self, x: Any, u: Any) -> tuple[Any, Any]:  # noqa: ANN401
        """How both inflows settle where momentum balances thrust."""
        (T, through, squared), (side, across, along) = self.rotor(x, u), self.tail_rotor(x, u)
        main = self.disk * T - x.vi * ca.sqrt(squared + (through - x.vi) ** 2)
        tail = self.tail_disk * side - x.vi_tail * ca.sqrt(along + (across - x.vi_tail) ** 2)
        return self.inflow * main, self.tail_inflow * tail

    def fin_force(self, x: Any) -> Any:  # noqa: ANN401
        """To the right, per mass, with the tail rotor's wash."""
        slip = (x.v + x.vi_tail - x.r * self.fin) / x.u
        stalled = (1 + ca.tanh((slip**2 / self.stall - self.stall) / (2 * self.stall_width))) / 2
        flows, stalls = slip + self.fin_0, self.fin_stalled * slip * ca.sqrt(1 + slip**2)
        return self.Yfin * x.u**2 * ((1 - stalled) * flows + stalled * stalls)

    def fuselage(self, x: Any) -> tuple[Any, Any, Any]:  # noqa: ANN401
        """Drag, side force and download of the wake that meets it, per mass."""
        side, wake = self.Yvv * x.v * smooth_size(x.v), x.vi - x.w
        return self.Xuu * x.u**2, side, self.Zwake * wake * smooth_size(wake)

    def pitching(self, x: Any) -> tuple[Any, Any]:  # noqa: ANN401
        """Force down per mass of the tailplane, moment of it and the fuselage, met by the wake."""
        down = smooth_size(x.vi - x.w)
        within = (self.plane - x.u / down * self.plane_down) / self.radius
        hit = within + smooth_size(within, 0.03)  # twice the share, 0 outside
        flow = x.w + x.q * self.plane - hit * x.vi + self.plane_0 * x.u
        plane = self.Muw * x.u * flow
        return self.gyration * plane / self.plane, self.Mwake * x.u * down + plane

    def power(self, x: Any, u: Any) -> Any:  # noqa: ANN401
        """What induced flow, climb and the fuselage take, per mass [m^2/s^3]."""
        (T, through, _), (X, Y, Z) = self.rotor(x, u), self.fuselage(x)
        sink = ca.cos(x.theta) * (x.v * ca.sin(x.phi) + x.w * ca.cos(x.phi))
        climb = self.g * (x.u * ca.sin(x.theta) - sink)
        return T * (x.vi - through) + climb + Z * (x.vi - x.w) - Y * x.v - X * x.u

    def aerodynamics(self, x: Any, u: Any) -> list[Any]:  # noqa: ANN401
        """Specific forces and angular accelerations."""
        (T, _, squared), (side, *_) = self.rotor(x, u), self.tail_rotor(x, u)
        (lat, lon), (plane, pitch), fin = self.cyclic(u), self.pitching(x), self.fin_force(x)
        (drag, body, down), Iy, Ix = self.fuselage(x), self.gyration, self.gyration / self.Iyx
        tilt = self.Mb1c + self.hub * T / Iy
        L = self.Iyx * (tilt * x.b1s + self.Mb1s * (x.b1c + lon))
        L += (self.tail_up * side + self.fin_up * fin) / Ix
        M = tilt * x.b1c + self.Mb1s * (lat - x.b1s) + self.Mthrust * T + pitch
        torque = self.radius / self.tip * self.power(x, u) - self.tail * side - self.fin * fin
        N = torque / (self.Izx * Ix) + self.Nprofile * (1 + 3 * squared / self.tip**2)
        X, Y = drag - T * (x.b1c - self.shaft), body + T * x.b1s + side + fin
        return [X, Y, down + plane - T, *self.turning(x, L, M, N)]

    def turning(self, x: Any, L: Any, M: Any, N: Any) -> tuple[Any, Any, Any]:  # noqa: ANN401
        """Angular accelerations by moments, each per own inertia: Euler's equations."""
        Iyx, Izx, Ixz = self.Iyx, self.Izx, self.Lixz
        L += (Iyx - Izx) * x.q * x.r + Ixz * x.p * x.q
        M += ((Izx - 1) * x.p * x.r + Ixz * (x.r**2 - x.p**2)) / Iyx
        N += ((1 - Iyx) * x.p * x.q - Ixz * x.q * x.r) / Izx
        free = 1 - Ixz**2 / Izx
        return (L + Ixz * N) / free, M, (N + Ixz / Izx * L) / free

    def flapback(self, T: Any) -> Any:  # noqa: ANN401
        """Flapping by speed of theory [rad s/m]: 2 / tip (8 CT / (a sigma) + sqrt(CT / 2))."""
        return 2 / self.tip**2 * (2 * T / self.lift + ca.sqrt(smooth_size(self.disk * T)))

    def cyclic(self, u: Any) -> tuple[Any, Any]:  # noqa: ANN401
        return self.lat_0 + self.lat_gain * u.lat, self.lon_0 + self.lon_gain * u.lon

    def derivatives(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        (X, Y, Z, *turns), tth = self.aerodynamics(x, u), ca.tan(x.theta)
        sphi, cphi, sth, cth = ca.sin(x.phi), ca.cos(x.phi), ca.sin(x.theta), ca.cos(x.theta)
        (lat, lon), back = self.cyclic(u), self.back * self.flapback(self.rotor(x, u)[0])
        a = x.b1s - lat + self.coupling * x.b1c + self.side * back * x.v
        b = x.b1c + lon - self.coupling * x.b1s - back * x.u
        return [
            X - x.q * x.w + x.r * x.v - self.g * sth,
            Y - x.r * x.u + x.p * x.w + self.g * cth * sphi,
            Z - x.p * x.v + x.q * x.u + self.g * cth * cphi,
            *turns,
            x.p + (x.q * sphi + x.r * cphi) * tth,
            x.q * cphi - x.r * sphi,
            -self.flap * b - self.cross * a - x.q,
            -self.flap * a + self.cross * b - x.p,
            *self.inflows(x, u),
        ]

    def measurements(self, x: Any, u: Any) -> Sequence[Scalar]:  # noqa: ANN401
        return [*self.aerodynamics(x, u)[:3], x.p, x.q, x.r, x.phi, x.theta, x.u]
