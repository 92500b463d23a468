"""Manoeuvres flown again, by an aircraft whose rotor the structure leaves out.

The truth is a roll axis whose moments come by a flapping lag of 60 ms, unstable, flown in closed
loop by a pilot who sees noisy instruments; the structure is quasi-steady. Every record has a
3-2-1-1 on each control, with another amplitude, sign, pace and start, and other noise. Two checks:

- single fits of one record: rms of their differences over the stated error of the difference;
- a tie that holds for the best parameters, those of forty records: how often campaigns of four
  records reject it at 5 %, by the likelihood ratio as casid tests it and for white residuals.

    OMP_NUM_THREADS=1 python -m benchmarks.repeated [pairs] [campaigns] [seed] [--lag 0.06]
                                                    [--records 4]
"""

import argparse
import warnings

import numpy as np
import scipy.stats

from benchmarks.tables import table
from casid import Execution, Model, Record, Rows, Scalar, StateSpace, compare_bounds, parameter
from casid.linear import foh_step
from casid.shooting.output_error import OutputError, output_error

H, N = 0.02, 1000  # s, samples
SIGMA = np.array([0.05, 0.005, 0.005])  # m/s^2, rad/s, rad
STEPS = [1, 1, 1, -1, -1, 1, -1]  # of a 3-2-1-1


class Roll(Model):
    """Lateral velocity, roll rate and bank, quasi-steady."""

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


GUESS, NAMES = Roll(), Roll.parameter_names()


def plant(lag: float) -> StateSpace:
    """The truth: T da/dt = -a + Lp p + Llat lat, dp/dt = Lv v + a + Lped ped."""
    m = GUESS
    A = [[m.Yv, 0, 9.81, 0], [m.Lv, 0, 0, 1], [0, 1, 0, 0], [0, m.Lp / lag, 0, -1 / lag]]
    B = [[m.Ylat, 0], [0, m.Lped], [0, 0], [m.Llat / lag, 0]]
    C = [[m.Yv, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
    return StateSpace(A, B, C, [[m.Ylat, 0], [0, 0], [0, 0]], None, m.inputs, m.outputs)


def reference(rng: np.random.Generator) -> np.ndarray:
    """Sticks that the pilot means to move, (N, 2): a 3-2-1-1 on each, one after the other."""
    u = np.zeros((N, 2))
    for control, begin in enumerate(np.array([0.0, 9.5]) + rng.uniform(0.5, 2.0, 2)):
        pace, size = rng.uniform(0.5, 1.0), rng.uniform(0.05, 0.12) * rng.choice([-1, 1])
        k = np.floor((H * np.arange(N) - begin) / pace).astype(int)
        inside = (k >= 0) & (k < len(STEPS))
        u[inside, control] = size * np.array(STEPS)[k[inside]]
    return u


def flight(seed: list[int], lag: float) -> Record:
    """One record; the pilot's arm is a lag of 0.1 s, his corrections follow the instruments."""
    rng, truth = np.random.default_rng(seed), plant(lag)
    wanted, noise = reference(rng), SIGMA * rng.standard_normal((N, 3))
    Ad, B0, B1 = foh_step(truth.A, truth.B, H)
    keep = np.exp(-H / 0.1)
    x, felt, u, y = np.zeros(4), np.zeros(2), np.zeros((N + 1, 2)), np.zeros((N, 3))
    for k in range(N):
        y[k] = truth.C @ x + truth.D @ u[k] + noise[k]
        meant = wanted[k] - [0.03 * y[k, 2] + 0.01 * y[k, 1], 0.0]
        felt = keep * felt + (1 - keep) * meant
        u[k + 1] = felt
        x = Ad @ x + B0 @ u[k] + B1 @ u[k + 1]
    return Record(H * np.arange(N), u[:N], y, GUESS.inputs, GUESS.outputs, f"flight {seed}")


def differences(pairs: int, seed: int, lag: float) -> np.ndarray:
    """Differences of single fits over their stated errors, (2, pairs, parameters).

    The first by ``std_error``, the second by the Cramér-Rao bound.
    """
    found = []
    for k in range(pairs):
        fits = [output_error(GUESS, flight([seed, 1, 2 * k + i], lag)) for i in (0, 1)]
        gap = np.subtract(*(fit.model.vector() for fit in fits))
        errors = [
            [[getattr(row, kind) for row in fit.parameters] for fit in fits]
            for kind in ("std_error", "cramer_rao")
        ]
        found.append(gap / np.sqrt(np.sum(np.square(errors), axis=1)))
    return np.moveaxis(found, 1, 0)


def rejections(campaigns: int, seed: int, lag: float, count: int) -> np.ndarray:
    """p of ties that hold for the best parameters, (campaigns, ties, 2): casid's and white's."""
    best = output_error(GUESS, [flight([seed, 2, k], lag) for k in range(40)]).model
    ties = [f"{a} = {getattr(best, a) / getattr(best, b)!r} {b}" for a, b in TIES]
    cases = {"free": {}} | {tie: [tie] for tie in ties}
    found = []
    for k in range(campaigns):
        records = [flight([seed, 3, count * k + i], lag) for i in range(count)]
        compared = compare_bounds(best, records, cases=cases, estimator=OutputError(),
                                  execution=Execution(executor=None))  # fmt: skip
        judged = [compared[tie] for tie in ties]
        found.append([(c.p_value, scipy.stats.chi2.sf(c.statistic, c.freedom)) for c in judged])
    return np.array(found)


TIES = (("Llat", "Lp"), ("Lv", "Yv"), ("Lped", "Llat"))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("pairs", 30), ("campaigns", 200), ("seed", 1)):
        parser.add_argument(name, nargs="?", type=int, default=default)
    parser.add_argument("--lag", type=float, default=0.06, help="of the flapping [s]")
    parser.add_argument("--records", type=int, default=4, help="of a campaign")
    asked = parser.parse_args()
    if asked.pairs:
        z = np.sqrt(np.mean(differences(asked.pairs, asked.seed, asked.lag) ** 2, axis=1))
        rows = [[name, *(f"{x:.2f}" for x in z[:, k])] for k, name in enumerate(NAMES)]
        rows.append(["all", *(f"{x:.2f}" for x in np.sqrt(np.mean(z**2, axis=1)))])
        print(table(["parameter", "over std_error", "over Cramér-Rao"], rows))
    found = rejections(asked.campaigns, asked.seed, asked.lag, asked.records)
    share = np.mean(found < 0.05, axis=0)
    rows = [
        [f"{a} to {b}", *(f"{100 * x:.1f}" for x in s)]
        for (a, b), s in zip(TIES, share, strict=True)
    ]
    rows.append(["all", *(f"{100 * x:.1f}" for x in share.mean(axis=0))])
    print(table(["tie", "rejected, %", "as if white, %"], rows))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
