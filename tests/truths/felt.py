"""An output that feels an input held in steps at once, but not to first order at rest."""

import numpy as np

from casid import NonlinearModel, Record, Scalar, parameter

H = 0.05


class Felt(NonlinearModel):
    """q' = -k q + e and a = g e² + q: of a the slope by e is zero at the reference."""

    states, inputs, outputs = ("q",), ("e",), ("q", "a")
    k: Scalar = parameter(default=2.0, lower=0.0, upper=9.0, unit="1/s")
    g: Scalar = parameter(default=1.5, lower=-9.0, upper=9.0, unit="-")
    tau: Scalar = parameter(default=0.0, lower=0.0, upper=0.3, unit="s")

    def derivatives(self, x, u):
        return [-self.k * x.q + u.e]

    def measurements(self, x, u):
        return [x.q, self.g * u.e**2 + x.q]

    def delays(self):
        return {"e": self.tau}


class Slight(Felt):
    """The same with a = g e + q."""

    def measurements(self, x, u):
        return [x.q, self.g * u.e + x.q]


def felt(structure, late, noise=0.0, seed=0, n=200):
    """A record with the stick up to a sample late (s), in closed form."""
    rng = np.random.default_rng([7, seed])
    u = rng.standard_normal(n) if structure is Felt else np.cumsum(0.3 * rng.standard_normal(n))
    before, truth = np.append(u[0], u[:-1]), structure()

    def moved(q, e, s):
        return q * np.exp(-truth.k * s) + e * (1 - np.exp(-truth.k * s)) / truth.k

    q = np.zeros(n)
    for i in range(n - 1):
        q[i + 1] = moved(moved(q[i], before[i], late), u[i], H - late)
    e = before if late > 0 else u
    y = np.column_stack([q, truth.g * (e**2 if structure is Felt else e) + q])
    y += noise * rng.standard_normal(y.shape)
    return Record(H * np.arange(n), u[:, None], y, ("e",), ("q", "a"), "felt", hold="zoh")
