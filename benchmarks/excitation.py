"""Does a record hold the aircraft or its controller: the excitation certificate on known answers.

    python -m benchmarks.excitation [--data FOLDER] [--log FILE] [--seed N]

Simulated loops of one and four axes at 20 ratios of outside excitation to noise, against the closed
form; helicopters flown by test inputs and quadrotors flown by their controllers (the examples);
with FOLDER (or CASID_FLIGHTS), which holds `flights/bench/sess006.csv`, `trex550/` and
`aw109_heligym/`, an autopilot shaken by hand in cuts of 8 to 26 s, a flight that is bad for
identification, and a third helicopter. The first two are of github.com/dronefreak/
system-identification-helicopter (MIT).

Every case is kept in the log as it comes, and a run that finds it there goes on.
"""

import argparse
import os
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.aw109 import noisy_records
from casid import DataWarning, Record, excitation, read_csv, read_mat, read_study
from casid.studies.study import read_records
from casid.textfile import read_json, write_json

ROOT = Path(__file__).resolve().parents[1]
DT = 0.02
RATIOS = np.geomspace(0.02, 50, 20)  # power of outside excitation over that of the noise
CUTS, EVERY = (8.0, 11.0, 15.0, 20.0, 26.0), 1.0  # s
BANDS = {"1 Hz": (0.8, 1.2), "2-8 Hz": (2.0, 8.0)}


def plant(n):
    """x(k+1) = A x + B u, y = x + noise, u = reference - K y."""
    beside = np.ones((n, n)) - np.eye(n)
    return 0.96 * np.eye(n) + 0.01 * beside, 0.05 * np.eye(n), 1.5 * np.eye(n) + 0.3 * beside


def flown(n, power, N=12_000, seed=0):
    """A record of the loop with references of that power, (n,) or one for all."""
    A, B, K = plant(n)
    rng = np.random.default_rng(seed)
    size = np.sqrt([np.broadcast_to(power, n), np.ones(n)])[:, None]
    w, e = rng.standard_normal((2, N, n)) * size
    reference, noise, x = np.zeros(n), np.zeros(n), np.zeros(n)
    u, y = np.empty((N, n)), np.empty((N, n))
    for k in range(N):
        noise, reference = 0.9 * noise + 0.1 * e[k], 0.8 * reference + 0.2 * w[k]
        y[k] = x + noise
        u[k] = reference - K @ y[k]
        x = A @ x + B @ u[k]
    names = [tuple(f"{letter}{i}" for i in range(n)) for letter in "uy"]
    return Record(DT * np.arange(N), u, y, *names, "loop")


def share(n, power, omega):
    """Its closed form: S Φ_r Sᴴ over S (Φ_r + K Φ_v Kᴴ) Sᴴ, S = (1 + K G)⁻¹; diagonal, (K, n)."""
    A, B, K = plant(n)
    found = []
    for z in np.exp(1j * omega * DT):
        S = np.linalg.inv(np.eye(n) + K @ np.linalg.solve(z * np.eye(n) - A, B))
        outside = np.diag(np.broadcast_to(power, n)) * np.abs(0.2 / (1 - 0.8 / z)) ** 2
        back = K @ K.T * np.abs(0.1 / (1 - 0.9 / z)) ** 2
        parts = [np.diag(S @ each @ S.conj().T).real for each in (outside, back)]
        found.append(parts[0] / sum(parts))
    return np.array(found)


def loop(n, ratio, seed):
    """Error of the share over the band of the inputs: median, rms and largest."""
    found = excitation(flown(n, ratio, seed=seed))
    error = np.abs(found.lower - share(n, ratio, found.omega))[found.within.all(axis=1)]
    return {
        "median": float(np.median(error)),
        "rms": float(np.sqrt(np.mean(error**2))),
        "largest": float(error.max()),
        "below 0.1": float(np.mean(error < 0.1)),
    }


def judged(records):
    """How many doubts there are, and the median share of each input over its band."""
    found = excitation(records)
    shares = [float(np.median(x[w])) for x, w in zip(found.lower.T, found.within.T, strict=True)]
    return {"doubts": len(found.doubts()), **dict(zip(found.inputs, shares, strict=True))}


def bench(path):
    """Every cut of 8 s and more of the autopilot that was shaken: how many are doubted."""
    record = read_csv(path, inputs=("roll", "pitch", "yaw"), outputs=("p", "q", "r"))
    spans = [(a, a + cut) for cut in CUTS for a in np.arange(*record.t[[0, -1]] - [0, cut], EVERY)]
    cuts = [excitation(record.cut(*span)).doubts() for span in spans]
    return {
        "cuts": len(cuts),
        "doubted": sum(map(bool, cuts)),
        "whole": len(excitation(record).doubts()),
    }


def trex(folder):
    """The flight that vibrates, and how many of its stretches of 20 and 40 s are doubted."""
    inputs = {name: ("inr", k) for k, name in enumerate(("lat", "lon", "col", "ped"))}
    outputs = {
        name: ("outr", k) for name, k in {"p": 2, "q": 3, "phi": 4, "theta": 5, "r": 9}.items()
    }
    (path,) = sorted(Path(folder).glob("*.mat"))
    record = read_mat(path, inputs=inputs, outputs=outputs, time=0.01, detrend="mean")
    first, last = record.t[[0, -1]]
    doubted = {
        f"doubted of {len(starts)} cuts of {cut:g} s": sum(
            bool(excitation(record.cut(a, a + cut)).doubts()) for a in starts
        )
        for cut, every in ((20.0, 7.5), (40.0, 7.5))
        for starts in [np.arange(first, last - cut, every)]
    }
    return judged(record) | doubted


def crazyflie(name):
    """Shares of roll and pitch of one flight of the example, near 1 Hz and at 2-8 Hz."""
    flights = read_records(read_study(ROOT / "examples/crazyflie/study.toml"))
    (record,) = [each for role in flights.values() for each in role if each.name == name]
    found = excitation(record.select(outputs=("p", "q", "r", "phi", "theta")))
    hertz = found.omega / (2 * np.pi)
    return {
        f"{axis}, {band}": float(np.median(found.lower[(hertz >= a) & (hertz <= b), i]))
        for i, axis in enumerate(found.inputs)
        if axis in ("roll", "pitch")
        for band, (a, b) in BANDS.items()
    }


def helicopter(study):
    """A campaign of an example with its noise: accepted if there are no doubts."""
    return judged(read_records(read_study(ROOT / study))["identification"])


def cases(data, seed) -> Iterator[tuple[str, Callable[[], dict[str, float]]]]:
    """Every case by name."""
    for n in (1, 4):
        for k, ratio in enumerate(RATIOS):
            yield (
                f"loop of {n}, ratio {ratio:.3g}, seed {seed + k}",
                partial(loop, n, ratio, seed + k),
            )
    for study in ("uh60", "ah1s"):
        yield study, partial(helicopter, f"examples/{study}/study.toml")
    for path in sorted((ROOT / "examples/crazyflie/data").glob("*.csv")):
        yield path.stem, partial(crazyflie, path.stem)
    if data is not None:
        yield "shaken by hand", partial(bench, data / "flights/bench/sess006.csv")
        yield "trex550", partial(trex, data / "trex550")
        for folder in sorted((data / "aw109_heligym").glob("*kt")):
            yield f"aw109 {folder.name}", lambda f=folder: judged(noisy_records(f, seed))


def main():
    """Print each case; what the log holds is not computed again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    folder = os.environ.get("CASID_FLIGHTS")
    parser.add_argument("--data", type=Path, default=folder and Path(folder))
    parser.add_argument("--log", type=Path, default=ROOT / "out/excitation.json")
    parser.add_argument("--seed", type=int, default=100)
    asked = parser.parse_args()
    warnings.simplefilter("ignore", DataWarning)
    log = read_json(asked.log) if asked.log.exists() else {}
    for name, run in cases(asked.data, asked.seed):
        if name not in log:
            log[name] = run()
            write_json(asked.log, log)
        print(f"{name}: " + ", ".join(f"{key} {value:.3g}" for key, value in log[name].items()))


if __name__ == "__main__":
    main()
