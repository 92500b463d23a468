"""Do stated errors hold where the structure leaves out the rotor?

The aircraft of `benchmarks.repeated`, its rotor a lag that the structure has not, flown in closed
loop through steps of 0.1 or none on both sticks, new ones every 0.7 s, or through its 3-2-1-1. What
the structure can know are its best parameters for such flights, those of many records; printed is
how often 95 % intervals of campaigns hold these, all parameters together and the one least often,
and the root mean square of their errors over the stated ones.

    OMP_NUM_THREADS=1 python -m benchmarks.rotor [runs] [seed] [--best 160] [--only WORDS]
"""

import argparse
import warnings
from dataclasses import dataclass

import numpy as np
import scipy.signal

from benchmarks import repeated
from benchmarks.repeated import GUESS, NAMES, H
from benchmarks.tables import table
from casid import Record, output_error


@dataclass(frozen=True)
class Case:
    """Campaigns of so many records of so many seconds, and the rotor's lag [s]."""

    lag: float
    records: int
    seconds: float
    manoeuvre: str = "steps"

    def flight(self, seed: list[int]) -> Record:
        """One record."""
        if self.manoeuvre != "steps":
            return repeated.flight(seed, self.lag)
        rng, count = np.random.default_rng(seed), round(self.seconds / H)
        levels = rng.choice([-0.1, 0.0, 0.1], size=(int(self.seconds / 0.7) + 2, 2))
        t = H * np.arange(count)
        meant = levels[np.floor(t / 0.7).astype(int)] * (t[:, None] > 1.0)
        part = 1 - np.exp(-H / 0.15)
        wanted = scipy.signal.lfilter([part], [1, part - 1], meant, axis=0)
        return repeated.flown(wanted, self.lag, rng, f"steps {seed}")

    def best(self, seed: int, count: int) -> np.ndarray:
        """The best parameters for such flights, those of ``count`` records."""
        records = [self.flight([seed, 0, k]) for k in range(count)]
        return output_error(GUESS, records, interval=0.5).model.vector()

    def campaign(self, seed: int, run: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Estimates of one campaign, their bounds of Cramér and Rao and their stated errors."""
        records = [self.flight([seed, 1, run, k]) for k in range(self.records)]
        fit = output_error(GUESS, records, interval=0.5)
        rows = fit.parameters
        return (
            fit.model.vector(),
            np.array([row.cramer_rao for row in rows]),
            np.array([row.std_error for row in rows]),
        )


CASES = (
    Case(0.06, 2, 8),
    Case(0.06, 4, 8),
    Case(0.06, 8, 8),
    Case(0.12, 2, 8),
    Case(0.12, 4, 8),
    Case(0.06, 2, 20),
    Case(0.06, 4, 20, "3-2-1-1"),
    Case(0.12, 2, 20, "3-2-1-1"),
    Case(0.06, 1, 20, "3-2-1-1"),
    Case(0.06, 1, 8),
)


def row(case: Case, runs: int, seed: int, count: int) -> list[str]:
    """A row of the table."""
    found = np.moveaxis([case.campaign(seed, run) for run in range(runs)], 1, 0)
    off, cramer_rao, std = found[0] - case.best(seed, count), found[1], found[2]
    plain, held = (np.abs(off) < 1.96 * error for error in (cramer_rao, std))
    least = int(np.argmin(held.mean(axis=0)))
    z = np.sqrt(np.mean((off / std) ** 2, axis=0))
    return [
        f"{case.lag:g}",
        f"{case.records} of {case.seconds:g} s, {case.manoeuvre}",
        f"{100 * plain.mean():.1f}",
        f"{100 * held.mean():.1f}",
        f"{100 * held[:, least].mean():.1f} ({NAMES[least]})",
        f"{np.sqrt(np.mean(z**2)):.2f} ({z.min():.2f}-{z.max():.2f})",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=200)
    parser.add_argument("seed", nargs="?", type=int, default=1)
    parser.add_argument("--best", type=int, default=160, help="records of the best parameters")
    parser.add_argument("--only", default="", help="words that a case must have")
    asked = parser.parse_args()
    cases = [case for case in CASES if all(word in str(case) for word in asked.only.split())]
    rows = [row(case, asked.runs, asked.seed, asked.best) for case in cases]
    heading = ("lag, s", "records", "covered by Cramér-Rao, %", "by the stated error, %",
               "least covered", "error / stated, rms")  # fmt: skip
    print(table(heading, rows))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
