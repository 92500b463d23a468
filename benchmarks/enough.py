"""Is the structure enough? Alarms where it is the truth, and what is named where it is not.

Truth: a structure matched to the black box of a helicopter's records is flown through the same
tests in closed loop, with noise; a black box of these records is compared with that structure,
matched to it from a start 30 % off. An alarm anywhere in any campaign counts.

Records: the ten cases of `benchmarks.ten_cases`; in how many bands the structure is at fault, and
where by the clearest of each output. And which structure `compare_structures` names: the simplest
that predicts 3-2-1-1 left out no worse.

    python -m benchmarks.enough AW109 [--campaigns 15] [--kept FILE] [--only WORDS]

AW109 has the folders 040kt, 060kt, 080kt. What FILE (JSON lines) holds is not computed again.
"""

import argparse
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import scipy.signal

from benchmarks.tables import table
from benchmarks.ten_cases import KNOTS, SETTINGS, Case, best
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS, STEPS, SWEEPS, steps, sweep
from casid import Model, Record, compare_structures, distances, frequency_response, match, pbsid
from casid.design.loop import Loop
from casid.free import free_parameters
from models.hybrid_flap import HybridFlap
from models.six_dof import SixDof

ALSO = re.compile(r" \(also after [^)]*\)")
DT, LAG = 0.02, 0.06  # s
AMPLITUDE = {"lat": 0.04, "lon": 0.025, "col": 0.04, "ped": 0.05}
LIGHT = {"lat": {"p": 0.05, "phi": 0.15}, "lon": {"q": 0.20, "theta": 0.25}, "ped": {"r": 0.20}}
LOOPS = {"UH-60": LIGHT, "AH-1S": {}}
TRUTHS = {
    f"{name}, {structure.__name__}": (name, structure, loop)
    for name, loop in LOOPS.items()
    for structure in (SixDof, HybridFlap)
}


def flown(model: Model, feedback: dict[str, dict[str, float]]) -> list[Record]:
    """Four 3-2-1-1 and four sweeps of a model in its loop, without noise."""
    free, found = free_parameters(model), []
    for name in (*STEPS, *SWEEPS):
        kind, axis = name.split("_")
        t = np.arange(0, 16 if kind == "3211" else 70, DT)
        r = np.zeros((len(t), len(INPUTS)))
        shape = steps(t, axis) if kind == "3211" else sweep(t)
        part = 1 - np.exp(-DT / LAG)
        r[:, INPUTS.index(axis)] = AMPLITUDE[axis] * scipy.signal.lfilter(
            [part], [1, part - 1], shape
        )
        loop = Loop(free, feedback, np.eye(len(OUTPUTS)), h=DT, N=len(t))
        done = loop.fly(r)
        found.append(Record(t, done.u, done.y, INPUTS, OUTPUTS, name))
    return found


@cache
def truth(name: str, data: Path) -> tuple[Model, list[Record]]:
    """A structure matched to records, and what it flies."""
    helicopter, structure, feedback = TRUTHS[name]
    model = Case(helicopter, structure, data, 1).rough()
    return model, flown(model, feedback)


def campaign(name: str, seed: int, data: Path) -> dict[str, object]:
    """One campaign of a structure that is true."""
    model, records = truth(name, data)
    rng = np.random.default_rng([seed, 60])
    noisy = [record.with_noise(NOISE, rng) for record in records]
    signs = np.where(np.arange(len(model.vector())) % 2, 1.3, 0.7)
    box, start = pbsid(noisy, **SETTINGS), model.with_vector(model.vector() * signs)
    found = distances(
        best(lambda: match(start, box, norm="quadratic")), box,
        frequency_response(noisy[len(STEPS) :], omega=np.geomspace(0.4, 12, 40)),
        band=(0.4, 12.0),
    )  # fmt: skip
    ratio = max(row.structure / row.structure_level for row in found.rows)
    far, doubted = (sum(getattr(r, kind) for r in found.rows) for kind in ("far", "doubted"))
    return {"alarms": far, "ratio": ratio, "doubted": doubted, "told": found.sentences()}


def records(helicopter: str, structure: type[Model], data: Path) -> dict[str, object]:
    """A structure and records that it cannot explain whole."""
    case = Case(helicopter, structure, data, 1)
    sweeps = frequency_response(case.records[len(STEPS) :], omega=np.geomspace(0.4, 12, 40))
    low, high = case.box().band
    found = distances(case.rough(), case.box(), sweeps, band=(max(0.4, low), min(12.0, high)))
    above = {
        output: sum(row.fault and row.output == output and row.band[0] > 2.9 for row in found.rows)
        for output in ("p", "q", "r")
    }
    pedals = [row for row in found.faults if (row.output, row.input) == ("r", "ped")]
    return {"faults": len(found.faults), "rows": len(found.rows), "above": above,
            "share": float(np.sqrt(np.mean([row.share**2 for row in found.rows]))),
            "pedals": [row.told() for row in pedals], "told": found.sentences()}  # fmt: skip


def named(helicopter: str, data: Path) -> dict[str, object]:
    """Structures by manoeuvres left out."""
    cases = {each.__name__: Case(helicopter, each, data, 1) for each in (SixDof, HybridFlap)}
    found = compare_structures(
        {name: case.rough() for name, case in cases.items()},
        cases["SixDof"].thinned(len(cases["SixDof"].records)),
        groups=[(name,) for name in STEPS],
    )
    return {"simplest": found.simplest, "table": found.to_markdown()}


def todo(count: int) -> Iterator[tuple[str, ...]]:
    """Names of what there is to do."""
    for seed in range(count):
        yield from (("truth", name, str(seed)) for name in TRUTHS)
    for name in ("UH-60", "AH-1S", *(f"AW109 {speed}" for speed in KNOTS)):
        yield from (("records", name, each.__name__) for each in (SixDof, HybridFlap))
        yield "named", name, ""


def show(done: dict[str, dict]) -> None:
    """Alarms of the truths, and what is told of the records."""
    rows = []
    for name in TRUTHS:
        own = [row for key, row in done.items() if key.startswith(f"truth | {name} |")]
        if own:
            worst = max(row["ratio"] for row in own)
            alarms = sum(row["alarms"] > 0 for row in own)
            rows.append([name, str(len(own)), str(alarms), f"{worst:.2f}"])
    print(table(("truth", "campaigns", "with an alarm", "largest distance over its level"), rows))
    rows = []
    for key, row in done.items():
        if key.startswith("records"):
            above = ", ".join(f"{output} {count}" for output, count in row["above"].items())
            share = f"{100 * row['share']:.0f} %"
            name, count = key[10:].replace(" | ", ", "), f"{row['faults']} of {row['rows']}"
            pedals = row["pedals"][0].partition(", ")[2] if row["pedals"] else "not"
            rows.append([name, count, share, above, pedals, ALSO.sub("", row["told"][0])])
    heading = ("records, structure", "at fault", "missed, rms", "above 3 rad/s", "r after pedals",
               "clearest")  # fmt: skip
    print("\n" + table(heading, rows))
    for key, row in done.items():
        if key.startswith("named"):
            print(f"\n{key[8:-3]}: {row['simplest']}", row["table"], sep="\n\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--campaigns", type=int, default=15, help="of every truth")
    parser.add_argument("--kept", type=Path, default=Path("enough.jsonl"))
    parser.add_argument("--only", default="", help="words that a name must have")
    chosen = parser.parse_args()
    lines = chosen.kept.read_text().splitlines() if chosen.kept.exists() else []
    done = {row["key"]: row for row in map(json.loads, lines)}
    structures = {each.__name__: each for each in (SixDof, HybridFlap)}
    for kind, name, last in todo(chosen.campaigns):
        key = f"{kind} | {name} | {last}"
        if key in done or not all(word in key for word in chosen.only.split()):
            continue
        if kind == "truth":
            result = campaign(name, int(last), chosen.data)
        elif kind == "named":
            result = named(name, chosen.data)
        else:
            result = records(name, structures[last], chosen.data)
        done[key] = {"key": key} | result
        with chosen.kept.open("a") as file:
            file.write(json.dumps(done[key], default=float) + "\n")  # NumPy's numbers too
    show(done)


if __name__ == "__main__":
    main()
