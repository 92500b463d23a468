"""Do the 95 % intervals of a black box hold the truth, under feedback and with short records?

    OMP_NUM_THREADS=1 python -m benchmarks.black_box_intervals [--runs 40] [--first 0] [--only NAME]

The unstable loops of `closed_loop.py`, two records each, white noise of a tenth on every output fed
back with it; and a damped pair under twelve lines, one record, as without feedback. Of magnitudes
and phases at twelve frequencies in 0.5-6 rad/s: root mean square error over the stated standard
deviation, and the share within 1.96 of it. Last the UH-60's 3-2-1-1, simulated by its 32-state
model with noise that its controller feeds back, too little to matter: runs that end with prediction
errors are handed over in vain. Order and direct terms are given, as errors are those of
a model of this order, and for the loops window and pole of `closed_loop.py`; the rest is automatic.
"""

import argparse
import warnings

import numpy as np

from benchmarks.closed_loop import multi, record, single
from benchmarks.tables import table
from benchmarks.uh60 import STEPS, linear_records, oracle
from casid import DataWarning, Record, StateSpace, pbsid
from casid.linear import foh_step

OMEGA = np.geomspace(0.5, 6.0, 12)
NOISE, INTERVAL = 0.1, 0.02  # s


def loop(system, scale, duration, noise=NOISE):
    """Truth, settings and a function of a generator that flies two records of a loop."""
    plant, gain, settings = system()

    def fly(rng):
        return [record(plant, scale * gain, noise, rng, duration) for _ in range(2)]

    return plant, {**settings, "past": 10, "pole": 6.0}, fly


def gusts(turbulence, duration=30.0, gain=1.0):
    """The same of rate and attitude fed back, u = r - gain (0.3 p + 0.6 φ), turbulence on p."""
    truth = StateSpace([[-2.0, 1.5], [1.0, 0.2]], [[8.0], [0.0]], np.eye(2), np.zeros((2, 1)))
    A, B0, B1 = foh_step(truth.A, truth.B, INTERVAL)
    t, back = np.arange(0, duration, INTERVAL), gain * np.array([0.3, 0.6])

    def fly(rng):
        phase, x, u, y = rng.uniform(0, 6), np.zeros(2), np.zeros(len(t)), np.empty((len(t), 2))
        r = 0.1 * np.sign(np.sin(0.9 * t + phase) + np.sin(2.3 * t + 2 * phase)) * (t > 0.5)
        for k in range(len(t)):
            y[k] = x + rng.normal(0, (0.02, 0.01))
            u[k] = r[k] - back @ y[k]
            x = A @ x + (B0 + B1)[:, 0] * u[k] + [turbulence * rng.standard_normal(), 0.0]
        return Record(t, u[:, None], y, ("lat",), ("p", "phi"), "gusts", "zoh")

    settings = {"order": 2, "past": 10, "pole": 8.0, "feedthrough": False}
    return truth, settings, lambda rng: [fly(rng) for _ in range(2)]


def lines(duration):
    """The same of a damped pair under a multisine of twelve lines."""
    truth = StateSpace([[-0.8, 2.0], [-2.0, -0.8]], [[1.0], [0.5]], np.eye(2), [[0.0], [0.0]])
    t = np.arange(0, duration, INTERVAL)
    omega = 2 * np.pi / duration * np.unique(np.round(np.geomspace(0.1, 2.5, 12) * duration))

    def fly(rng):
        u = np.cos(t[:, None] * omega + rng.uniform(0, 7, len(omega))).sum(axis=1)[:, None]
        y = truth.simulate(t, u)
        y = y + NOISE * np.std(y, axis=0) * rng.standard_normal(y.shape)
        return [Record(t, u, y, ("u",), ("a", "b"))]

    return truth, {"order": 2}, fly


def manoeuvres():
    """The same of four 3-2-1-1 of the UH-60, at half of its order."""
    settings = {"order": 18, "past": 8, "pole": 8.0, "feedthrough": ["ax", "ay", "az"]}
    return oracle(), settings, lambda rng: linear_records(STEPS, int(rng.integers(2**31)))


CASES = {
    "one input, 2 × 40 s": loop(single, 1, 40.0),
    "one input, 2 × 10 s": loop(single, 1, 10.0),
    "one input, gain × 3, 2 × 40 s": loop(single, 3, 40.0),
    "one input, gain × 3, 2 × 10 s": loop(single, 3, 10.0),
    "two inputs, 2 × 40 s": loop(multi, 1, 40.0),
    "two inputs, 2 × 16 s": loop(multi, 1, 16.0),
    "two inputs, gain × 2, 2 × 40 s": loop(multi, 2, 40.0),
    "no turbulence, 2 × 30 s": gusts(0.0),
    "turbulence 0.01, 2 × 30 s": gusts(0.01),
    "turbulence 0.02, 2 × 30 s": gusts(0.02),
    "turbulence 0.02, gain × 2, 2 × 30 s": gusts(0.02, gain=2.0),
    "turbulence 0.02, 2 × 10 s": gusts(0.02, 10.0),
    "open loop, 40 s": lines(40.0),
    "open loop, 20 s": lines(20.0),
    "open loop, 10 s": lines(10.0),
    "UH-60, 4 × 16 s": manoeuvres(),
}


def run(truth, settings, fly, seeds):
    """Errors of the logarithm over their stated deviations, (runs, 2, K, ny, nu).

    And how many runs ended with prediction errors, and how many are doubted.
    """
    true, found, doubted, moved = truth.response(OMEGA), [], 0, 0
    for seed in seeds:
        box = pbsid(fly(np.random.default_rng([12, seed])), **settings)
        if box.uncertainty is None:
            continue
        doubted += bool(box.doubts())
        moved += box.refinement == "prediction"
        size, phase = box.response_std(OMEGA)
        error = np.log(box.continuous().system.response(OMEGA) / true)
        found.append([error.real / size, error.imag / phase])
    return np.array(found), moved, doubted


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="")
    wanted = parser.parse_args()
    warnings.simplefilter("ignore", DataWarning)
    rows = []
    for name, case in CASES.items():
        if wanted.only in name:
            off, moved, doubted = run(*case, range(wanted.first, wanted.first + wanted.runs))
            bias = np.sqrt(np.mean(np.mean(off, axis=0) ** 2))
            held = 100 * np.mean(np.abs(off) < 1.96)
            rows.append(
                [
                    name,
                    f"{len(off)} of {wanted.runs}",
                    moved,
                    doubted,
                    np.sqrt(np.mean(off**2)),
                    bias,
                    held,
                ]
            )
            print(rows[-1], flush=True)
    print(
        table(
            [
                "records",
                "runs with intervals",
                "by prediction errors",
                "doubted",
                "rms error, σ",
                "rms mean error, σ",
                "95 % intervals cover, %",
            ],
            rows,
        )
    )


if __name__ == "__main__":
    main()
