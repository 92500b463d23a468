"""The last step that predicts manoeuvres left out best, against the frequency domain alone.

The ten cases of `benchmarks.ten_cases`. Every last step of the chain is estimated from all records
and, for the choice, without some of them. Figures are root mean square errors on unseen records
without noise, geometric mean over the outputs of the ratio to the frequency-domain fit (`derivid`)
to averaged spectra of the sweeps, the classical method: of the step chosen, with the outputs on
which it is better or within 5 %, of all steps, and of `derivid` on local rational responses.

    OMP_NUM_THREADS=1 python -m benchmarks.choice [AW109] [--seeds 1] [--kept FOLDER] [--only WORDS]

AW109 has the folders 040kt, 060kt, 080kt; without it UH-60 and AH-1S are run. May be stopped at any
time: what FOLDER holds, cases and fits, is not computed again.
"""

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from benchmarks.ten_cases import KNOTS, OMEGA, SETTINGS, WAYS, Case, best
from benchmarks.uh60 import STEPS
from casid import (
    Execution,
    Match,
    Pbsid,
    SpectralAnalysis,
    derivid,
    frequency_response,
    validate,
)
from casid.stages.choice import WORDS, Choosing, chosen, compared
from casid.stages.stage import Task
from models.hybrid_flap import HybridFlap
from models.six_dof import SixDof

LOCAL = "derivid, local"


def task_of(case: Case, folder: Path) -> Task:
    """What the stage of the choice works on."""
    low, high = case.box().band
    omega = np.geomspace(max(0.4, low), min(12.0, high), 40)
    case.rough()
    roles = {
        "identification": case.records,
        "refinement": case.thinned(len(STEPS)),
        "frequency": case.records[len(STEPS) :],
    }
    settings = {
        "pbsid": Pbsid(**SETTINGS),
        "match": Match(omega=omega, weight="reachable"),
        "frequency": SpectralAnalysis(omega=OMEGA),
    }
    return Task(
        model=case.start, roles=roles, settings=settings, execution=Execution(folder=folder),
        results={"quadratic": case.found["rough"]},
    )  # fmt: skip


def run(case: Case, folder: Path) -> dict[str, object]:
    """Errors on the unseen records, mean over these, by output, and the choice."""
    begin = time.process_time()
    found = compared(Choosing(), task_of(case, folder))
    seconds = time.process_time() - begin
    alone = best(lambda: WAYS["frequency only"](case))
    response = frequency_response(case.records[len(STEPS) :], omega=OMEGA)
    local = best(lambda: derivid(case.start, response))
    fits = {name: fit for name, fit in zip(found.names, found.fits, strict=True) if fit}
    rms = validate({"frequency only": alone, LOCAL: local, **fits}, case.unseen).rms
    choice = chosen(found)
    return {
        "chosen": choice.chosen, "seconds": seconds, "reasons": dict(found.reasons),
        "rms": {name: each.mean(axis=0).tolist() for name, each in rms.items()},
        "excess": {
            name: pair
            for name, *pair in zip(found.names, choice.excess, choice.error, strict=True)
        },
        "errors": found.errors.tolist(), "noise": found.noise.tolist(),
        "vectors": {name: fit.model.vector().tolist() for name, fit in fits.items()},
    }  # fmt: skip


def show(done: dict[str, dict]) -> None:
    """Ratios to the frequency domain alone, and on how many outputs they are below one."""
    rows, own, over, wins = [], [], [], []
    for key, row in done.items():
        alone = np.array(row["rms"]["frequency only"])
        ratios = {name: np.array(each) / alone for name, each in row["rms"].items()}
        mean = {name: float(np.exp(np.log(each).mean())) for name, each in ratios.items()}
        step = row["chosen"]
        least = min(mean[name] for name in WORDS if name in mean)
        own.append(mean[step])
        over.append(mean[step] / least)
        wins.append(int((ratios[step] <= 1.05).sum()))
        cells = [f"{mean[name]:.2f}" if name in mean else "" for name in (*WORDS, LOCAL)]
        rows.append([key, f"{step} {own[-1]:.2f} / {wins[-1]}", f"{over[-1]:.2f}", *cells])
    print(table(("case", "chosen", "over the best", *WORDS, LOCAL), rows))
    print(
        f"chosen: mean {np.mean(own):.2f}, at most {np.max(own):.2f}; within 5 % of the best in "
        f"{np.sum(np.array(over) <= 1.05)}, on 7 of 8 outputs better or within 5 % in "
        f"{np.sum(np.array(wins) >= 7)} of {len(own)}"
    )


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--kept", type=Path, default=Path("out/choice"))
    parser.add_argument("--only", default="", help="words that a case must have")
    asked = parser.parse_args()
    asked.kept.mkdir(parents=True, exist_ok=True)
    file = asked.kept / "cases.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    done = {row["key"]: row for row in map(json.loads, lines)}
    helicopters = ["UH-60", "AH-1S", *(f"AW109 {speed}" for speed in KNOTS if asked.data)]
    cases = [
        (f"{name}, {each.__name__}, {seed}", name, each, seed)
        for seed in asked.seeds for name in helicopters for each in (SixDof, HybridFlap)
    ]  # fmt: skip
    for key, name, structure, seed in cases:
        if key in done or not all(word in key for word in asked.only.split()):
            continue
        case = Case(name, structure, asked.data, seed)
        done[key] = {"key": key} | run(case, asked.kept / key)
        with file.open("a") as kept:
            kept.write(json.dumps(done[key]) + "\n")
    show({key: done[key] for key, *_ in cases if key in done})


if __name__ == "__main__":
    main()
