"""Time and frequency domain against the frequency domain alone, on ten cases.

UH-60, AH-1S and heli-gym's AW109 at 40, 60 and 80 kn, each with six degrees of freedom and with
flapping lags. A black box of four 3-2-1-1 and four sweeps with noise is matched; output error goes
on from the quadratic match. Figures are root mean square errors on unseen records without noise,
geometric mean over the outputs of the ratio to the frequency-domain fit (`derivid`) to the sweeps.

    OMP_NUM_THREADS=1 python -m benchmarks.ten_cases AW109 [--seed S] [--kept FILE] [--only WORDS]

AW109 has the folders 040kt, 060kt, 080kt. What FILE (JSON lines) holds is not estimated again.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.aw109 import trim
from benchmarks.tables import table
from benchmarks.uh60 import INPUTS, NOISE, OUTPUTS, STEPS, SWEEPS
from casid import (
    ConvergenceError,
    Fit,
    Model,
    Record,
    derivid,
    frequency_response,
    match,
    output_error,
    pbsid,
    read_csv,
    validate,
)
from models.hybrid_flap import HybridFlap
from models.six_dof import SixDof

EXAMPLES = Path(__file__).parents[1] / "examples"
OMEGA = np.geomspace(0.4, 12.0, 40)
KNOTS = ("040kt", "060kt", "080kt")
TRIMS = {
    "UH-60": {"U0": 40.922, "V0": 2.811, "W0": 2.054, "R0": 0.0057, "phi0": 0.0213,
              "theta0": 0.0531},
    "AH-1S": {"U0": 41.13, "V0": 0.035, "W0": -1.412, "phi0": -0.0251, "theta0": -0.0343},
}  # fmt: skip
OPEN = tuple(f"{name}_open" for name in STEPS)
UNSEEN = {"UH-60": ("validation_random",), "AH-1S": OPEN}
SETTINGS = {"order": 18, "pole": 10.0, "past": 10, "future": 10, "feedthrough": ["ax", "ay", "az"]}


class Case:
    """A helicopter with a structure: records with noise, unseen ones without, the way to models."""

    def __init__(
        self, name: str, structure: type[Model], data: Path, seed: int, times: float = 1.0
    ) -> None:
        self.name = name
        folder = data / name[-5:] if name not in TRIMS else folder_of(name)
        rng = np.random.default_rng([seed, 18])
        clean = self.read(folder, (*STEPS, *SWEEPS), "first")
        noise = {output: times * std for output, std in NOISE.items()}
        self.records = [record.with_noise(noise, rng) for record in clean]
        known = clean[0].trim if name != "AH-1S" else "first"
        unseen = UNSEEN.get(name, ("validation_random",))
        self.unseen = self.read(folder, unseen, known)
        values, fields = TRIMS.get(name) or trim(folder), structure.__dataclass_fields__
        self.start = structure(**{key: value for key, value in values.items() if key in fields})
        self.found: dict[str, Fit] = {}

    def read(self, folder: Path, names: tuple[str, ...], how) -> list[Record]:
        """Records from their trim."""
        units = None if self.name == "AH-1S" else dict.fromkeys(INPUTS, "%")
        given = {"inputs": INPUTS, "outputs": OUTPUTS, "units": units, "detrend": how}
        return [read_csv(folder / f"{name}.csv", **given) for name in names]

    def box(self):
        """Black box of all eight records."""
        if "black box" not in self.found:
            self.found["black box"] = pbsid(self.records, **SETTINGS)
        return self.found["black box"]

    def matched(self, norm: str, weight: str | None) -> Fit:
        """The structure matched to the black box."""
        low, high = self.box().band
        omega = np.geomspace(max(0.4, low), min(12.0, high), 40)
        return match(self.start, self.box(), norm=norm, weight=weight, omega=omega)

    def rough(self) -> Model:
        """The quadratic match by what can be reached."""
        if "rough" not in self.found:
            self.found["rough"] = best(lambda: self.matched("quadratic", "reachable"))
        return self.found["rough"].model

    def thinned(self, count: int) -> list[Record]:
        """The first records at half their rate, where no step of a stick is lost by it."""
        step = 1 if self.name == "AH-1S" else 2
        return [record.decimate(step) for record in self.records[:count]]

    def refined(self, count: int, domain: str) -> Fit:
        """Output error on the first records."""
        return output_error(self.rough(), self.thinned(count), domain=domain)


def folder_of(name: str) -> Path:
    """Where the records of an example are."""
    return EXAMPLES / {"UH-60": "uh60", "AH-1S": "ah1s"}[name] / "data"


WAYS: dict[str, Callable[[Case], object]] = {
    "frequency only": lambda c: derivid(
        c.start, frequency_response(c.records[len(STEPS):], omega=OMEGA, method="windows")),
    "black box": Case.box,
    "quadratic, by reach": lambda c: c.matched("quadratic", "reachable"),
    "H∞, by reach": lambda c: c.matched("hinf", "reachable"),
    "H∞, by size": lambda c: c.matched("hinf", "size"),
    "time, 3-2-1-1": lambda c: c.refined(4, "time"),
    "time, all": lambda c: c.refined(8, "time"),
    "frequency, all": lambda c: c.refined(8, "frequency"),
}  # fmt: skip


def best(estimate: Callable[[], Fit]) -> Fit:
    """What an estimator found, also where it gave up."""
    try:
        return estimate()
    except ConvergenceError as error:
        return error.best


def run(case: Case, way: str) -> dict[str, object]:
    """One model and its errors on the unseen records, mean over these, by output."""
    begin = time.process_time()
    found = best(lambda: WAYS[way](case))
    seconds = time.process_time() - begin
    rms = validate({"model": found}, case.unseen).rms["model"].mean(axis=0)
    success = getattr(found, "success", True)
    return {"rms": rms.tolist(), "seconds": seconds, "success": success}


def show(done: dict[str, dict], cases: list[str]) -> None:
    """Ratios to the frequency domain alone, and on how many outputs they are below one."""
    rows, ratios = [], {way: [] for way in WAYS}
    for name in cases:
        if f"{name} | frequency only" not in done:
            continue
        alone, row = np.array(done[f"{name} | frequency only"]["rms"]), [name]
        for way in list(WAYS)[1:]:
            found = done.get(f"{name} | {way}")
            if found is None:
                row.append("")
                continue
            ratio = np.array(found["rms"]) / alone
            mean = float(np.exp(np.mean(np.log(ratio))))
            ratios[way].append(mean)
            row.append(f"{mean:.2f} / {(ratio < 1).sum()}" + "*" * (not found["success"]))
        rows.append(row)
    means = [f"{np.mean(r):.2f}, {np.max(r):.2f} at most" if r else "" for r in ratios.values()]
    print(table(("case", *list(WAYS)[1:]), [*rows, ["mean", *means[1:]]]))
    print("ratio of the errors / outputs on which they are smaller; *: not converged")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kept", type=Path, default=Path("ten_cases.jsonl"))
    parser.add_argument("--only", default="", help="words that case and way must have")
    chosen = parser.parse_args()
    lines = chosen.kept.read_text().splitlines() if chosen.kept.exists() else []
    done = {row["key"]: row for row in map(json.loads, lines)}
    helicopters = ("UH-60", "AH-1S", *(f"AW109 {speed}" for speed in KNOTS))
    names = []
    for helicopter in helicopters:
        for structure in (SixDof, HybridFlap):
            names.append(f"{helicopter}, {structure.__name__}, {chosen.seed}")
            keys = [f"{names[-1]} | {way}" for way in WAYS]
            todo = [
                key for key in keys
                if key not in done and all(word in key for word in chosen.only.split())
            ]  # fmt: skip
            case = Case(helicopter, structure, chosen.data, chosen.seed) if todo else None
            for key in todo:
                done[key] = {"key": key} | run(case, key.partition(" | ")[2])
                with chosen.kept.open("a") as file:
                    file.write(json.dumps(done[key]) + "\n")
    show(done, names)


if __name__ == "__main__":
    main()
