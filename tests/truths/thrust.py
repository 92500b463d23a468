"""A rotor whose thrust bends with its inputs, and SciPy's solution from break to break of these."""

from itertools import pairwise

import casadi as ca
import numpy as np
import scipy

from casid import NonlinearModel, Record, Scalar, parameter


class Thrust(NonlinearModel):
    """Climb w and rotor speed n under a command and a brake, each as late as it is.

    w' = lift n - drag w^2 - w - 3 brake,    n' = rate (bent(command) - n) + 0.3 w brake
    """

    states = ("w", "n")
    inputs = ("command", "brake")
    outputs = ("w", "n")

    lift: Scalar = parameter(default=8.0, lower=0.0, upper=60.0, unit="m/s^2")
    drag: Scalar = parameter(default=0.2, lower=0.0, upper=2.0, unit="1/m")
    rate: Scalar = parameter(default=4.0, lower=0.1, upper=50.0, unit="1/s")
    late: Scalar = parameter(default=0.03, lower=0.0, upper=0.6, unit="s")
    late_brake: Scalar = parameter(default=0.03, lower=0.0, upper=0.6, unit="s")

    def bent(self, command):
        return command

    def derivatives(self, x, u):
        climb = self.lift * x.n - self.drag * x.w**2 - x.w - 3 * u.brake
        return [climb, self.rate * (self.bent(u.command) - x.n) + 0.3 * x.w * u.brake]

    def reference(self):
        return {"command": 0.5}

    def delays(self):
        return {"command": self.late, "brake": self.late_brake}


class Squared(Thrust):
    """Thrust by the square of the command."""

    def bent(self, command):
        return command**2


class Rooted(Thrust):
    """Thrust by its root, which has no value below zero and no slope there."""

    def bent(self, command):
        return ca.sqrt(command)


class Saturating(Thrust):
    """Thrust that ends."""

    def bent(self, command):
        return ca.tanh(3 * command)


BENT = {Thrust: lambda u: u, Squared: lambda u: u * u, Rooted: np.sqrt,
        Saturating: lambda u: np.tanh(3 * u)}  # fmt: skip


def edges(seed, n):
    """Inputs (n, 2) of 0 and 1 that stay some samples, the first at 0; the brake's are levels."""
    rng = np.random.default_rng(seed)
    command = np.repeat(rng.integers(0, 2, n // 6 + 1), 6)[:n].astype(float)
    command[:5] = 0.0
    return np.column_stack([command, np.repeat(rng.uniform(0, 1, n // 4 + 1), 4)[:n]])


def instants(n, dt, irregular, seed=9):
    """Instants (n,), each up to a third of the interval off if irregular."""
    off = 0.3 * dt * np.random.default_rng(seed).uniform(-1, 1, n) if irregular else np.zeros(n)
    t = dt * np.arange(n) + off
    return t - t[0]


def climbed(cls, lam, t, u, hold, x0=(0.1, 0.05), tolerance=1e-12):
    """States (N, 2) at the instants, parameters in the structure's order."""
    lift, drag, rate, *late = lam
    cuts = np.concatenate([t, *(t + each for each in late)])
    cuts = np.sort(cuts[(cuts >= t[0]) & (cuts <= t[-1])])
    cuts = cuts[np.append(True, np.diff(cuts) > 1e-13)]
    x, found, k = np.array(x0, dtype=float), [np.array(x0, dtype=float)], 1
    for a, b in pairwise(cuts):
        held = [piece(t, column, hold, (a + b) / 2 - tau, a - tau)
                for column, tau in zip(u.T, late, strict=True)]  # fmt: skip

        def f(s, x, a=a, held=held):
            command, brake = (value + slope * (s - a) for value, slope in held)
            climb = lift * x[1] - drag * x[0] ** 2 - x[0] - 3 * brake
            return [climb, rate * (BENT[cls](max(command, 0.0)) - x[1]) + 0.3 * x[0] * brake]

        x = scipy.integrate.solve_ivp(
            f, (a, b), x, method="DOP853", rtol=tolerance, atol=0.1 * tolerance
        ).y[:, -1]
        if k < len(t) and abs(b - t[k]) < 1e-12:
            found.append(x)
            k += 1
    return np.array(found)


def piece(t, u, hold, within, begin):
    """Value at ``begin`` and slope of what inputs u (N,) are about an instant within."""
    k = int(np.searchsorted(t, within, side="right")) - 1
    if k < 0:
        return u[0], 0.0
    if hold == "zoh" or k == len(t) - 1:
        return u[k], 0.0
    slope = (u[k + 1] - u[k]) / (t[k + 1] - t[k])
    return u[k] + slope * (begin - t[k]), slope


def flown(cls, lam, hold, *, n=60, dt=0.05, irregular=False, seed=3):
    """A record without noise, from `edges`."""
    t, u = instants(n, dt, irregular), edges(seed, n)
    y = climbed(cls, lam, t, u, hold)
    return Record(t, u, y, cls.inputs, cls.outputs, "flown", hold)
