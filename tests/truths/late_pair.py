"""Roll and sideslip by two sticks whose delays one parameter moves, and its likelihood by scanning.

    p' = Lp p + Llat lat(t - τ_1) + Lped ped(t - τ_2),    ay = Ylat lat(t - τ_1) + Yped ped(t - τ_2)

Sticks are held in steps. With Lp and the delays known the rest is linear, channel by channel.
"""

from functools import cache

import numpy as np
import scipy.signal

from casid import Model, Record, Rows, Scalar, parameter

LP = -2.5
NOISE = np.array([0.02, 0.05])  # rad/s, m/s^2
RATES = (0.02, 0.05)  # s


class Pair(Model):
    """Both sticks heard late; the accelerometer hears them at once."""

    states, inputs, outputs = ("p",), ("lat", "ped"), ("p", "ay")
    Lp: Scalar = parameter(default=LP, lower=-10, upper=0, unit="1/s")
    Llat: Scalar = parameter(default=6.0, lower=-40, upper=40, unit="rad/s^2")
    Lped: Scalar = parameter(default=2.0, lower=-40, upper=40, unit="rad/s^2")
    Ylat: Scalar = parameter(default=1.0, lower=-20, upper=20, unit="m/s^2")
    Yped: Scalar = parameter(default=-2.0, lower=-20, upper=20, unit="m/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.2, unit="s")

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[self.Llat, self.Lped]]

    def C(self) -> Rows:
        return [[1], [0]]

    def D(self) -> Rows:
        return [[0, 0], [self.Ylat, self.Yped]]


class Twice(Pair):
    """The pedals' way is twice as long."""

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau, "ped": 2 * self.tau}


class Longer(Pair):
    """The pedals' way is longer by no whole samples."""

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau, "ped": self.tau + 0.015}


class Against(Pair):
    """What the one's way is longer the other's is shorter."""

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau, "ped": 0.213 - self.tau}


class Alike(Pair):
    """Both ways are equally long."""

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau, "ped": self.tau}


def late(structure, tau):
    """Delays (2,) of both sticks [s]."""
    ways = {Twice: (tau, 2 * tau), Longer: (tau, tau + 0.015), Against: (tau, 0.213 - tau)}
    return ways.get(structure, (tau, tau))


def heard(u, h, tau):
    """One stick (N,) so late: what is felt at once at every sample, and p (N,) by exact steps."""
    n = int(np.ceil(tau / h - 1e-9))  # whole samples, of which the last is over n - τ/h early
    rest = n * h - tau  # from the arrival of a step to the next sample
    before, after = (np.concatenate([np.full(k, u[0]), u])[: len(u)] for k in (n, max(n - 1, 0)))
    full, part = np.expm1(LP * h) / LP, np.expm1(LP * rest) / LP
    force = (full - part) * before + part * after
    p = scipy.signal.lfilter([0.0, 1.0], [1.0, -np.exp(LP * h)], force)
    return before, p


@cache
def sticks(h, k):
    """Steps (N, 2) of both sticks at samples a time h apart."""
    rng, t = np.random.default_rng([k, 8]), h * np.arange(round(12 / h))
    found = []
    for _ in range(2):
        turns, levels = np.cumsum(rng.uniform(0.4, 1.5, 40)), rng.choice([-0.3, 0.0, 0.3], 41)
        found.append(np.where(t < 0.5, 0.0, levels[np.searchsorted(turns, t - 0.5)]))
    return np.stack(found, axis=1)


def paired(structure, tau, rates=RATES):
    """Noisy records of these sampling intervals [s]."""
    rng, found, m = np.random.default_rng(2), [], Pair()
    for k, h in enumerate(rates):
        u = sticks(h, k)
        parts = [heard(each, h, by) for each, by in zip(u.T, late(structure, tau), strict=True)]
        p = m.Llat * parts[0][1] + m.Lped * parts[1][1]
        ay = m.Ylat * parts[0][0] + m.Yped * parts[1][0]
        y = np.stack([p, ay], axis=1) + NOISE * rng.standard_normal((len(u), 2))
        t = h * np.arange(len(u))
        found.append(Record(t, u, y, Pair.inputs, Pair.outputs, f"record {k}", hold="zoh"))
    return found


def scanned(structure, tau, records):
    """Negative log-likelihood at a delay, Lp held, but for a constant.

    Everything else is estimated: gains, initial states and biases of every record, noise.
    """
    n, sums = 0, np.zeros(2)
    columns: tuple[list, list] = ([], [])
    for k, record in enumerate(records):
        h, own = record.dt, np.zeros((record.N, 2 * len(records)))
        own[:, 2 * k] = 1.0
        own[:, 2 * k + 1] = np.exp(LP * h * np.arange(record.N))
        parts = [heard(u, h, by) for u, by in zip(record.u.T, late(structure, tau), strict=True)]
        for channel, place in ((0, 1), (1, 0)):
            felt = np.stack([part[place] for part in parts], axis=1)
            more = own if channel == 0 else own[:, ::2]
            columns[channel].append(np.hstack([felt, more]))
        n += record.N
    for channel in range(2):
        X = np.vstack(columns[channel])
        y = np.concatenate([record.y[:, channel] for record in records])
        sums[channel] = np.sum((y - X @ np.linalg.lstsq(X, y)[0]) ** 2)
    return n / 2 * np.log(sums / n).sum()
