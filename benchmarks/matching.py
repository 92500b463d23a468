"""Matching: starts, speed, growth, and a Monte-Carlo run; prints Markdown tables.

    python -m benchmarks.matching starts [N]    against N random starts (50) on three helicopters
    python -m benchmarks.matching speed         time and growth, ways to the quadratic fit
    python -m benchmarks.matching bo105 [N]     spread and bias of λ over N noise seeds (20)

Seconds are processor time of one core: other work on the machine does not count.
"""

import argparse
import sys
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks import bo105
from benchmarks.tables import table
from casid import (
    BlackBox,
    Match,
    Model,
    SolverOptions,
    StateSpace,
    match,
    parameter,
    pbsid,
    read_csv,
)
from casid.free import Free, free_parameters
from casid.matching.comparison import Comparison
from casid.matching.descent import Condensed, descend
from casid.matching.initial import starts
from casid.matching.programme import Programme
from casid.matching.targets import comparison_of
from models.six_dof import SixDof

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
FACTOR = 3.0  # within which random starts lie of the solution
LIMITS = SolverOptions(max_iterations=200, max_seconds=120.0)


def helicopters() -> dict[str, tuple[SixDof, BlackBox, dict[str, tuple[float, float]]]]:
    """Structure with its file's guesses, black box and bounds of each."""
    found = {}
    for name, units in (("UH-60", "%"), ("AH-1S", "-")):
        folder = EXAMPLES / name.lower().replace("-", "") / "data"
        files = sorted([*folder.glob("3211_???.csv"), *folder.glob("sweep_*.csv")])
        given = {"inputs": SixDof.inputs, "units": dict.fromkeys(SixDof.inputs, units)}
        rng = np.random.default_rng(20130)
        records = [
            read_csv(file, outputs=SixDof.outputs, detrend="first", **given).with_noise(
                bo105.NOISE, rng
            )
            for file in files
        ]
        trim = ("u", "v", "w", "p", "q", "r", "phi", "theta")
        still = [read_csv(file, outputs=trim, **given).y[:100].mean(axis=0) for file in files]
        fields = ("U0", "V0", "W0", "P0", "Q0", "R0", "phi0", "theta0")
        values = dict(zip(fields, map(float, np.mean(still, axis=0)), strict=True))
        box = pbsid(records, order=18, feedthrough=["ax", "ay", "az"])
        found[name] = (SixDof(**values), box, {})
    box = pbsid(bo105.records(1), order=12, feedthrough=["ax", "ay", "az"])
    found["Bo105"] = (bo105.structure(), box, bo105.BOUNDS)
    return found


# ---- starts -------------------------------------------------------------------------------------


def compare_starts(count: int) -> None:
    """The cost from the black box alone against the best of many random starts."""
    rows = []
    for name, (model, box, bounds) in helicopters().items():
        for norm in ("quadratic", "hinf"):
            begin = time.process_time()
            estimator = Match(norm=norm).prepared(model, box, bounds=bounds)
            fit = estimator.fit(model, box, bounds=bounds)
            seconds = time.process_time() - begin
            free = free_parameters(fit.model, (), bounds)
            comparison = comparison_of(model, [box], weight=estimator.weight)
            there = comparison.sources[0].at(fit.notes.sources[0].grid)
            comparison = replace(comparison, sources=(there,))
            costs = [random_start(free, comparison, norm, seed) for seed in range(count)]
            best = min(*costs, fit.cost)
            near = sum(cost <= 1.01 * best for cost in costs)
            solved = sum(np.isfinite(costs))
            rows.append((name, norm, fit.cost, seconds, best, 100 * (fit.cost / best - 1),
                         f"{near} of {count}", f"{solved} of {count}"))  # fmt: skip
            print(*rows[-1], file=sys.stderr, flush=True)
    header = ("helicopter", "norm", "cost", "s", "best of all", "above best, %",
              "random starts within 1 %", "solved and stable")  # fmt: skip
    print(table(header, rows))


def random_start(free: Free, comparison: Comparison, norm: str, seed: int) -> float:
    """Cost reached by the programmes from within a factor of the solution."""
    rng = np.random.default_rng(seed)
    values = free.guess * FACTOR ** rng.uniform(-1, 1, len(free.index))
    values = np.clip(values, free.lower[free.index], free.upper[free.index])
    cost = np.inf
    for stage in ("quadratic", "hinf")[: 1 + (norm == "hinf")]:
        optimum = Programme(free, comparison, stage, values).solve(LIMITS, f"{stage} {seed}")
        values = optimum.values
        system = free.model.with_vector(free.full(values)).system()
        if not optimum.success or system.poles()[0].real > comparison.shift + 1e-6:
            return np.inf
        cost = optimum.cost if stage == "quadratic" else comparison.norm(system)
    return cost


# ---- speed --------------------------------------------------------------------------------------


class Ring:
    """A ring of coupled first-order states, all measured: as many parameters as wanted."""

    def __init__(self, nx: int, nu: int, reach: int) -> None:
        near = {(i, (i + k) % nx) for i in range(nx) for k in range(reach)}
        rng = np.random.default_rng(nx)
        A = np.zeros((nx, nx))
        for i, j in near:
            A[i, j] = 0.4 * rng.standard_normal()
        A -= np.diag(np.linspace(0.5, 8.0, nx))
        B = rng.standard_normal((nx, nu))
        extra = rng.standard_normal((nx, 2))
        slow = np.block([[A, extra], [np.zeros((2, nx)), -20.0 * np.eye(2)]])
        fast = np.vstack([B, rng.standard_normal((2, nu))])
        C = np.hstack([np.eye(nx), np.zeros((nx, 2))])
        self.truth = StateSpace(slow, fast, C, np.zeros((nx, nu)))
        names = self.truth.inputs, self.truth.outputs
        self.model = _ring_model(near, nx, nu, *names)


def _ring_model(near, nx, nu, inputs, outputs) -> Model:
    names = [f"a{i}_{j}" for i, j in sorted(near)] + [
        f"b{i}_{j}" for i in range(nx) for j in range(nu)
    ]
    body = {name: parameter(default=0.0, lower=-30.0, upper=30.0, unit="-", scale=1.0)
            for name in names}  # fmt: skip
    body |= {f"a{i}_{i}": parameter(default=-1.0, lower=-30.0, upper=0.0, unit="-", scale=1.0)
             for i in range(nx)}  # fmt: skip
    body |= {
        "states": outputs, "inputs": inputs, "outputs": outputs,
        "__annotations__": dict.fromkeys(names, float), "__module__": __name__,
        "A": lambda self: [[getattr(self, f"a{i}_{j}") if (i, j) in near else 0.0
                            for j in range(nx)] for i in range(nx)],
        "B": lambda self: [[getattr(self, f"b{i}_{j}") for j in range(nu)] for i in range(nx)],
    }  # fmt: skip
    return type("RingModel", (Model,), body)()


def timed(model: Model, target: BlackBox | StateSpace, norm: str, omega: np.ndarray) -> tuple:
    """Seconds, iterations and cost of a whole match."""
    begin = time.process_time()
    fit = match(model, target, norm=norm, omega=omega)
    return time.process_time() - begin, fit.iterations, fit.cost


def measure_speed() -> None:
    """Whole matches; then the ways to the quadratic fit from the same guess."""
    heli, box, _ = helicopters()["UH-60"]
    small, large = Ring(10, 4, 8), Ring(12, 4, 8)
    rows = []
    for label, model, target, points, band in (
        ("UH-60, 64 parameters, 40 frequencies", heli, box, 40, box.band),
        ("UH-60, 64 parameters, 80 frequencies", heli, box, 80, box.band),
        ("ring of 10, 120 parameters, 40 frequencies", small.model, small.truth, 40, (0.1, 20.0)),
        ("ring of 10, 120 parameters, 100 frequencies", small.model, small.truth, 100, (0.1, 20.0)),
        ("ring of 12, 144 parameters, 100 frequencies", large.model, large.truth, 100, (0.1, 20.0)),
    ):
        for norm in ("quadratic", "hinf"):
            rows.append((label, norm, *timed(model, target, norm, np.geomspace(*band, points))))
            print(*rows[-1], file=sys.stderr, flush=True)
    print(table(("match", "norm", "s", "iterations", "cost"), rows))
    compare_ways(heli, box)


def compare_ways(model: Model, box: BlackBox) -> None:
    """The programme, and the descent that starts a match, from one guess."""
    free = free_parameters(model)
    comparison = comparison_of(model, [box], omega=np.geomspace(*box.band, 40))
    rows = []
    begin = time.process_time()
    found = Programme(free, comparison, "quadratic", free.guess).solve(LIMITS, "programme")
    rows.append(("IPOPT, exact Hessian", time.process_time() - begin,
                 found.iterations, found.cost))  # fmt: skip
    problem = Condensed.of(free, comparison)
    begin = time.process_time()
    down = descend(problem, free.guess, steps=100, tolerance=1e-6)
    rows.append(("Levenberg-Marquardt on the line itself", time.process_time() - begin,
                 "-", down.cost))  # fmt: skip
    begin = time.process_time()
    best = starts(Condensed.of(free, comparison, guarded=True), large=True)[0]
    rows.append(("Levenberg-Marquardt from the right", time.process_time() - begin,
                 "-", best.cost))  # fmt: skip
    print()
    print(table(("quadratic fit from the guess, UH-60", "s", "iterations", "cost"), rows))


# ---- Monte Carlo --------------------------------------------------------------------------------


WAYS = tuple(product((np.inf, 12.0), ("quadratic", "hinf")))  # up to [rad/s], norm


def spread(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Truth (64,) and estimates (4, count, 64) of the matches of every way."""
    found = np.empty((len(WAYS), count, 64))
    for seed in range(count):
        box = pbsid(bo105.records(100 + seed), order=12, feedthrough=["ax", "ay", "az"])
        for k, (highest, norm) in enumerate(WAYS):
            omega = np.geomspace(box.band[0], min(box.band[1], highest), 40)
            fit = match(bo105.structure(), box, norm=norm, omega=omega, bounds=bo105.BOUNDS)
            found[k, seed] = fit.model.vector()
    return bo105.truth().vector(), found


def monte_carlo(count: int) -> None:
    """How far the estimates lie from the truth in units of their own spread."""
    truth, found = spread(count)
    rows = []
    for k, (highest, norm) in enumerate(WAYS):
        sigma = found[k].std(axis=0, ddof=1)
        each = np.abs(found[k] - truth) / sigma
        mean = np.abs(found[k].mean(axis=0) - truth) / sigma
        worst = SixDof.parameter_names()[int(np.argmax(mean))]
        relative = np.median(sigma / np.maximum(abs(truth), 1e-3))
        rows.append(("its band" if np.isinf(highest) else highest, norm,
                     f"{(mean <= 3).sum()} of 64", mean.max(), worst, 100 * (each <= 3).mean(),
                     relative))  # fmt: skip
    header = ("up to [rad/s]", "norm", "mean within 3 sigma", "farthest mean, sigma", "of",
              "single runs within 3 sigma, %", "median relative sigma")  # fmt: skip
    print(table(header, rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="?", default="speed", choices=("starts", "speed", "bo105"))
    parser.add_argument("number", nargs="?", type=int, help="of starts, or of seeds")
    options = parser.parse_args()
    if options.what == "starts":
        compare_starts(options.number or 50)
    elif options.what == "bo105":
        monte_carlo(options.number or 20)
    else:
        measure_speed()
