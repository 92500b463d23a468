"""Does the scatter that `derivid` states hold over seeds?

The linear truths of `benchmarks.coverage`, as the nearest six degrees of freedom without delays,
are flown through four sweeps each; `derivid` fits their 60 derivatives to the responses from the
truth. How many errors lie within 1.96 stated ones, their root mean square in these, and the share
within 1.96 times the cost's own figures √(H⁻¹), in which the noise is not. Parameters on a bound
do not count.

    OMP_NUM_THREADS=1 python -m benchmarks.scatter [MODEL] [--runs 20] [--first 0]
"""

import argparse
import json
import warnings
from pathlib import Path

import numpy as np

from benchmarks.coverage import FLOWN, OMEGA, flights, loop, truths
from benchmarks.tables import table
from benchmarks.ten_cases import TRIMS, best
from benchmarks.uh60 import INPUTS, OUTPUTS
from casid import Model, StateSpace, derivid, frequency_response, match
from models.six_dof import SixDof

DELAYS = tuple(f"tau_{axis}" for axis in INPUTS)


def nearest(plant: StateSpace, trim: dict[str, float]) -> Model:
    """Six degrees of freedom without delays, close to an aircraft."""
    start = SixDof(**trim, **dict.fromkeys(DELAYS, 0.0))
    return best(lambda: match(start, plant, norm="quadratic", omega=OMEGA, fixed=DELAYS)).model


def errors(name: str, truth: Model, run: int) -> np.ndarray:
    """Errors of one fit over stated ones and over √(H⁻¹), (2, 60)."""
    system = truth.system()
    plant = StateSpace(system.A, system.B, system.C, system.D, None, INPUTS, OUTPUTS)
    records = flights(name, loop(name, plant), np.random.default_rng([run, 71]))
    response = frequency_response(records[FLOWN["sweeps"]], omega=OMEGA)
    fit = best(lambda: derivid(truth, response, starts=2, fixed=DELAYS))
    off = fit.model.vector() - truth.vector()
    rows = [each for each in zip(off, fit.parameters, strict=True) if each[1].name not in DELAYS]
    return np.array([[e / row.std_error, e / row.cramer_rao] for e, row in rows]).T


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("aw109", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    rows = []
    for name, plant in truths(chosen.aw109).items():
        trim = TRIMS.get(name) or json.loads(chosen.aw109.read_text())["trim"]
        truth = nearest(plant, trim)
        runs = range(chosen.first, chosen.first + chosen.runs)
        z = np.array([errors(name, truth, run) for run in runs])
        held = [100 * np.mean(np.abs(each[np.isfinite(each)]) < 1.96) for each in z.swapaxes(0, 1)]
        rows.append([name, held[0], float(np.sqrt(np.nanmean(z[:, 0] ** 2))), held[1]])
    print(table(("truth", "held, %", "error / stated, rms", "held by √(H⁻¹), %"), rows))


if __name__ == "__main__":
    main()
