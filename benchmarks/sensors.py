"""What accelerometers away from the centre of gravity cost, and what estimating their place gives.

Specific forces measured 1.5 m ahead of the centre of gravity and 0.5 m above it, noise as in the
UH-60 study and of 0.2 m/s in the velocities, output error from a start 20 % off. Bias is the mean
error over the runs, in standard errors.

Run: python -m benchmarks.sensors [runs]      (40 runs: a quarter of a minute)
"""

import argparse

import numpy as np

from benchmarks.tables import table
from benchmarks.uh60 import NOISE
from casid import OutputError, Record
from models.longitudinal import Longitudinal
from models.sensors import Accelerometers

PLACE = {"x_acc": 1.5, "y_acc": 0.0, "z_acc": -0.5}
HELD = {"y_acc"}  # pitch alone does not move it
STD = NOISE | {"u": 0.2, "w": 0.2}


class Measured(Longitudinal):
    """Longitudinal motion with its velocities among the outputs."""

    outputs = (*Longitudinal.outputs, "u", "w")

    def C(self):
        return [*super().C(), [1, 0, 0, 0], [0, 1, 0, 0]]

    def D(self):
        return [*super().D(), [0, 0], [0, 0]]


class Boom(Accelerometers, Measured):
    """The same, accelerometers anywhere."""


def flown(truth, rng):
    """Two records of 3-2-1-1 inputs, one on each control, with noise."""
    t = np.arange(0, 16, 0.04)
    edges = 1 + 0.7 * np.array([0, 3, 5, 6, 7])
    steps = np.array([0, 1, -1, 1, -1, 0])[np.searchsorted(edges, t, side="right")]
    records = []
    for axis, size in enumerate((0.04, 0.025)):
        u = np.zeros((len(t), 2))
        u[:, axis] = size * steps
        y = truth.system().simulate(t, u)
        record = Record(t, u, y, truth.inputs, truth.outputs, f"3211 {truth.inputs[axis]}")
        records.append(record.with_noise({name: STD[name] for name in truth.outputs}, rng))
    return records


def errors(start, fixed, truth, runs):
    """Errors of all estimates in standard errors, (runs, parameters), and their names."""
    rows = []
    for seed in range(runs):
        records = flown(truth, np.random.default_rng([seed, 17]))
        fit = OutputError().fit(start, records, fixed=fixed)
        rows.append([(fit[n].value - getattr(truth, n)) / fit[n].std_error for n in fit.free_names])
    return np.array(rows), fit.free_names


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=40)
    runs = parser.parse_args().runs
    truth = Boom(U0=40.9, W0=2.1, theta0=0.05, **PLACE)
    values = {name: getattr(truth, name) for name in Longitudinal.parameter_names()}
    off = {name: 0.8 * value for name, value in values.items()}
    trim = {"U0": 40.9, "W0": 2.1, "theta0": 0.05}
    cases = {
        "place estimated": (Boom(**trim, **off), HELD),
        "place given": (Boom(**trim, **off, **PLACE), set(PLACE)),
        "taken as at the centre of gravity": (Measured(**trim, **off), set()),
    }
    rows, said = [], []
    for name, (start, fixed) in cases.items():
        e, names = errors(start, fixed, truth, runs if "taken" not in name else min(runs, 5))
        bias, worst = np.abs(e.mean(axis=0)), int(np.argmax(np.abs(e.mean(axis=0))))
        rows.append([name, f"{bias[worst]:.2f} ({names[worst]})", float(np.mean(np.abs(e) < 2))])
        if "x_acc" in names:
            at = [names.index(each) for each in ("x_acc", "z_acc")]
            said.append(f"place within two standard errors: {np.mean(np.abs(e[:, at]) < 2):.0%}")
    print(table(["accelerometers", "largest bias [σ]", "estimates within 2σ"], rows))
    print(*said, sep="\n")


if __name__ == "__main__":
    main()
