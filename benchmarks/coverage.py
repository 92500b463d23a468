"""Do the stated errors of frequency responses hold, in the edges of the band too?

Linear truths, each flown through four sweeps of 70 s, four 3-2-1-1 of 16 s, or all eight in its
loop, the noise of the instruments fed back: the 32-state UH-60, the AH-1S's eight states, and the
twelve of AW109 (MODEL, its JSON). By records, method and fifth of the band (0.4-12 rad/s,
logarithmic), of points with coherence of 0.6 or more in the averaged spectra: root mean square
error of the response's logarithm, and the share of gains and phases within 1.96 stated errors. Over
the whole band: the median stated error over that of a normal number with the median error, and the
share of points that are further than four stated errors off, gain or phase. With --usual only the
points that are coherent in three of four runs: few windows make others coherent by chance.

    OMP_NUM_THREADS=1 python -m benchmarks.coverage [MODEL] [--runs 20] [--first 0] [--usual]
"""

import argparse
import json
import warnings
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS, ROOT, oracle, steps, sweep
from casid import Record, StateSpace, frequency_response

OMEGA = np.geomspace(0.4, 12.0, 40)
DT, LAG = 0.02, 0.06  # s
SEEN = 0.02  # share of coherent points that is enough to speak of
FEEDBACK = {  # p phi, q theta, r to sticks as shares of full travel
    "UH-60": (0.05, 0.15, 0.20, 0.25, 0.20),
    "AH-1S": (0.20, 0.40, -0.40, -0.50, -0.30),
    "AW109": (0.15, 0.40, -0.40, -0.80, -0.40),
}
SIZE = {  # of sweeps and steps, shares of full travel
    "UH-60": (0.04, 0.04, 0.025, 0.05),
    "AH-1S": (0.05, 0.10, 0.06, 0.10),
    "AW109": (0.04, 0.04, 0.025, 0.05),
}
FLOWN = {"sweeps": slice(4), "3-2-1-1": slice(4, 8), "all eight": slice(8)}


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


def flights(name: str, closed: StateSpace, rng: np.random.Generator) -> list[Record]:
    """Four sweeps of 70 s and four 3-2-1-1 of 16 s, with noise, one axis at a time."""
    found = []
    for kind, axis in product(("sweep", "3-2-1-1"), INPUTS):
        t, j = DT * np.arange(3501 if kind == "sweep" else 801), INPUTS.index(axis)
        r, noise = np.zeros((len(t), 4)), rng.standard_normal((len(t), 8)) * list(NOISE.values())
        r[:, j] = SIZE[name][j] * (sweep(t) if kind == "sweep" else steps(t, axis))
        y, u = np.split(closed.simulate(t, np.hstack([r, noise])), [8], axis=1)
        found.append(Record(t, u, y + noise, INPUTS, OUTPUTS, f"{kind} {axis}"))
    return found


def measure(name: str, plant: StateSpace, runs: range) -> dict[tuple[str, str], list[np.ndarray]]:
    """Errors of gain and phase, NaN where incoherent, and stated ones (runs, 2, K, ny, nu)."""
    truth, closed = plant.response(OMEGA), loop(name, plant)
    found: dict[tuple[str, str], list] = {each: [] for each in product(FLOWN, ("local", "windows"))}
    for run in runs:
        records = flights(name, closed, np.random.default_rng([run, 70]))
        for (flown, method), rows in found.items():
            each = frequency_response(records[FLOWN[flown]], omega=OMEGA, method=method)
            ratio = np.log(each.G / truth)
            error = np.where(each.coherence >= 0.6, [ratio.real, ratio.imag], np.nan)
            rows.append((error, np.broadcast_to(each.error, error.shape)))
    return {key: [np.array(column) for column in zip(*rows, strict=True)]
            for key, rows in found.items()}  # fmt: skip


def cell(error: np.ndarray, stated: np.ndarray) -> str:
    """Root mean square error, and share within 1.96 stated ones; a dash where none is coherent."""
    seen = np.isfinite(error)
    if seen.mean() < SEEN:
        return "-"
    rms, within = np.sqrt(np.mean(error[seen] ** 2)), np.abs(error[seen]) < 1.96 * stated[seen]
    return f"{100 * rms:.1f} / {100 * within.mean():.0f}"


def whole(error: np.ndarray, stated: np.ndarray) -> tuple[str, str]:
    """Median stated error over the median error's, and share in % of points beyond four stated."""
    seen = np.isfinite(error)
    wide = np.median(stated[seen]) / (np.median(np.abs(error[seen])) / 0.6745)
    beyond = (np.abs(error) > 4 * stated).any(axis=1)[seen[:, 0]]
    return f"{wide:.2f}", f"{100 * beyond.mean():.2f}"


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("aw109", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--usual", action="store_true")
    chosen = parser.parse_args()
    rows = []
    for name, plant in truths(chosen.aw109).items():
        runs = range(chosen.first, chosen.first + chosen.runs)
        for key, (error, stated) in measure(name, plant, runs).items():
            if chosen.usual:
                error[:, :, np.isfinite(error[:, 0]).mean(axis=0) < 3 / 4] = np.nan
            fifths = np.array_split(np.arange(len(OMEGA)), 5)
            cells = [cell(error[:, :, at], stated[:, :, at]) for at in fifths]
            rows.append([name, *key, *cells, *whole(error, stated)])
    head = ("lowest fifth", "second", "third", "fourth", "highest", "width", "beyond 4, %")
    print(table(("truth", "records", "method", *head), rows))
    print("rms error [%] / share within 95 % interval [%]")


if __name__ == "__main__":
    main()
