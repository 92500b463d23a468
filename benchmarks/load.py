"""How time and memory grow with the samples: 12 channels, up to a million samples.

Every stage runs in a process of its own, whose peak memory is read at its end; the records (six
degrees of freedom, four controls, eight outputs, 50 Hz, noise of 2 % of each output) are simulated
first, and what the process held by then is part of its peak. "Growth" is the exponent p of
time ~ samples^p between the two largest sizes. Run with one BLAS thread:

    OMP_NUM_THREADS=1 python -m benchmarks.load
"""

import argparse
import json
import logging
import resource
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.tables import against, table
from casid import Record, frequency_response, output_error, pbsid
from casid.commands.inspection import inspect_records
from models.six_dof import SixDof

SIZES = (100_000, 300_000, 1_000_000)
LAYOUTS = {"one record": None, "records of 100 s": 5_000}  # samples in each
DT = 0.02  # s
HOLD = 50  # samples between steps of a control
NOISE = 0.02  # of each output's standard deviation
OMEGA = np.geomspace(0.5, 12.0, 40)
MEMORY, GROWTH = 4.0, 1.2  # GiB; exponent that still counts as linear: caches, busy machines

STABLE = replace(
    SixDof(), Xu=-0.05, Yv=-0.15, Zw=-0.6, Lv=-0.03, Lp=-3.0, Mu=0.01, Mq=-2.0, Nv=0.03, Nr=-0.8,
    Xlon=-3.0, Ylat=3.0, Zcol=-60.0, Llat=8.0, Mlon=4.0, Nped=4.0, Nlat=0.3, Mcol=0.5,
)  # fmt: skip


def record(samples, seed, name="flight"):
    """One simulated flight with random steps of all controls."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([-0.02, 0.0, 0.02], size=(-(-samples // HOLD), 4))
    u = np.repeat(levels, HOLD, axis=0)[:samples]
    t = DT * np.arange(samples)
    y = STABLE.system().simulate(t, u)
    y += NOISE * y.std(axis=0) * rng.standard_normal(y.shape)
    return Record(t, u, y, STABLE.inputs, STABLE.outputs, name)


def records(samples, each):
    """Flights that hold so many samples in all."""
    if each is None:
        return [record(samples, 0)]
    return [record(each, k, f"flight {k}") for k in range(samples // each)]


START = replace(STABLE, Lp=-2.5, Mq=-1.7, Llat=7.0)

STAGES = {
    "inspect": lambda flights: inspect_records(flights, model=STABLE),
    "pbsid": lambda flights: pbsid(flights, order=12, pole=8.0, past=10, future=10),
    "frequency_response": lambda flights: frequency_response(flights, omega=OMEGA),
    "output_error": lambda flights: output_error(START, flights, interval=5.0),
}


def measure(stage, samples, layout):
    """Seconds and peak memory [GiB] of one stage, in this process."""
    flights = records(samples, LAYOUTS[layout])
    begin = time.process_time()
    STAGES[stage](flights)
    seconds = time.process_time() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {"seconds": seconds, "peak": peak}


def child(stage, samples, layout):
    """Run `measure` in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.load", "--stage", stage, "--layout", layout]
    done = subprocess.run(
        [*command, "--samples", str(samples)], check=True, text=True, stdout=subprocess.PIPE
    )
    return json.loads(done.stdout)


def growth(sizes, found):
    """Exponent of time against samples over the two largest sizes."""
    (n0, n1), (s0, s1) = sizes[-2:], [each["seconds"] for each in found[-2:]]
    return np.log(s1 / s0) / np.log(n1 / n0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stage", choices=STAGES)
    parser.add_argument("--layout", choices=LAYOUTS)
    parser.add_argument("--samples", type=int)
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    if asked.verbose:
        logging.basicConfig(level=logging.INFO)
    if asked.samples:
        print(json.dumps(measure(asked.stage, asked.samples, asked.layout)))
        return
    rows = []
    for layout in LAYOUTS:
        for stage in STAGES:
            found = [child(stage, samples, layout) for samples in SIZES]
            rows.append([
                stage, layout, *(each["seconds"] for each in found),
                against(growth(SIZES, found), GROWTH), against(found[-1]["peak"], MEMORY),
            ])  # fmt: skip
    sizes = [f"{samples:,} [s]".replace(",", " ") for samples in SIZES]
    print(table(["stage", "layout", *sizes, "growth", "peak at the largest [GiB]"], rows))


if __name__ == "__main__":
    main()
