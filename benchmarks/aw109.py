"""Output error from the quadratic match on a strongly coupled helicopter, three speeds.

Records are those of heli-gym's AW109 at 40, 60 and 80 kn (folders 040kt, 060kt, 080kt of DATA, each
with 3211_*.csv and sweep_*.csv), noise added. Three structures, from the quadratic match to a black
box of all eight records, on the four 3-2-1-1 and on all eight: 18 fits with default settings.

    OMP_NUM_THREADS=1 python -m benchmarks.aw109 DATA [--seed S] [--kept FILE] [--only WORDS]

A case in FILE (JSON lines) is not run again. Seconds are processor time.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS, STEPS, SWEEPS
from casid import ConvergenceError, Model, Record, match, output_error, pbsid, read_csv
from models.hybrid_flap import HybridFlap
from models.hybrid_flap_lag import HybridFlapLag
from models.six_dof import SixDof

SPEEDS = ("040kt", "060kt", "080kt")
STRUCTURES = (SixDof, HybridFlap, HybridFlapLag)
TRIM = {"U0": "u", "V0": "v", "W0": "w", "P0": "p", "Q0": "q", "R0": "r", "phi0": "phi",
        "theta0": "theta"}  # fmt: skip
STILL = 100  # samples at the beginning of every record: 2 s of trim


def noisy_records(folder: Path, seed: int) -> list[Record]:
    """The 3-2-1-1 and the sweeps, in this order, from their trim."""
    rng = np.random.default_rng(seed)
    given = {"inputs": INPUTS, "outputs": OUTPUTS, "units": dict.fromkeys(INPUTS, "%")}
    return [
        read_csv(folder / f"{name}.csv", detrend="first", **given).with_noise(NOISE, rng)
        for name in (*STEPS, *SWEEPS)
    ]


def trim(folder: Path) -> dict[str, float]:
    """Trim values by the fields of the structures."""
    names = tuple(TRIM.values())
    units = dict.fromkeys(INPUTS, "%")
    still = [
        read_csv(folder / f"{name}.csv", inputs=INPUTS, outputs=names, units=units).y[:STILL]
        for name in STEPS
    ]
    return dict(zip(TRIM, map(float, np.mean(still, axis=(0, 1))), strict=True))


def start(structure: type[Model], folder: Path, records: list[Record]) -> Model:
    """The quadratic match of a structure to a black box of the records."""
    values, fields = trim(folder), structure.__dataclass_fields__
    box = pbsid(records, order=18, pole=10.0, past=10, future=10, feedthrough=["ax", "ay", "az"])
    model = structure(**{name: value for name, value in values.items() if name in fields})
    try:
        return match(model, box, norm="quadratic").model
    except ConvergenceError as error:
        return error.best.model


def run(structure: type[Model], folder: Path, which: str, seed: int) -> dict[str, object]:
    """One of the 18."""
    records = noisy_records(folder, seed)
    model = start(structure, folder, records)
    begin = time.process_time()
    try:
        fit = output_error(model, records[: 4 if which == "3-2-1-1" else 8])
    except ConvergenceError as error:
        fit = error.best
    return {
        "case": f"{folder.name} {structure.__name__} {which}", "success": fit.success,
        "iterations": fit.iterations, "interval": fit.interval, "cost": fit.cost,
        "seconds": time.process_time() - begin, "status": fit.status,
        "bounds": [row.name for row in fit.parameters if row.active],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--seed", type=int, default=109)
    parser.add_argument("--kept", type=Path, default=Path("aw109.jsonl"))
    parser.add_argument("--only", default="", help="words a case must have")
    chosen = parser.parse_args()
    lines = chosen.kept.read_text().splitlines() if chosen.kept.exists() else []
    done = {row["case"]: row for row in map(json.loads, lines)}
    cases = [(s, k, w) for w in ("3-2-1-1", "eight") for k in STRUCTURES for s in SPEEDS]
    for speed, structure, which in cases:
        name = f"{speed} {structure.__name__} {which}"
        if name not in done and all(word in name for word in chosen.only.split()):
            done[name] = run(structure, chosen.data / speed, which, chosen.seed)
            with chosen.kept.open("a") as file:
                file.write(json.dumps(done[name]) + "\n")
    header = ("case", "converged", "iterations", "interval, s", "s", "cost", "status")
    rows = [
        (row["case"], "yes" if row["success"] else "NO", str(row["iterations"]), row["interval"],
         row["seconds"], f"{row['cost']:.1f}", row["status"])
        for row in done.values()
    ]  # fmt: skip
    print(table(header, rows))


if __name__ == "__main__":
    main()
