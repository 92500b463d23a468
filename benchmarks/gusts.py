"""Whether gusts in one record make records disagree, and whether another unit or sign is named.

    OMP_NUM_THREADS=1 python -m benchmarks.gusts [--seeds N] [--first N]

The Bo105 of `benchmarks.bo105`, its derivatives other by up to 30 % in every campaign, sampled by
SciPy: a 3-2-1-1 and a random two-level input on each stick, under feedback, with the example's
noise. In one record gusts of 0.5, 1 or 2 m/s, or one channel of a record of the wrong sign or unit.
Named means that what is said names that record and the channel, or the stick of its axis.
"""

import argparse
import warnings
from dataclasses import replace

import numpy as np
import scipy

from benchmarks import bo105
from benchmarks.tables import table
from casid import DataWarning, Record, pbsid
from models.six_dof import SixDof

DT = 0.02
AXES = {"col": "az", "lat": "p", "lon": "q", "ped": "r"}
FACTORS = (-1.0, 3.0, 57.3, 100.0)


def aircraft(rng: np.random.Generator) -> SixDof:
    """The published derivatives, each other by up to 30 %, without delays."""
    truth = replace(
        bo105.truth(), **dict.fromkeys(("tau_col", "tau_lat", "tau_lon", "tau_ped"), 0.0)
    )
    names = [n for n in truth.parameter_names() if not n.startswith("tau")]
    return replace(truth, **{n: getattr(truth, n) * rng.uniform(0.7, 1.3) for n in names})


def fly(model: SixDof, stick: str, kind: str, gust: float, rng: np.random.Generator) -> Record:
    """One record: Dryden-like gusts move u, v and w relative to the air."""
    system, gain = model.system(), bo105.feedback()
    A, N = system.A, 800 if kind == "3211" else 1500
    accelerations = np.where(np.arange(8)[:, None] < 3, system.C[:, :3], 0.0)
    B, D = np.hstack([system.B, -A[:, :3]]), np.hstack([system.D, -accelerations])
    plant = A, B, system.C, D
    Ad, Bd, C, D = scipy.signal.cont2discrete(plant, DT, "zoh")[:4]
    wanted = bo105.reference(stick, rng.choice([-1.0, 1.0]), DT, N)
    if kind != "3211":
        levels = np.repeat(rng.choice([-1.0, 1.0], N // 20 + 1), 20)[:N]
        wanted[:, SixDof.inputs.index(stick)] = 0.7 * bo105.AMPLITUDE[stick] * levels
    keep, tau = np.exp(-DT / 0.06), np.exp(-DT / np.array([3.0, 2.0, 1.0]))
    x, u, air, y = np.zeros(8), np.zeros((N + 1, 4)), np.zeros(3), np.empty((N, 8))
    for k in range(N):
        both = np.concatenate([u[k], air])
        y[k] = C @ x + D @ both + list(bo105.NOISE.values()) * rng.standard_normal(8)
        x = Ad @ x + Bd @ both
        u[k + 1] = keep * u[k] + (1 - keep) * (wanted[k] - gain @ y[k])
        air = tau * air + gust * np.sqrt(1 - tau**2) * rng.standard_normal(3)
    name = f"{kind}_{stick}"
    return Record(DT * np.arange(N), u[:N], y, SixDof.inputs, SixDof.outputs, name, "zoh")


def spoilt(record: Record, name: str, factor: float) -> Record:
    """The record with one channel times a factor."""
    u = record.u * np.where(np.array(record.inputs) == name, factor, 1.0)
    y = record.y * np.where(np.array(record.outputs) == name, factor, 1.0)
    return replace(record, u=u, y=y)


def told(records: list[Record]) -> list[str]:
    """What the black box says of records that disagree."""
    settings = {"order": 8, "past": 10, "pole": 10.0, "feedthrough": ["ax", "ay", "az"]}
    return [each for each in pbsid(records, **settings).remarks if "disagree" in each]


def main() -> None:
    """Print how many campaigns are accused, and how many faults named."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--faults", type=int, default=8)
    asked = parser.parse_args()
    warnings.simplefilter("ignore", DataWarning)
    counts = {"gusts": [0, asked.seeds], "another sign or unit": [0, asked.faults]}
    for seed in range(asked.first, asked.first + max(asked.seeds, asked.faults)):
        rng = np.random.default_rng(seed)
        model, k, flights = (
            aircraft(rng),
            int(rng.integers(8)),
            [(s, t) for t in ("3211", "steps") for s in AXES],
        )
        if seed < asked.first + asked.seeds:
            gust = (0.5, 1.0, 2.0)[seed % 3]
            said = told([fly(model, *f, gust * (i == k), rng) for i, f in enumerate(flights)])
            counts["gusts"][0] += bool(said)
            print(
                seed, f"{gust} m/s in {flights[k][1]}_{flights[k][0]}", *said, sep=" | ", flush=True
            )
        if seed < asked.first + asked.faults:
            records = [fly(model, *each, 0.0, rng) for each in flights]
            stick, factor = flights[k][0], FACTORS[seed % 4]
            name = stick if seed // 4 % 2 else AXES[stick]
            records[k] = spoilt(records[k], name, factor)
            said = told(records)
            right = (
                records[k].name in each and f" {n} is" in each
                for each in said
                for n in (stick, AXES[stick])
            )
            counts["another sign or unit"][0] += any(right)
            print(seed, f"{name} x {factor} in {records[k].name}", *said, sep=" | ", flush=True)
    print(
        table(["campaigns with", "told of"], [[n, f"{a} of {b}"] for n, (a, b) in counts.items()])
    )


if __name__ == "__main__":
    main()
