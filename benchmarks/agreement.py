"""Whether records that agree are left alone, and one that does not is named.

    OMP_NUM_THREADS=1 python -m benchmarks.agreement [--seeds N] [--order N]

Campaigns of the UH-60 and the AH-1S, eight records each with noise of that seed: sound, and with a
main channel of a 3-2-1-1 or a sweep 1.3 times as large, 80 ms late, or by a clock 2 % fast. Found
means that the channel is named, or its stick; which of the two manoeuvres on an axis is wrong,
these records do not tell. The lines say what was found.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, NOISE, ON_AXIS, OUTPUTS, ROOT, STEPS, SWEEPS
from casid import Record, pbsid, read_csv

FAULTS = ("none", "gain 1.3", "80 ms late", "clock 2 % fast")


def campaign(aircraft: str, seed: int) -> list[Record]:
    """The four 3-2-1-1 and the four sweeps of an example, with noise."""
    rng, units = np.random.default_rng(seed), dict.fromkeys(INPUTS, "%")
    given = {"inputs": INPUTS, "outputs": OUTPUTS, "units": units if aircraft == "uh60" else {}}
    folder = ROOT / "examples" / aircraft / "data"
    return [
        read_csv(folder / f"{name}.csv", detrend="first", **given).with_noise(NOISE, rng)
        for name in (*STEPS, *SWEEPS)
    ]


def spoilt(record: Record, name: str, fault: str) -> Record:
    """The record with a fault of one output."""
    i, t, y = record.outputs.index(name), record.t - record.t[0], record.y.copy()
    if fault == "gain 1.3":
        y[:, i] *= 1.3
    elif fault == "80 ms late":
        y[:, i] = np.interp(t - 0.08, t, y[:, i])
    elif fault == "clock 2 % fast":
        y[:, i] = np.interp(1.02 * t, t, y[:, i])
    return replace(record, y=y).take(1.02 * t <= t[-1])


def remarks(records: Sequence[Record], order: int) -> tuple[str, ...]:
    """What the black box says of its records."""
    settings = {"order": order, "past": 10, "pole": 10.0, "feedthrough": ["ax", "ay", "az"]}
    return pbsid(records, **settings).remarks


def main() -> None:
    """Print how many are named, and what was said."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--order", type=int, default=16)
    asked = parser.parse_args()
    rows = []
    for aircraft in ("uh60", "ah1s"):
        for fault in FAULTS:
            named = 0
            for seed in range(asked.seeds):
                records = campaign(aircraft, seed)
                output, stick = ON_AXIS[seed % 4]
                k = INPUTS.index(stick) + 4 * (seed // 4 % 2)
                records[k] = spoilt(records[k], output, fault)
                said = remarks(records, asked.order)
                named += any(f"{name} " in each for name in (output, stick) for each in said)
                print(aircraft, records[k].name, output, fault, *said, sep=" | ", flush=True)
            rows.append([aircraft, fault, f"{named} of {asked.seeds}"])
    print(table(["aircraft", "fault", "named"], rows))


if __name__ == "__main__":
    main()
