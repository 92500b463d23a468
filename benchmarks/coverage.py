"""Do the stated errors of frequency responses hold, in the edges of the band too?

Linear truths, each flown through four sweeps in its loop, the noise of the instruments fed back:
the 32-state UH-60, the AH-1S's eight states, and the twelve of AW109 (MODEL, its JSON). By method
and fifth of the band (0.4-12 rad/s, logarithmic), of points with coherence of 0.6 or more in the
averaged spectra: root mean square error of the response's logarithm, and the share of gains and
phases within 1.96 stated errors.

    OMP_NUM_THREADS=1 python -m benchmarks.coverage [MODEL] [--runs 20] [--first 0]
"""

import argparse
import json
import warnings
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS, ROOT, oracle, sweep
from casid import Record, StateSpace, frequency_response

OMEGA = np.geomspace(0.4, 12.0, 40)
DT, LAG = 0.02, 0.06  # s
FEEDBACK = {  # p phi, q theta, r to sticks as shares of full travel
    "UH-60": (0.05, 0.15, 0.20, 0.25, 0.20),
    "AH-1S": (0.20, 0.40, -0.40, -0.50, -0.30),
    "AW109": (0.15, 0.40, -0.40, -0.80, -0.40),
}
SIZE = {  # of the sweeps, shares of full travel
    "UH-60": (0.04, 0.04, 0.025, 0.05),
    "AH-1S": (0.05, 0.10, 0.06, 0.10),
    "AW109": (0.04, 0.04, 0.025, 0.05),
}


def truths(aw109: Path | None) -> dict[str, StateSpace]:
    """Linear aircraft in SI units and shares of full travel."""
    plant = oracle()
    found = {
        "UH-60": StateSpace(plant.A, 100 * plant.B, plant.C, 100 * plant.D, None, INPUTS, OUTPUTS),
        "AH-1S": ah1s(),
    }
    if aw109 is not None:
        content = json.loads(aw109.read_text())
        A, B, C, D = (np.array(content[name]) for name in "ABCD")
        found["AW109"] = StateSpace(A, 100 * B, C, 100 * D, None, INPUTS, OUTPUTS)
    return found


def ah1s() -> StateSpace:
    """The eight states, with specific forces; stored with sticks col, lon, lat, ped."""
    content, g = json.loads((ROOT / "examples/ah1s/ah1s_jsbsim_080kt.json").read_text()), 9.80665
    A, B = np.array(content["A"]), np.array(content["B"])[:, [0, 2, 1, 3]]
    U0, V0, W0 = 0.3048 * np.array(content["trim"]["u_v_w_fps"])
    theta, phi = (content["trim"][f"{angle}_rad"] for angle in ("theta", "phi"))
    C, D = np.vstack([A[:3], np.eye(8)[3:]]), np.vstack([B[:3], np.zeros((5, 4))])
    C[0, [4, 5, 7]] += W0, -V0, g * np.cos(theta)
    C[1, [3, 5, 6]] += -W0, U0, -g * np.cos(theta) * np.cos(phi)
    C[2, [3, 4, 7]] += V0, -U0, g * np.sin(theta)
    return StateSpace(A, B, C, D, None, INPUTS, OUTPUTS)


def loop(name: str, plant: StateSpace) -> StateSpace:
    """From commands and the instruments' noise (12,) to outputs and sticks (12,)."""
    K = np.zeros((4, 8))
    K[[1, 1, 2, 2, 3], [3, 6, 4, 7, 5]] = FEEDBACK[name]
    A = np.block([[plant.A, plant.B], [-K @ plant.C / LAG, -(np.eye(4) + K @ plant.D) / LAG]])
    B = np.vstack([np.zeros((plant.nx, 12)), np.hstack([np.eye(4), -K]) / LAG])
    C = np.block([[plant.C, plant.D], [np.zeros((4, plant.nx)), np.eye(4)]])
    return StateSpace(A, B, C, np.zeros((12, 12)))


def sweeps(name: str, closed: StateSpace, rng: np.random.Generator) -> list[Record]:
    """Four sweeps of 70 s with noise, one axis at a time."""
    t, found = DT * np.arange(3501), []
    for j, axis in enumerate(INPUTS):
        r, noise = np.zeros((len(t), 4)), rng.standard_normal((len(t), 8)) * list(NOISE.values())
        r[:, j] = SIZE[name][j] * sweep(t)
        y, u = np.split(closed.simulate(t, np.hstack([r, noise])), [8], axis=1)
        found.append(Record(t, u, y + noise, INPUTS, OUTPUTS, f"sweep {axis}"))
    return found


def measure(name: str, plant: StateSpace, runs: range) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Squared errors of gain and phase and what lies within (runs, 2, K, pairs), by method."""
    truth, closed = plant.response(OMEGA), loop(name, plant)
    found: dict[str, list] = {"local": [], "windows": []}
    for run in runs:
        records = sweeps(name, closed, np.random.default_rng([run, 70]))
        for method, rows in found.items():
            each = frequency_response(records, omega=OMEGA, method=method)
            ratio = np.log(each.G / truth)
            error = np.where(each.coherence >= 0.6, [ratio.real, ratio.imag], np.nan)
            within = np.where(np.isnan(error), np.nan, np.abs(error) < 1.96 * each.error)
            rows.append((error**2, within))
    return {m: tuple(np.array(column) for column in zip(*rows, strict=True))
            for m, rows in found.items()}  # fmt: skip


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("aw109", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    rows = []
    for name, plant in truths(chosen.aw109).items():
        runs = range(chosen.first, chosen.first + chosen.runs)
        for method, (squared, within) in measure(name, plant, runs).items():
            fifths = np.array_split(np.arange(len(OMEGA)), 5)
            rms = [100 * np.sqrt(np.nanmean(squared[:, :, at])) for at in fifths]
            held = [100 * np.nanmean(within[:, :, at]) for at in fifths]
            cells = [f"{r:.1f} / {h:.0f}" for r, h in zip(rms, held, strict=True)]
            rows.append([name, method, *cells])
    head = ("lowest fifth", "second", "third", "fourth", "highest")
    print(table(("truth", "method", *head), rows))
    print("rms error [%] / share within 95 % interval [%]")


if __name__ == "__main__":
    main()
