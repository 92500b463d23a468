"""A climbing rotor behind a fast motor: thrust is quadratic in the rotor's speed, which lags."""

from itertools import pairwise

import numpy as np
import scipy

from casid import NonlinearModel, Record, Scalar, parameter
from truths.swing import steps

OUTPUTS, DEVIATION = ("w",), 0.02  # m/s


class Motor(NonlinearModel):
    """w' = Zw w + Z (n² - 1), n' = (command - n) / lag; 80 rad/s is a lag of 12.5 ms."""

    states, inputs, outputs = ("w", "n"), ("command",), OUTPUTS

    Zw: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")
    Z: Scalar = parameter(default=-8.0, lower=-50.0, upper=0.0, unit="m/s^2")
    lag: Scalar = parameter(default=0.02, lower=1e-6, upper=0.2, unit="s")

    def derivatives(self, x, u):
        return [self.Zw * x.w + self.Z * (x.n**2 - 1), (u.command - x.n) / self.lag]

    def reference(self):
        return {"n": 1.0, "command": 1.0}


TRUTH = Motor(Zw=-0.8, Z=-12.0, lag=1 / 80)


def answered(values, t, command, start):
    """w (N,) by SciPy's implicit method, from one step of the command to the next."""
    Zw, Z, lag = values
    edges = [0, *(np.flatnonzero(np.diff(command)) + 1), len(t) - 1]
    x, w = np.array(start, dtype=float), np.empty(len(t))
    for a, b in pairwise(edges):

        def f(_, x, held=command[a]):
            return [Zw * x[0] + Z * (x[1] ** 2 - 1), (held - x[1]) / lag]

        found = scipy.integrate.solve_ivp(
            f, (t[a], t[b]), x, method="LSODA", t_eval=t[a : b + 1], rtol=1e-11, atol=1e-12
        )
        w[a : b + 1], x = found.y[0], found.y[:, -1]
    return w


def climbed(duration=4.0, dt=0.02, seed=3):
    """A record of the rotor at 50 Hz, with noise."""
    t = dt * np.arange(round(duration / dt))
    command = 1.0 + steps(seed, t, 0.15, every=0.3)
    w = answered((TRUTH.Zw, TRUTH.Z, TRUTH.lag), t, command[:, 0], (0.0, 1.0))
    y = w + DEVIATION * np.random.default_rng(seed).standard_normal(len(t))
    return Record(t, command, y[:, None], ("command",), OUTPUTS, "climb", "zoh")
