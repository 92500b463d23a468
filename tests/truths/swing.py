"""A pendulum with a motor: nonlinear at the amplitudes it is flown with, and its linear twins."""

from itertools import pairwise
from types import MappingProxyType

import casadi as ca
import numpy as np
import scipy

from casid import Model, NonlinearModel, Record, Scalar, parameter


class Swing(NonlinearModel):
    """q' = Mq q - M sin(theta) + Mlon cos(theta) lon(t - tau), total values."""

    states = ("q", "theta")
    inputs = ("lon",)
    outputs = ("q", "theta")
    units = MappingProxyType({"q": "rad/s", "theta": "rad"})

    Mq: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")
    M: Scalar = parameter(default=4.0, lower=0.0, upper=50.0, unit="1/s^2")
    Mlon: Scalar = parameter(default=5.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.3, unit="s")

    def derivatives(self, x, u):
        moment = self.Mq * x.q - self.M * ca.sin(x.theta)
        return [moment + self.Mlon * ca.cos(x.theta) * u.lon, x.q]

    def delays(self):
        return {"lon": self.tau}


class SmallSwing(Model):
    """The same for small angles."""

    states, inputs, outputs = Swing.states, Swing.inputs, Swing.outputs

    Mq: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")
    M: Scalar = parameter(default=4.0, lower=-50.0, upper=50.0, unit="1/s^2")
    Mlon: Scalar = parameter(default=5.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.3, unit="s")

    def A(self):
        return [[self.Mq, -self.M], [1, 0]]

    def B(self):
        return [[self.Mlon], [0]]

    def delays(self):
        return {"lon": self.tau}


class WrittenOut(NonlinearModel):
    """`SmallSwing` written as a nonlinear structure."""

    states, inputs, outputs = Swing.states, Swing.inputs, Swing.outputs

    Mq: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")
    M: Scalar = parameter(default=4.0, lower=-50.0, upper=50.0, unit="1/s^2")
    Mlon: Scalar = parameter(default=5.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.3, unit="s")

    def derivatives(self, x, u):
        return [self.Mq * x.q - self.M * x.theta + self.Mlon * u.lon, x.q]

    def delays(self):
        return {"lon": self.tau}


TRUTH = Swing(Mq=-0.8, M=6.0, Mlon=8.0, tau=0.073)


def steps(seed, t, size, every=0.7):
    """Random steps (N, 1) of a stick, the first of them zero."""
    levels = size * np.random.default_rng(seed).choice([-1.0, 1.0], int(t[-1] / every) + 2)
    levels[0] = 0.0
    return levels[(t / every).astype(int)][:, None]


def integrated(model, t, u, hold, x0, tolerance=1e-10):
    """States (N, 2) by SciPy, from one kink of the delayed input to the next."""
    tau = float(model.tau)

    def stick(s):
        if hold == "foh":
            return float(np.interp(s - tau, t, u[:, 0]))
        return float(u[max(int(np.searchsorted(t, s - tau + 1e-12, side="right")) - 1, 0), 0])

    names = np.unique(np.round(np.concatenate([t, t + tau]), 12))
    names = names[names <= t[-1] + 1e-12]
    x, kept = np.array(x0, dtype=float), [np.array(x0, dtype=float)]
    for a, b in pairwise(names):
        held = stick((a + b) / 2) if hold == "zoh" else None

        def f(s, x, held=held):
            lon = stick(s) if held is None else held
            return [
                model.Mq * x[0] - model.M * np.sin(x[1]) + model.Mlon * np.cos(x[1]) * lon,
                x[0],
            ]

        x = scipy.integrate.solve_ivp(f, (a, b), x, rtol=tolerance, atol=tolerance).y[:, -1]
        if np.abs(t - b).min() < 1e-10:
            kept.append(x)
    return np.array(kept)


def swung(seed=0, *, size=0.6, duration=12.0, dt=0.04, hold="foh", noise=0.02, model=TRUTH):
    """A record of the pendulum at large amplitude, with noise."""
    t = dt * np.arange(round(duration / dt))
    u = steps(seed, t, size)
    y = integrated(model, t, u, hold, [0.0, 0.1])
    y = y + noise * np.random.default_rng([seed, 1]).standard_normal(y.shape)
    return Record(t, u, y, ("lon",), ("q", "theta"), f"swing {seed}", hold)
