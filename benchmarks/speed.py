"""What casid's computations cost, each beside its limit and its peer.

    python -m benchmarks.speed [NAME ...]    measure all or some, write the page's table
    python -m benchmarks.speed --list        names
    python -m benchmarks.speed --stages      seconds by the clock of each stage of the UH-60 study
    python -m benchmarks.speed --ratios      what is checked with every change, half a minute

Every figure is taken in a process of its own and kept in benchmarks/data/speed.json with its day,
so that some may be measured anew; the table is made of all that are kept. Seconds are those of the
processor, of all processes together. Ratios compare processor times within one process; the command
fails when one of them is not kept.
"""

import argparse
import datetime as dt
import json
import operator
import os
import pickle
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import scipy

from benchmarks import load, matching
from benchmarks import output_error as race
from benchmarks.tables import table
from casid import Execution, OutputError, Record, StateSpace, bootstrap, excitation, match, pbsid
from casid.bounds.trials import Fits
from casid.jobs.campaigns import Job, run_jobs
from casid.shooting.convolution import Convolution, convolved
from casid.threads import one_thread
from models.six_dof import SixDof

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "benchmarks" / "data" / "speed.json"
PAGE = ROOT / "docs" / "benchmarks-speed.md"
TABLE = re.compile(r"^\| what \| figure .*\n(?:\|.*\n)+", re.MULTILINE)
REFITS, AT_ONCE = 20, 4  # measured, of the thousand that are stated; few enough for one process
LAZY = ("interpolate", "ndimage", "optimize", "signal", "sparse", "stats")  # parts of SciPy


def spent() -> float:
    """Processor seconds of this process and of those it has waited for."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


def timed(function: Callable[[], object]) -> float:
    """Processor seconds of a call."""
    for part in LAZY:
        getattr(scipy, part)  # imported when first used, which is no part of a computation
    begin = spent()
    function()
    return spent() - begin


def command(*arguments: str) -> float:
    """Processor seconds of a command of Python's."""
    return timed(
        lambda: subprocess.run(
            [sys.executable, *arguments], check=True, cwd=ROOT, stdout=subprocess.DEVNULL
        )
    )


def uh60() -> tuple[object, list[Record]]:
    """The structure where output error starts, and the eight noisy records."""
    records = race.noisy_records()
    return race.start_of(records), records


def small_match() -> float:
    model, box, bounds = matching.helicopters()["UH-60"]
    omega = np.geomspace(*box.band, 40)
    return timed(lambda: match(model, box, bounds=bounds, omega=omega))


def large_match() -> float:
    ring = matching.Ring(10, 4, 8)
    omega = np.geomspace(0.1, 20.0, 100)
    return timed(lambda: match(ring.model, ring.truth, omega=omega))


def given_black_box() -> float:
    given = {"order": 18, "pole": 10.0, "past": 10, "future": 10}
    records = race.noisy_records()
    return timed(lambda: pbsid(records, feedthrough=["ax", "ay", "az"], **given))


def wide(outputs: int, samples: int) -> Record:
    """Five modes from four inputs, seen by many noisy outputs."""
    rng, t = np.random.default_rng(0), 0.02 * np.arange(samples)
    omega = 0.5 * 1.5 ** np.arange(5)
    A = np.kron(np.diag(omega), [[-0.3, 1.0], [-1.0, -0.3]])
    B, C = rng.standard_normal((10, 4)), rng.standard_normal((outputs, 10))
    system = StateSpace(A, B, C, np.zeros((outputs, 4)))
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], size=(-(-samples // 40), 4)), 40, axis=0)[:samples]
    y = system.simulate(t, u)
    y += 0.03 * y.std(axis=0) * rng.standard_normal(y.shape)
    return Record(t, u, y, system.inputs, system.outputs, "wide")


def wide_black_box() -> float:
    record = wide(30, 10_000)
    return timed(lambda: pbsid(record))


def long_black_box() -> float:
    flights = load.records(1_000_000, None)
    return timed(lambda: load.STAGES["pbsid"](flights))


@one_thread
def textbook_ratio() -> float:
    model, records = uh60()
    options = race.SolverOptions(ipopt=race.IPOPT)
    _, (ours, theirs) = race.compare(model, records[:4], race.R_TRUE, 2.0, options, ["map"])
    return float(theirs[2] / ours[2])


def long_output_error() -> float:
    flights = load.records(1_000_000, 5_000)
    return timed(lambda: load.STAGES["output_error"](flights))


def refits() -> float:
    """Minutes on two processors of a thousand."""
    model, records = uh60()
    estimator = OutputError(interval=2.0)
    fit = estimator.fit(model, records[:4])
    # Others would import the package first, which of a thousand refits is next to nothing.
    seconds = sum(
        timed(partial(bootstrap, fit, records[:4], runs=AT_ONCE, seed=seed, estimator=estimator))
        for seed in range(REFITS // AT_ONCE)
    )
    return seconds / REFITS * 1000 / 2 / 60


def cases() -> float:
    printed = subprocess.run(
        [sys.executable, "benchmarks/bounds.py"],
        check=True,
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
    ).stdout
    line = next(each for each in printed.splitlines() if "processor time" in each)
    return float(line.split(":")[-1].removesuffix("x"))


def kept_study() -> float:
    with tempfile.TemporaryDirectory() as folder:
        run = ["-m", "casid", "identify", "examples/uh60/study.toml", "--output", folder]
        command(*run)
        return command(*run)


STAGES = {  # limits [s] of what stages take together
    ("records",): None,
    ("kinematics",): None,
    ("pbsid",): 1.0,
    ("frequency",): None,
    ("quadratic", "hinf"): 2.5,
    ("output_error",): 0.6,
    ("checked", "sufficiency", "validation", "states"): None,
    ("derivid",): 1.0,
    ("report",): 2.5,
}


def identified(processors: set[int]) -> tuple[str, float, float]:
    """What a study of which nothing is kept prints, its seconds by the clock and of processors."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, processors)  # of what is started, too
    try:
        with tempfile.TemporaryDirectory() as folder:
            run = [sys.executable, "-m", "casid", "identify", "examples/uh60/study.toml"]
            begin, used = time.perf_counter(), spent()
            done = subprocess.run(
                [*run, "-o", folder], check=True, cwd=ROOT, text=True, stdout=subprocess.PIPE
            )
            return done.stdout, time.perf_counter() - begin, spent() - used
    finally:
        os.sched_setaffinity(0, before)


def stages() -> str:
    """Table of a study's seconds by the clock: each stage alone on one processor, all on two."""
    every = sorted(os.sched_getaffinity(0))
    said, alone, _ = identified({every[0]})
    _, whole, cpu = identified({*every[:2]})
    words = [line.split() for line in said.partition("total")[0].splitlines()[1:]]
    took = {name: float(seconds) for name, *_, seconds in words}
    rows = [
        (", ".join(names), sum(took[name] for name in names), "" if most is None else f"≤ {most:g}")
        for names, most in STAGES.items()
    ]
    rows += [("all, with imports", alone, ""), ("all, on two processors", whole, "≤ 9")]
    rows += [("the same, seconds of the processor", cpu, "")]
    load = os.getloadavg()[0]
    return f"load {load:.0f}\n" + table(("stage", "seconds", "limit"), rows)


def task_bytes() -> float:
    """kB that one refit of the eight UH-60 records is handed."""
    model, records = uh60()
    fits = Fits(model, records, OutputError(), (), None, Execution())
    return len(pickle.dumps(fits.job(fits.cases({"free": {}})[0]))) / 1000


def task_seconds() -> float:
    """ms of the calling process for one job that does nothing, kept on disk, of 200."""
    jobs = [Job(name=f"job {k}", key="0", payload=None) for k in range(200)]
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        run_jobs(operator.is_, jobs, Execution(folder=folder))
        return 1000 * (time.process_time() - begin) / len(jobs)


def flops(programme: race.Programme, shared: Convolution) -> tuple[float, float]:
    """Floating-point operations a sample and iteration needs: of sensitivities, of signals."""
    e = programme.evaluator
    p = e.nf + e.nx + e.ny  # columns: parameters, the interval's node, biases
    carried, seen = 2 * e.nx**2 * (e.nf + e.nx), 2 * e.ny * e.nx * (e.nf + e.nx)
    driven = 2 * e.nx * (e.nx + 2 * e.layout.records[0].nu) * e.nf
    own = carried + seen + driven + e.ny * (p + 1) ** 2  # a Gram matrix has two equal halves
    return own, 2 * shared.filtered + shared.count**2


@one_thread
def times_the_bound(
    flown: Callable[[], tuple[SixDof, list[Record]]],
    interval: float,
    tries: int = 5,
    *,
    fewest: bool = False,
) -> float:
    """Time of output error over that of its operations at the rate of a matrix product.

    Operations are those of one sensitivity a parameter, or the ``fewest`` known, of shared signals.

    Evaluations are one an iteration and one at the start; what line searches and second derivatives
    add to them is in the time alone. Operations are those where the solve ends: a guess may have
    fewer signals. Time and rate are the best of several.
    """
    model, records = flown()
    given = records, race.R_TRUE, interval, race.SolverOptions(ipopt=race.IPOPT, max_iterations=8)
    runs = [race.timed_casid(model, *given) for _ in range(tries)]
    seconds = min(whole - built for *_, built, whole in runs)
    programme, _, solution, *_ = runs[0]
    sweep = programme.blocks(solution.x).sweep
    shared = convolved(sweep)
    assert shared is not None
    ways = flops(programme, shared)
    square = np.random.default_rng(0).standard_normal((800, 800))
    rate = 2 * 800**3 / best(lambda: square @ square, 5 * tries)
    work = sum(record.N for record in records) * (solution.iterations + 1)
    print("operations a sample, of sensitivities and of signals:", *ways, file=sys.stderr)
    print("solve [s], iterations:", seconds, solution.iterations, file=sys.stderr)
    times = [seconds * rate / (each * work) for each in ways]
    print("times the operations of sensitivities, of signals:", *times, file=sys.stderr)
    return times[fewest]


def four_records() -> tuple[SixDof, list[Record]]:
    return SixDof(), race.noisy_records()[:4]


def eight_records() -> tuple[SixDof, list[Record]]:
    return SixDof(), race.noisy_records()


def million_samples() -> tuple[SixDof, list[Record]]:
    return load.START, load.records(1_000_000, 5_000)


# Name: what it is, its limit, the peer, how it is measured. A limit below zero is a least value.
FIGURES: dict[str, tuple[str, float, str, Callable[[], float]]] = {
    "import": ("`import casid` [s]", 0.5, "", lambda: command("-c", "import casid")),
    "help": ("`casid --help` [s]", 0.4, "", lambda: command("-m", "casid", "--help")),
    "match": (
        "H∞ match, 64 parameters, 40 frequencies, with certificate [s]",
        2.0,
        "states as variables: 4.8",
        small_match,
    ),
    "match-120": (
        "H∞ match, 120 parameters, 100 frequencies [s]",
        6.0,
        "states as variables: 12.7",
        large_match,
    ),
    "black-box": ("black box, eight UH-60 records, settings given [s]", 1.0, "", given_black_box),
    "wide": ("black box, 30 outputs, 10 000 samples, automatic [s]", 60.0, "", wide_black_box),
    "long": ("black box, 10⁶ samples of 12 channels [s]", 20.0, "", long_black_box),
    "textbook": (
        "output error, times as fast as the textbook's, 64 parameters",
        -100.0,
        "textbook: 1",
        textbook_ratio,
    ),
    **{
        name + kind: (what.format(of), 4.0, "", partial(times_the_bound, *how, fewest=bool(kind)))
        for kind, of in (("", "operations of its sensitivities"), ("-fewest", "fewest operations"))
        for name, what, how in (
            ("bound", "output error, times the {}, 3200 samples", (four_records, 2.0)),
            ("bound-eight", "the same, 17 200 samples", (eight_records, 2.0)),
            ("bound-million", "the same, 10⁶ samples", (million_samples, 5.0, 1)),
        )
    },
    "million": ("output error, 10⁶ samples of 12 channels [s]", 60.0, "", long_output_error),
    "refits": (
        "1000 refits of the four 3-2-1-1, 64 parameters, two processors [min]",
        10.0,
        "",
        refits,
    ),
    "cases": (
        "twelve cases of bounds of all eight records, in cold fits",
        2.0,
        "one by one: 12",
        cases,
    ),
    "kept": ("`casid identify`, everything kept [s]", 1.5, "", kept_study),
    "bytes": ("one job, as it travels [kB]", np.inf, "the records: 1652", task_bytes),
    "overhead": ("one job, work of the caller [ms]", np.inf, "", task_seconds),
}


# ---- ratios -------------------------------------------------------------------------------------


def growth(work: Callable[[Record], object], samples: int) -> float:
    """Time of some work on four times as many samples."""
    short, long = wide(8, samples), wide(8, 4 * samples)
    return best(lambda: work(long)) / best(lambda: work(short))


def best(function: Callable[[], object], tries: int = 3) -> float:
    """Least processor seconds of several calls: what else the machine does only adds to them."""
    return min(timed(function) for _ in range(tries))


def growth_of_black_box() -> float:
    return growth(lambda record: pbsid(record, order=10, pole=8.0, past=8, future=8), 8_000)


def textbook_in_short() -> float:
    """How many times as long the textbook programme takes for 8 s of one manoeuvre."""
    record = race.noisy_records()[0].between(0.0, 7.99)
    options = race.SolverOptions(ipopt=race.IPOPT, max_iterations=8)  # the same work on each side
    given = [record], race.R_TRUE, 2.0, options
    programme, start, *_, ours = min(
        (race.timed_casid(SixDof(), *given) for _ in range(3)), key=operator.itemgetter(-1)
    )
    theirs = race.timed_textbook(programme, start, options, "map")[2]
    return float(theirs / ours)


# Limits lie halfway, in logarithms, between linear growth (4) and quadratic growth (16), and
# between what was measured and a programme no better than the textbook's.
RATIOS: dict[str, tuple[str, float, Callable[[], float]]] = {
    "black-box": ("black box, four times the samples", 8.0, growth_of_black_box),
    "excitation": (
        "judging the excitation, four times the samples",
        8.0,
        lambda: growth(excitation, 50_000),
    ),
    "textbook": ("output error, 8 s, times as fast as the textbook's", -2.0, textbook_in_short),
}


def within(value: float, limit: float) -> bool:
    """Whether a figure keeps its limit; one below zero is a least value."""
    return value >= -limit if limit < 0 else value <= limit


@one_thread  # threads that wait for each other cost time of the processor, too
def ratios() -> bool:
    """Measure and print the ratios of processor times; returns whether all keep their limits."""
    found = {name: measure() for name, (_, _, measure) in RATIOS.items()}
    rows = [
        (what, found[name], f"{'≥' if limit < 0 else '≤'} {abs(limit):g}")
        for name, (what, limit, _) in RATIOS.items()
    ]
    print(table(("what", "ratio", "limit"), rows))
    return all(within(found[name], limit) for name, (_, limit, _) in RATIOS.items())


# ---- page ---------------------------------------------------------------------------------------


def measured(name: str) -> float:
    """A figure, from a process of its own."""
    run = [sys.executable, "-m", "benchmarks.speed", "--one", name]
    done = subprocess.run(run, check=True, cwd=ROOT, text=True, stdout=subprocess.PIPE)
    return float(done.stdout.splitlines()[-1])


def page(kept: dict[str, dict[str, float | str]]) -> str:
    """The table of all figures that are kept."""
    rows = []
    for name, (what, limit, peer, _) in FIGURES.items():
        if name not in kept:
            continue
        value = float(kept[name]["value"])
        bound = f"{'≥' if limit < 0 else '≤'} {abs(limit):g}" if np.isfinite(limit) else ""
        holds = "" if not bound else "yes" if within(value, limit) else "no"
        rows.append((what, value, bound, holds, peer, str(kept[name]["day"])))
    return table(("what", "figure", "limit", "holds", "peer", "measured"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*FIGURES, []])
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--stages", action="store_true")
    parser.add_argument("--ratios", action="store_true")
    parser.add_argument("--one", choices=FIGURES, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(FIGURES[asked.one][3]())
        return
    if asked.ratios:
        sys.exit(0 if ratios() else "a ratio is not kept")
    if asked.stages:
        print(stages())
        return
    if asked.list:
        print("\n".join(FIGURES))
        return
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    for name in asked.names or FIGURES:
        kept[name] = {"value": measured(name), "day": f"{dt.date.today():%Y-%m-%d}"}
        print(name, kept[name]["value"], file=sys.stderr, flush=True)
        KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    print(page(kept))
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(TABLE.sub(lambda _: page(kept).strip() + "\n", text, count=1), encoding="utf-8")


if __name__ == "__main__":
    main()
