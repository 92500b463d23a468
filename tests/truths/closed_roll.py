"""Roll of an unstable helicopter flown in closed loop, and what spoils its records."""

from dataclasses import replace

import numpy as np

from casid import Model, Record, Rows, Scalar, parameter

T = 0.02 * np.arange(600)
NOISE = {"ay": 0.05, "p": 0.005, "phi": 0.005}  # m/s^2, rad/s, rad


class Roll(Model):
    """Lateral velocity, roll rate and bank; unstable: 0.10 ± 0.72j and -2.5 1/s."""

    states = ("v", "p", "phi")
    inputs = ("lat", "ped")
    outputs = ("ay", "p", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-2.0, upper=0.5, unit="1/s")
    Lv: Scalar = parameter(default=-0.15, lower=-1.0, upper=1.0, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-2.2, lower=-20.0, upper=0.0, unit="1/s")
    Ylat: Scalar = parameter(default=2.0, lower=-10.0, upper=10.0, unit="m/s^2")
    Llat: Scalar = parameter(default=10.0, lower=-40.0, upper=40.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=1.5, lower=-10.0, upper=10.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.075, lower=0.0, upper=0.25, unit="s")

    def A(self) -> Rows:
        return [[self.Yv, 0, 9.81], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[self.Ylat, 0], [self.Llat, self.Lped], [0, 0]]

    def C(self) -> Rows:
        return [[self.Yv, 0, 0], [0, 1, 0], [0, 0, 1]]

    def D(self) -> Rows:
        return [[self.Ylat, 0], [0, 0], [0, 0]]

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau}


class NoSideslip(Model):
    """Roll without lateral velocity: it cannot oscillate."""

    states = ("p", "phi")
    inputs = ("lat", "ped")
    outputs = ("ay", "p", "phi")

    Lp: Scalar = parameter(default=-2.2, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=-40.0, upper=40.0, unit="rad/s^2")
    Lped: Scalar = parameter(default=1.5, lower=-10.0, upper=10.0, unit="rad/s^2")
    Ylat: Scalar = parameter(default=2.0, lower=-10.0, upper=10.0, unit="m/s^2")
    Yp: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="m/(s rad)")

    def A(self) -> Rows:
        return [[self.Lp, 0], [1, 0]]

    def B(self) -> Rows:
        return [[self.Llat, self.Lped], [0, 0]]

    def C(self) -> Rows:
        return [[self.Yp, 0], [1, 0], [0, 1]]

    def D(self) -> Rows:
        return [[self.Ylat, 0], [0, 0], [0, 0]]


TRUTH = Roll()
NAMES = TRUTH.parameter_names()


def lag(t, u, T_lag):
    """What a stick shaped by a first-order lag does; steps sampled bare have no derivative."""
    out = np.zeros_like(u)
    for k in range(1, len(t)):
        out[k] = out[k - 1] + (1 - np.exp(-(t[k] - t[k - 1]) / T_lag)) * (u[k] - out[k - 1])
    return out


def excitation(t, seed):
    """Multi-step sticks of 0.1 through a 0.15 s lag, at rest for the first second."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([-0.1, 0.0, 0.1], size=(int(t[-1] / 0.7) + 2, 2))
    steps = levels[np.floor(t / 0.7).astype(int)] * (t[:, None] > 1.0)
    return lag(t, steps, 0.15)


def with_response(record: Record, model, x0=None, bias=0.0):
    """The record with a model's outputs to its inputs."""
    y = model.system().simulate(record.t, record.u, x0, record.hold) + np.asarray(bias)
    return replace(record, y=y)


def flown(model=TRUTH, t=T, seed=0, x0=(0.3, -0.02, 0.01), bias=(0.1, 0.01, -0.02)):
    """One closed-loop record: bank and rate are fed back to the lateral stick, without noise."""
    r = excitation(t, seed)
    u, y = r, np.zeros((len(t), 3))
    for _ in range(60):  # the loop, solved by relaxation: contracts as the sweep moves forward
        y = model.system().simulate(t, u, np.array(x0))
        new = r - np.column_stack([lag(t, 0.03 * y[:, 2] + 0.01 * y[:, 1], 0.1), 0 * t])
        if np.abs(new - u).max() < 1e-12:
            break
        u = new
    return Record(t, u, y + np.array(bias), model.inputs, model.outputs, f"record {seed}")


def noisy(seed=1):
    """The same with noise of its own."""
    return flown(seed=seed).with_noise(NOISE, np.random.default_rng(seed))


def off(model=TRUTH, share=0.3):
    """A start every parameter of which is off by the share, up and down in turn."""
    signs = np.where(np.arange(len(model.vector())) % 2, 1.0, -1.0)
    return model.with_vector(model.vector() * (1 + share * signs))


def relative_error(fit, model=TRUTH):
    return np.abs(fit.model.vector() / model.vector() - 1)


def jittered(record: Record, share=0.4):
    """The same manoeuvre at instants moved by up to a share of the sampling interval."""
    rng = np.random.default_rng(1)
    t = record.t + share * record.dt * rng.uniform(-1, 1, record.N)
    u = np.column_stack([np.interp(t, record.t, column) for column in record.u.T])
    return replace(record, t=t, u=u)


def with_holes(record: Record):
    """Samples missing one by one, a channel for a while, and whole samples."""
    y = record.y.copy()
    y[np.random.default_rng(2).random(y.shape) < 0.1] = np.nan
    y[20:40, 1] = np.nan
    y[60:65] = np.nan
    return replace(record, y=y)


NOISE = {"ay": 0.05, "p": 0.01, "phi": 0.01}


def campaign(seed=None, count=3):
    """Records of the loop, with measurement noise of that seed."""
    clean = [flown(seed=k) for k in range(count)]
    rng = np.random.default_rng([seed or 0, 3])
    return clean if seed is None else [record.with_noise(NOISE, rng) for record in clean]
