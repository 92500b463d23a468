"""Whether any estimator ends worse than its start, from the guess, its own result and at random.

Six structures of the gallery, UH-60, AH-1S and AW109, records with noise: matches to a black box of
all eight records, output error on the four 3-2-1-1 at half their rate, `derivid` on responses to
the sweeps. A start costs what the same estimator makes of it with every parameter held (one may
move by a billionth), in the frequency domain by the spectra of the end; matches have the weights
that the guess reaches. Random starts are the guess moved by half of every parameter's magnitude.

    OMP_NUM_THREADS=1 python -m benchmarks.endings AW109 [--starts 20] [--seed S] [--kept FILE]
                                                         [--only WORDS]

AW109 has the folder 060kt. What FILE (JSON lines) holds is not estimated again.
"""

import argparse
import json
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from benchmarks.ten_cases import OMEGA, Case, best
from benchmarks.uh60 import STEPS
from casid import Derivid, Fit, Match, Model, OutputError, frequency_response
from casid.free import free_parameters
from models.hybrid_flap import HybridFlap
from models.hybrid_flap_lag import HybridFlapLag
from models.lateral_directional import LateralDirectional
from models.longitudinal import Longitudinal
from models.short_period import ShortPeriod
from models.six_dof import SixDof

HELICOPTERS = ("UH-60", "AH-1S", "AW109 060kt")
STRUCTURES = (ShortPeriod, Longitudinal, LateralDirectional, SixDof, HybridFlap, HybridFlapLag)
ESTIMATORS = {
    "match quadratic": Match(norm="quadratic"), "match hinf": Match(), "derivid": Derivid(),
    "output error, frequency": OutputError(domain="frequency"), "output error": OutputError(),
}  # fmt: skip
SPREAD = 0.5  # of a parameter's magnitude
MOVED = 1e-9  # of the one parameter that is not held
WORSE = 1e-6  # relative to a cost of a match or `derivid`, which is positive
LIKELY = 1e-4  # of log-likelihood
ALIKE = 1e4  # times that: ends as good


def data_of(case: Case, name: str) -> object:
    """What an estimator takes."""
    if name.startswith("match"):
        return case.box()
    if name == "derivid":
        return frequency_response(case.records[len(STEPS) :], omega=OMEGA, method="windows")
    return case.thinned(len(STEPS))


def random_start(model: Model, seed: int, k: int) -> Model:
    """The model with every parameter moved within its bounds."""
    free, rng = free_parameters(model), np.random.default_rng([seed, k])
    bounds = free.lower[free.index], free.upper[free.index]
    moved = free.guess + SPREAD * free.scale[free.index] * rng.standard_normal(len(free.index))
    return model.with_vector(free.full(np.clip(moved, *bounds)))


def highest(fit: Fit) -> float:
    """What the cost is at most: an H-infinity norm is known between the grid's and a bound."""
    return fit.certificate.upper_bound if fit.method == "match hinf" else fit.cost


def run(estimator, model: Model, data: object) -> tuple[dict[str, object], Fit]:
    """One estimate: where it ended, and what its start costs."""
    begin = time.process_time()
    fit = best(lambda: estimator.fit(model, data))
    seconds = time.process_time() - begin
    first, *others = model.parameter_names()
    value = getattr(model, first)
    narrow = {first: (value, value + MOVED * (1 + abs(value)))}
    given = best(
        lambda: estimator.fit(model, data, fixed=others, bounds=narrow, near=lines_of(fit))
    )
    found = {
        "success": fit.success, "status": fit.status, "cost": fit.cost, "seconds": seconds,
        "start": highest(given), "sound": given.success, "vector": fit.model.vector().tolist(),
        "ways": min((row.J for row in getattr(fit.notes, "starts", ())), default=None),
    }  # fmt: skip
    return found, fit


def lines_of(fit: Fit) -> Fit | None:
    """The fit whose spectra judge its start; only the frequency domain has them."""
    return fit if getattr(fit.notes, "spectra", ()) else None


def worse(row: dict, than: float | None) -> float:
    """By how much an end is worse than a cost, in what counts as nothing."""
    if than is None or not np.isfinite(than):
        return -np.inf
    likelihood = "output error" in row["key"]
    return (row["cost"] - than) / (LIKELY if likelihood else WORSE * abs(than))


def estimate(
    done: dict[str, dict], case: Case, name: str, starts: int, seed: int
) -> Iterator[dict]:
    """From the guess, from its result and from random starts, what is not yet ``done``."""
    key = f"{case.name} | {type(case.start).__name__} | {name}"
    names = [f"{key} | {k}" for k in ("guess", "result", *range(starts))]
    if all(each in done for each in names):
        return
    data, estimator = data_of(case, name), ESTIMATORS[name]
    if isinstance(estimator, Match):
        estimator = estimator.prepared(case.start, data)
    for each, k in zip(names, (None, None, *range(starts)), strict=True):
        if each in done:
            continue
        start = case.start if k is None else random_start(case.start, seed, k)
        if each.endswith("result"):
            start = start.with_vector(np.array(done[names[0]]["vector"]))
        try:
            yield {"key": each} | run(estimator, start, data)[0]
        except (ValueError, ArithmeticError) as error:  # refused, with a reason
            yield {"key": each, "refused": str(error)}


def show(done: dict[str, dict]) -> None:
    """A row for every estimator: how its fits to all helicopters and structures ended."""
    cases: dict[str, list[dict]] = {}
    for key, row in done.items():
        cases.setdefault(key.rpartition(" | ")[0], []).append(row)
    rows = []
    for name in ESTIMATORS:
        own = [found for key, found in cases.items() if key.endswith(f" | {name}")]
        if own:
            rows.append((name, len(own), *np.sum([counted(found) for found in own], axis=0)))
    print(table(HEADER, [(name, *map(str, counts)) for name, *counts in rows]))


HEADER = (
    "estimator", "cases", "fits", "refused", "converged", "as good as the case's best",
    "worse than the start", "worse than a way tried", "not converged, and worse",
)  # fmt: skip


def counted(found: list[dict]) -> tuple[int, ...]:
    """Of the fits of one case, as the header says."""
    ended = [row for row in found if "cost" in row]
    good = [row for row in ended if row["success"]]
    least = min((row["cost"] for row in good), default=np.nan)
    sound = [row for row in ended if row["sound"]]  # whose start is one
    beyond = {row["key"] for row in sound if worse(row, row["start"]) > 1}
    return (
        len(found), len(found) - len(ended), len(good),
        sum(worse(row, least) <= ALIKE for row in good),
        sum(row["key"] in beyond for row in good),
        sum(worse(row, row["ways"]) > 1 for row in good),
        len(beyond) - sum(row["key"] in beyond for row in good),
    )  # fmt: skip


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--kept", type=Path, default=Path("endings.jsonl"))
    parser.add_argument("--only", default="", help="words that a case must have")
    asked = parser.parse_args()
    lines = asked.kept.read_text().splitlines() if asked.kept.exists() else []
    done = {row["key"]: row for row in map(json.loads, lines)}
    for structure in STRUCTURES:
        for helicopter in HELICOPTERS:
            words = f"{helicopter} {structure.__name__}"
            names = [
                name for name in ESTIMATORS
                if all(word in f"{words} {name}" for word in asked.only.split())
            ]  # fmt: skip
            case = Case(helicopter, structure, asked.data, asked.seed) if names else None
            for name in names:
                for row in estimate(done, case, name, asked.starts, asked.seed):
                    done[row["key"]] = row
                    with asked.kept.open("a") as file:
                        file.write(json.dumps(row) + "\n")
    show(done)


if __name__ == "__main__":
    main()
