"""Bias and standard deviation of the black box under feedback, over noise levels and gains.

    python -m benchmarks.closed_loop [--seeds 20]

Two records of 40 s at 50 Hz, inputs held between samples, of an unstable plant under sampled output
feedback with a lag; white noise on every output, fed back with it. "single": two states, a pole at
+0.5, gain 1.5 or three times that; "multi": five states, two inputs, three outputs, 0.1 ± 0.5j, its
stabilising gain or twice that. Figures are medians over 25 frequencies in 0.3-8 rad/s of the size
of bias and of standard deviation relative to the response (of the sampled plant for a sampled
model), %. The last column counts
how often the default found the feedback strong enough to go on to prediction errors.
"""

import argparse
import warnings
from functools import partial

import numpy as np

from benchmarks.tables import table
from casid import DataWarning, Record, StateSpace, pbsid
from casid.linear import foh_step
from casid.subspace.prediction import SampledUncertainty

OMEGA = np.geomspace(0.3, 8.0, 25)
INTERVAL, DURATION, LAG = 0.02, 40.0, 0.06  # s
NOISES = (0.02, 0.1, 0.3)
PROJECTED = {"past": 10, "pole": 6.0}
SAMPLED = {"past": 20, "transform": "none"}
METHODS = {
    "projected": partial(pbsid, **PROJECTED, refine=False),
    "projected, refined (default)": partial(pbsid, **PROJECTED),
    "samples": partial(pbsid, **SAMPLED, refine=False),
    "samples, refined": partial(pbsid, **SAMPLED),
}


def single():
    """Plant, gain, order and direct term of the single loop."""
    plant = StateSpace([[0.5, 1.0], [0.0, -3.0]], [[0.0], [3.0]], [[1.0, 0.5]], [[0.0]], None,
                       ("u",), ("y",))  # fmt: skip
    return plant, np.array([[1.5]]), {"order": 2, "feedthrough": False}


def multi():
    """Plant, gain, order and direct term of the multivariable loop."""
    A = [[0.1, 0.5, 0.0, 0.0, 0.0], [-0.5, 0.1, 1.0, 0.0, 0.0], [0.0, 0.0, -1.5, 2.5, 0.0],
         [0.0, 0.0, -2.5, -1.5, 1.0], [0.0, 0.0, 0.0, 0.0, -8.0]]  # fmt: skip
    B = [[0.0, 0.5], [1.0, 0.0], [2.0, 0.5], [0.0, 1.5], [4.0, -2.0]]
    C = [[1.0, 0, 0, 0.2, 0], [0, 1.0, 0.5, 0, 0], [0, 0, 1.0, 0, 0.5]]
    D = [[0.0, 0.0], [0.0, 0.0], [0.3, 0.0]]
    plant = StateSpace(A, B, C, D, None, ("a", "b"), ("x", "y", "z"))
    gain = np.array([[0.5, 1.2, 0.3], [1.0, 0.0, 0.0]])
    return plant, gain, {"order": 5, "feedthrough": ["z"]}


def record(plant, gain, noise, rng, duration=DURATION):
    """One record of the loop."""
    N, hold = int(duration / INTERVAL), 20
    reference = np.repeat(rng.choice([-1.0, 1.0], size=(N // hold, plant.nu)), hold, axis=0)
    A, B0, B1 = foh_step(plant.A, plant.B, INTERVAL)
    pole = np.exp(-INTERVAL / LAG)
    x, u = np.zeros(plant.nx), np.zeros(plant.nu)
    us, ys = np.empty((N, plant.nu)), np.empty((N, plant.ny))
    for k in range(N):
        us[k] = u
        ys[k] = plant.C @ x + plant.D @ u + noise * rng.standard_normal(plant.ny)
        x = A @ x + (B0 + B1) @ u
        u = pole * u + (1 - pole) * (reference[k] - gain @ ys[k])
    return Record(INTERVAL * np.arange(N), us, ys, plant.inputs, plant.outputs, "loop", "zoh")


def run(system, scale, noise, seeds):
    """Rows of one setting, a cell a method."""
    plant, gain, options = system()
    A, B0, B1 = foh_step(plant.A, plant.B, INTERVAL)
    sampled = StateSpace(A, B0 + B1, plant.C, plant.D, INTERVAL)
    truth = {None: plant.response(OMEGA), INTERVAL: sampled.response(OMEGA)}
    size = np.linalg.norm(truth[None], axis=(1, 2))
    found, went_on = {name: [] for name in METHODS}, 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        records = [record(plant, scale * gain, noise, rng) for _ in range(2)]
        for name, method in METHODS.items():
            box = method(records, **options)
            error = box.system.response(OMEGA) - truth[box.system.dt and INTERVAL]
            found[name].append(error)
            went_on += "default" in name and isinstance(box.uncertainty, SampledUncertainty)
    cells = []
    for errors in found.values():
        mean = np.mean(errors, axis=0)
        bias = np.median(np.linalg.norm(mean, axis=(1, 2)) / size)
        power = np.sum(np.abs(errors - mean) ** 2, axis=(2, 3)).mean(axis=0)
        cells.append(f"{100 * bias:.1f} / {100 * np.median(np.sqrt(power) / size):.1f}")
    return [*cells, f"{went_on} of {seeds}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    warnings.simplefilter("ignore", DataWarning)
    rows = []
    for system, scales in ((single, (1, 3)), (multi, (1, 2))):
        for scale in scales:
            rows += [
                [system.__name__, f"× {scale}", f"{noise:g}",
                 *run(system, scale, noise, options.seeds)]
                for noise in NOISES
            ]  # fmt: skip
    print(table(["loop", "gain", "noise", *METHODS, "prediction errors"], rows))


if __name__ == "__main__":
    main()
