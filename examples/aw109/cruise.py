"""Longitudinal motion of a helicopter from 40 to 80 kn: derivatives over airspeed, trim curves.

The structure of the guide "identify one model for the envelope".
"""

import casadi as ca

from casid import NonlinearModel, Scalar, parameter, spline

SPEEDS = (20.53, 30.83, 41.14)  # m/s, of the trims below
W, THETA = (1.403, 1.528, 1.267), (0.0682, 0.0495, 0.0308)
COL, LON = (0.3491, 0.3168, 0.3110), (0.5811, 0.6472, 0.7245)


class Cruise(NonlinearModel):
    """Derivatives change with the speed, trims are measured."""

    states, inputs = ("u", "w", "q", "theta"), ("col", "lon")
    outputs = ("ax", "az", "q", "theta", "u")

    Xw: Scalar = parameter(default=0.0, lower=-0.3, upper=0.3, unit="1/s")
    Xw_V: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="1/s")
    Xcol: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="m/s^2")
    Xcol_V: Scalar = parameter(default=0.0, lower=-20, upper=20, unit="m/s^2")
    Xlon: Scalar = parameter(default=4.0, lower=-20, upper=20, unit="m/s^2")
    Zw: Scalar = parameter(default=-1.0, lower=-3, upper=0, unit="1/s")
    Zw_V: Scalar = parameter(default=0.0, lower=-1, upper=1, unit="1/s")
    Zcol: Scalar = parameter(default=-50.0, lower=-150, upper=0, unit="m/s^2")
    Zcol_V: Scalar = parameter(default=0.0, lower=-50, upper=50, unit="m/s^2")
    Zlon: Scalar = parameter(default=10.0, lower=-50, upper=50, unit="m/s^2")
    Zlon_V: Scalar = parameter(default=0.0, lower=-30, upper=30, unit="m/s^2")
    Mw: Scalar = parameter(default=0.0, lower=-0.3, upper=0.3, unit="rad/(m s)")
    Mw_V: Scalar = parameter(default=0.0, lower=-0.2, upper=0.2, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-1.0, lower=-5, upper=0, unit="1/s")
    Mq_V: Scalar = parameter(default=0.0, lower=-2, upper=2, unit="1/s")
    Mcol: Scalar = parameter(default=2.0, lower=-20, upper=20, unit="rad/s^2")
    Mcol_V: Scalar = parameter(default=0.0, lower=-10, upper=10, unit="rad/s^2")
    Mlon: Scalar = parameter(default=-4.0, lower=-20, upper=0, unit="rad/s^2")
    Mlon_V: Scalar = parameter(default=0.0, lower=-5, upper=5, unit="rad/s^2")
    tau_col: Scalar = parameter(default=0.05, lower=0, upper=0.2, unit="s")
    tau_lon: Scalar = parameter(default=0.05, lower=0, upper=0.2, unit="s")

    g: float = 9.80665

    def trim(self, V):
        curves = {"w": W, "theta": THETA, "col": COL, "lon": LON}
        return {name: spline(V, SPEEDS, values) for name, values in curves.items()}

    def forces(self, x, u):
        rest, faster = self.trim(x.u), (x.u - SPEEDS[1]) / 10.0
        w, col, lon = x.w - rest["w"], u.col - rest["col"], u.lon - rest["lon"]
        X = self.g * ca.sin(rest["theta"]) + (self.Xw + self.Xw_V * faster) * w
        X += (self.Xcol + self.Xcol_V * faster) * col + self.Xlon * lon
        Z = -self.g * ca.cos(rest["theta"]) + (self.Zw + self.Zw_V * faster) * w
        Z += (self.Zcol + self.Zcol_V * faster) * col + (self.Zlon + self.Zlon_V * faster) * lon
        M = (self.Mw + self.Mw_V * faster) * w + (self.Mq + self.Mq_V * faster) * x.q
        M += (self.Mcol + self.Mcol_V * faster) * col + (self.Mlon + self.Mlon_V * faster) * lon
        return X, Z, M

    def derivatives(self, x, u):
        X, Z, M = self.forces(x, u)
        return [
            X - x.q * x.w - self.g * ca.sin(x.theta),
            Z + x.q * x.u + self.g * ca.cos(x.theta),
            M,
            x.q,
        ]

    def measurements(self, x, u):
        return [*self.forces(x, u)[:2], x.q, x.theta, x.u]

    def reference(self):
        return {"u": SPEEDS[1]} | self.trim(SPEEDS[1])

    def delays(self):
        return {"col": self.tau_col, "lon": self.tau_lon}
