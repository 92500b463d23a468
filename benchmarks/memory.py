"""Time and memory of the black box against the number of samples.

    python -m benchmarks.memory

First all eight UH-60 records with past = future = 12 (order 18, pole 8 rad/s), with and without the
refinement. Then one record of 12 channels (4 inputs, 8 outputs) at 50 Hz, 10⁴, 10⁵ and 10⁶ samples,
each identified in a process of its own: time of `pbsid`, and the largest resident memory of the
process less what it held before (the record itself included).
"""

import resource
import subprocess
import sys
import time

import numpy as np

from benchmarks.tables import against, table
from benchmarks.uh60 import INPUTS, ORACLE_DELAY, OUTPUTS, STEPS, SWEEPS, nonlinear_records, oracle
from casid import Record, pbsid
from casid.linear import foh_step

SETTINGS = {"order": 18, "past": 12, "future": 12, "pole": 8.0, "regularisation": 1e-3,
            "feedthrough": ["ax", "ay", "az"]}  # fmt: skip
SAMPLES = (10_000, 100_000, 1_000_000)
GIB = 1024**2  # KiB, the unit of ru_maxrss


def stable_system():
    """The UH-60 oracle moved left until it is stable; any system of this size would do."""
    plant = oracle(ORACLE_DELAY)
    return plant.A - 0.3 * np.eye(plant.nx), plant


def long_record(N):
    """One record of N samples under random steps and noise."""
    A, plant = stable_system()
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(N)
    u = np.repeat(rng.standard_normal((-(-N // 25), 4)), 25, axis=0)[:N]
    step, B0, B1 = foh_step(A, plant.B, 0.02)
    x, y = np.zeros(plant.nx), np.empty((N, 8))
    for k in range(N):
        y[k] = plant.C @ x + plant.D @ u[k]
        x = step @ x + B0 @ u[k] + B1 @ u[min(k + 1, N - 1)]
    y += 0.05 * y.std(axis=0) * rng.standard_normal(y.shape)
    return Record(t, u, y, INPUTS, OUTPUTS, f"{N} samples")


def measure(N, refine):
    """Seconds and GiB of one identification in this process."""
    record = long_record(N)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.perf_counter()
    pbsid([record], **SETTINGS, refine=refine)
    seconds = time.perf_counter() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return seconds, (peak - before) / GIB, peak / GIB


def main():
    if len(sys.argv) == 3:
        print(*measure(int(sys.argv[1]), sys.argv[2] == "refined"))
        return
    records = nonlinear_records(STEPS + SWEEPS, seed=1)
    rows = []
    for refine in (False, True):
        begin, cpu = time.perf_counter(), time.process_time()
        pbsid(records, **SETTINGS, refine=refine)
        wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
        rows.append(["yes" if refine else "no", wall, against(cpu, 2.0)])
    print(f"{sum(r.N for r in records)} samples of the UH-60, past = future = 12\n")
    print(table(["refined", "time [s]", "CPU [s]"], rows))
    rows = []
    for refined in ("unrefined", "refined"):
        last = np.nan
        for N in SAMPLES:
            command = [sys.executable, "-m", "benchmarks.memory", str(N), refined]
            answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            seconds, more, peak = map(float, answer.split())
            rows.append([refined, f"{N:.0e}", seconds, f"{seconds / last:.1f}" if last > 0 else "-",
                         more, against(peak, 2.0)])  # fmt: skip
            last = seconds
    print()
    print(table(["black box", "samples", "time [s]", "times the last", "added [GiB]",
                 "whole process [GiB]"], rows))  # fmt: skip


if __name__ == "__main__":
    main()
