"""A structure whose output error is linear least squares, and executors, for tests of studies."""

from concurrent.futures import Executor, Future

import numpy as np

from casid import Constraint, Model, Record, Rows, Scalar, parameter


class Mixture(Model):
    """Two known lags, unknown gains: the response is linear in the parameters."""

    states = ("fast", "slow")
    inputs = ("u",)
    outputs = ("y",)

    a: Scalar = parameter(default=0.5, lower=-9.0, upper=9.0, unit="-")
    b: Scalar = parameter(default=0.5, lower=-9.0, upper=9.0, unit="-")
    d: Scalar = parameter(default=0.1, lower=-9.0, upper=9.0, unit="-")

    def A(self) -> Rows:
        return [[-3, 0], [0, -1]]

    def B(self) -> Rows:
        return [[1], [1]]

    def C(self) -> Rows:
        return [[self.a, self.b]]

    def D(self) -> Rows:
        return [[self.d]]


TRUTH = Mixture(a=1.0, b=0.6, d=0.05)
NOISE = 0.02
CASES = {"free": {}} | {f"a < {k}": {"a": f"< {k}"} for k in (0.99, 0.98, 0.97, 0.96)}


class Positive(Mixture):
    """The same with a sum that is not negative."""

    def constraints(self):
        return [Constraint("a + b", self.a + self.b, 0.0, np.inf)]


def record(seed=0, model=TRUTH):
    """Random steps of 20 s at 20 Hz, white noise on the output."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 20, 0.05)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 20)[:, None]
    y = model.system().simulate(t, u) + NOISE * rng.standard_normal((len(t), 1))
    return Record(t, u, y, ("u",), ("y",), f"steps {seed}")


def least_squares(seed=0):
    """Columns of y by a, b, d, initial states and bias, and y, both divided by the noise.

    The decays are weighed by a and b in the model; as columns they span the same space.
    """
    r = record(seed)
    zero = dict.fromkeys(Mixture.parameter_names(), 0.0)
    forced = [Mixture(**(zero | {n: 1.0})).system().simulate(r.t, r.u)[:, 0] for n in zero]
    X = np.column_stack([*forced, np.exp(-3 * r.t), np.exp(-r.t), np.ones_like(r.t)])
    return X / NOISE, r.y[:, 0] / NOISE


class Inline(Executor):
    """Does a job when it is submitted."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future
