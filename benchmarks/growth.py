"""Which growing modes a black box finds that are not there, and whether it doubts them itself.

    python -m benchmarks.growth FOLDER [--seeds 1 2 3] [--only NAME ...] [--log FILE]

FOLDER holds the simulated helicopters `uh60_genhel_80kt`, `ah1s_jsbsim_80kt`, `aw109_heligym` with
their linear models in `models`, and the flights of NanoBench's Crazyflie in `flights/crazyflie`.

Campaigns of a helicopter: its 3-2-1-1 records alone and with the sweeps, with noise of every seed;
of the quadrotor: each flight and all, commands mixed to axes, everything through a low-pass. All
settings are automatic. A growing mode is there if the linear model, or a long ARX model of the
noise-free records (50 lags at 25 Hz), grows with a pole near it; the quadrotor is held
to no growing mode at all. A campaign is sound where every growing mode is there; it is doubted
where `doubts()` says anything.

Runs are kept in the log as they come, and one that is found there is not done again.
"""

import argparse
import json
import warnings
from pathlib import Path

import numpy as np
import scipy.signal

from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, OUTPUTS, SWEEPS, with_noise
from benchmarks.uh60 import STEPS as MULTISTEPS
from casid import Record, pbsid, read_csv
from casid.textfile import read_json, write_json

HELICOPTERS = {
    "UH-60": ("uh60_genhel_80kt", "uh60_genhel_080kt"),
    "AH-1S": ("ah1s_jsbsim_80kt", "ah1s_jsbsim_080kt"),
    "AW109 40 kn": ("aw109_heligym/040kt", "aw109_040kt"),
    "AW109 60 kn": ("aw109_heligym/060kt", "aw109_060kt"),
    "AW109 80 kn": ("aw109_heligym/080kt", "aw109_080kt"),
}
CAMPAIGNS = {"all eight": MULTISTEPS + SWEEPS, "3-2-1-1": MULTISTEPS}
QUADROTOR = "Crazyflie"
NEAR = 0.3  # of a pole's modulus: what amplitudes move the slow pairs of these helicopters
SLOW = 0.03  # 1/s, added to that: two e-folds over the longest record
LAGS = 50
MIXING = np.array([[1, -1, -1, -1], [1, -1, 1, 1], [1, 1, 1, -1], [1, 1, -1, 1]]) / 4
FULL = 65535.0  # of a motor's command
CUTOFFS = (8.0, 15.0)  # Hz, of the low-pass


def helicopter(folder, name, names, seed=None):
    """Records of a campaign as perturbations from their trim."""
    channels = {"inputs": INPUTS, "outputs": OUTPUTS, "detrend": "first"}
    records = [
        read_csv(folder / HELICOPTERS[name][0] / f"{each}.csv", **channels) for each in names
    ]
    return with_noise(records, seed)


def growing_poles(folder, name):
    """Growing poles of the linear model and of a long ARX model of the noise-free records."""
    model = json.loads((folder / "models" / f"{HELICOPTERS[name][1]}.json").read_text())
    records = [r.decimate(2) for r in helicopter(folder, name, CAMPAIGNS["all eight"])]
    ny, dt = len(OUTPUTS), records[0].dt
    rows, targets = [], []
    for record in records:
        z = np.hstack([record.y, record.u])
        past = [z[LAGS - k : len(z) - k] for k in range(1, LAGS + 1)]
        rows.append(np.hstack([*past, record.u[LAGS:]]))
        targets.append(record.y[LAGS:])
    Phi, Y = np.vstack(rows), np.vstack(targets)
    scale = np.std(Phi, axis=0)
    theta = np.linalg.lstsq(Phi / scale, Y, rcond=1e-9)[0] / scale[:, None]
    width = ny + len(INPUTS)
    companion = np.eye(LAGS * ny, k=-ny)
    companion[:ny] = np.hstack([theta[k * width : k * width + ny].T for k in range(LAGS)])
    arx = np.log(np.linalg.eigvals(companion).astype(complex)) / dt
    both = np.concatenate([np.linalg.eigvals(np.array(model["A"])), arx])
    return [complex(pole) for pole in both if pole.real > 0 and pole.imag >= 0]


def flight(path, cutoff):
    """The flown part of a quadrotor's log: mixed commands to rates and attitude, low-passed."""
    names = path.open(encoding="utf-8").readline().strip().split(",")
    columns = dict(zip(names, np.genfromtxt(path, delimiter=",", skip_header=1).T, strict=True))
    motors = np.column_stack([columns[f"motor_motor_m{k}"] for k in range(1, 5)]) / FULL
    flown = np.flatnonzero((columns["pz"] > 0.4) & (motors > 0.25).all(axis=1))
    outputs = ("imu_gyro_x", "imu_gyro_y", "imu_gyro_z", "roll", "pitch")
    values = np.column_stack([motors @ MIXING, *(columns[name] for name in outputs)])
    span = slice(flown[0], flown[-1] + 1)
    t, values = columns["t"][span], values[span]
    for column in values.T:
        lost = np.isnan(column)
        column[lost] = np.interp(t[lost], t[~lost], column[~lost])
    low = scipy.signal.butter(4, cutoff, fs=1 / np.median(np.diff(t)), output="sos")
    values = scipy.signal.sosfiltfilt(low, values - values.mean(axis=0), axis=0)
    inputs = ("thrust", "roll", "pitch", "yaw")
    return Record(
        t, values[:, :4], values[:, 4:], inputs, ("p", "q", "r", "phi", "theta"), path.stem
    )


def cases(folder, seeds):
    """Every campaign: its aircraft, its name, and a function that gives its records."""
    for seed in seeds:
        for name in HELICOPTERS:
            for label, names in CAMPAIGNS.items():
                yield (
                    name,
                    f"{label}, seed {seed}",
                    lambda n=name, f=names, s=seed: helicopter(folder, n, f, s),
                )
    paths = sorted((folder / "flights" / "crazyflie").glob("*.csv"))
    for cutoff in CUTOFFS:
        for path in paths:
            label = f"{path.stem}, {cutoff:g} Hz"
            yield QUADROTOR, label, lambda p=path, c=cutoff: [flight(p, c)]
        yield QUADROTOR, f"all, {cutoff:g} Hz", lambda c=cutoff: [flight(p, c) for p in paths]


def run(records):
    """Growing modes of a black box with automatic settings, those it doubts, and its doubts."""
    feedthrough = [name for name in records[0].outputs if name in ("ax", "ay", "az")]
    box = pbsid(records, feedthrough=feedthrough)
    poles = box.continuous().system.poles()
    growing = [p for p in poles if p.real > 0 and p.imag >= 0]
    return {
        "order": box.order,
        "growing": [[p.real, p.imag] for p in growing],
        "doubted": [[p.real, p.imag] for p in box.doubtful],
        "doubts": list(box.doubts()),
    }


def near(pole, others):
    return any(abs(pole - other) <= NEAR * abs(other) + SLOW for other in others)


def judged(found, there):
    """Growing modes that are not there and not doubted, and whether a sound campaign is doubted."""
    growing, doubted = ([complex(*p) for p in found[key]] for key in ("growing", "doubted"))
    spurious = [p for p in growing if not near(p, there)]
    # Data that support no model at all are doubted as a whole.
    whole = len(found["doubts"]) > bool(doubted)
    missed = [] if whole else [p for p in spurious if not near(p, doubted)]
    return spurious, missed, not spurious and bool(found["doubts"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--only", nargs="+", default=[*HELICOPTERS, QUADROTOR])
    parser.add_argument("--log", type=Path, default=Path("out/growth.json"))
    wanted = parser.parse_args()
    warnings.simplefilter("ignore")
    log = read_json(wanted.log) if wanted.log.is_file() else {}
    wanted.log.parent.mkdir(parents=True, exist_ok=True)
    truths, counts = {}, {name: np.zeros(5, dtype=int) for name in wanted.only}
    for name, label, records in cases(wanted.folder, wanted.seeds):
        if name not in wanted.only:
            continue
        key = f"{name}, {label}"
        if key not in log:
            log[key] = run(records())
            write_json(wanted.log, log)
        if name not in truths:
            truths[name] = [] if name == QUADROTOR else growing_poles(wanted.folder, name)
        spurious, missed, wrongly = judged(log[key], truths[name])
        counts[name] += [1, len(spurious), len(missed), not spurious, wrongly]
        if spurious or wrongly:
            print(key, "not there:", np.round(spurious, 3), "undoubted:", np.round(missed, 3),
                  *log[key]["doubts"] * wrongly, flush=True)  # fmt: skip
    header = ["aircraft", "campaigns", "growing modes that are not there", "of these undoubted",
              "sound campaigns", "of these doubted"]  # fmt: skip
    rows = [[name, *(f"{c:d}" for c in count)] for name, count in counts.items()]
    print(table(header, [*rows, ["all", *(f"{c:d}" for c in sum(counts.values()))]]))


if __name__ == "__main__":
    main()
