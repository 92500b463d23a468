"""What Dask's workers cost beside bare processes that do the same refits.

Refits of the four 3-2-1-1 records of the UH-60 (64 parameters) go to as many Dask workers and to as
many processes of `concurrent.futures`, in turns; both are started and have imported casid before.
Seconds are those of the processor, of the caller, the scheduler and all workers, and by the clock.
Dask's own profiler, which stops every worker a hundred times a second, is off unless asked for.

    OMP_NUM_THREADS=1 python -m benchmarks.dask [REFITS] [--workers 8] [--turns 3] [--profiler]
"""

import argparse
import multiprocessing
import os
import time
import warnings
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack

import dask
import numpy as np
import psutil
from distributed import Client, LocalCluster

from benchmarks import output_error as race
from benchmarks.tables import table
from casid import Execution, OutputError, bootstrap
from casid.threads import one_thread


def spent() -> dict[int, float]:
    """Processor seconds so far of this process and of all it has started, by their numbers."""
    own = psutil.Process()
    return {each.pid: sum(each.cpu_times()[:2]) for each in (own, *own.children(recursive=True))}


@one_thread
def compare(refits: int, workers: int, turns: int, profiler: bool) -> str:
    """Table of seconds, the least of several turns, and what Dask takes beside bare processes."""
    dask.config.set({"distributed.worker.profile.enabled": profiler})  # workers inherit it
    records = race.noisy_records()[:4]
    estimator = OutputError(interval=2.0)
    fit = estimator.fit(race.start_of(race.noisy_records()), records)
    found: dict[str, list[tuple[float, float]]] = {"Dask": [], "bare processes": []}
    values = {}
    with ExitStack() as stack:
        cluster = stack.enter_context(
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        )
        client = stack.enter_context(Client(cluster))
        context = multiprocessing.get_context("spawn")
        bare = stack.enter_context(ProcessPoolExecutor(workers, mp_context=context))
        executors: dict[str, Executor] = {"Dask": client.get_executor(), "bare processes": bare}

        def run(name: str, runs: int, seed: int) -> None:
            values[name] = bootstrap(
                fit, records, runs=runs, seed=seed, estimator=estimator,
                execution=Execution(executor=executors[name]),
            ).values  # fmt: skip

        for name in executors:
            run(name, 2 * workers, 0)  # every process imports casid
        for seed in range(1, turns + 1):
            for name, seconds in found.items():
                before, begin = spent(), time.perf_counter()
                run(name, refits, seed)
                wall, after = time.perf_counter() - begin, spent()
                cpu = sum(after[pid] - before.get(pid, 0.0) for pid in after)
                seconds.append((cpu, wall))
            np.testing.assert_array_equal(values["Dask"], values["bare processes"])
    least = {name: np.min(seconds, axis=0) for name, seconds in found.items()}
    more = [100 * (least["Dask"] / least["bare processes"] - 1)]
    rows = [(name, *each, *each / refits) for name, each in least.items()]
    rows.append(("Dask takes more [%]", *more[0], "", ""))
    header = (
        "",
        "processor [s]",
        "by the clock [s]",
        "processor, a refit [s]",
        "clock, a refit [s]",
    )
    return f"load {os.getloadavg()[0]:.0f}, {refits} refits\n" + table(header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("refits", nargs="?", type=int, default=48)
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--profiler", action="store_true")
    chosen = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask's own, about ports and closing loops
        print(compare(chosen.refits, chosen.workers, chosen.turns, chosen.profiler))


if __name__ == "__main__":
    main()
