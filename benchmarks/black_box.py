"""Accuracy of the black box on the UH-60, settings chosen from data, against three references.

    python -m benchmarks.black_box [--seeds 1 2 3] [--json FILE]

Error figures as `uh60.errors`, in %, mean over the noise seeds.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.tables import against, table
from benchmarks.uh60 import (
    OMEGA,
    ORACLE_DELAY,
    STEPS,
    SWEEPS,
    best_linear_approximation,
    errors,
    linear_records,
    nonlinear_records,
    oracle,
)
from casid import pbsid

TARGETS = {  # % median, % on axis
    ("linear", "32-state model", "all eight"): (2.0, 1.0),
    ("linear", "32-state model", "3-2-1-1"): (5.0, np.inf),
    ("nonlinear", "best linear approximation", "all eight"): (5.0, 2.8),
    ("nonlinear", "best linear approximation", "3-2-1-1"): (10.0, np.inf),
    ("nonlinear", "32-state model", "all eight"): (9.5, 4.0),
    ("nonlinear", "32-state model", "3-2-1-1"): (13.0, np.inf),
}
CAMPAIGNS = {"all eight": STEPS + SWEEPS, "3-2-1-1": STEPS}
PAIR = 0.25  # of |λ|: how far the unstable pair may be from the oracle's


def references(source):
    """Responses at OMEGA the estimates from these records are held against."""
    if source == "linear":
        return {"32-state model": oracle().response(OMEGA)}
    return {
        "best linear approximation": best_linear_approximation(),
        "32-state model": oracle(ORACLE_DELAY).response(OMEGA),
    }


def unstable_pair_error(system):
    """Distance of the black box's pole nearest the oracle's unstable pair, relative to it."""
    wanted = oracle().poles()[0]
    return float(np.min(np.abs(system.poles() - wanted)) / abs(wanted))


def run(source, names, seed):
    """One identification: error figures by reference, pair error, seconds, settings."""
    make = linear_records if source == "linear" else nonlinear_records
    records = make(names, seed)
    begin = time.perf_counter()
    box = pbsid(records, feedthrough=["ax", "ay", "az"])
    seconds = time.perf_counter() - begin
    G = box.system.response(OMEGA)
    found = {name: errors(G, truth, records) for name, truth in references(source).items()}
    chosen = f"{box.order}/{box.past}/{box.pole:g}/{box.regularisation:g}"
    return found, unstable_pair_error(box.system), seconds, chosen


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows, figures = [], {}
    for source in ("linear", "nonlinear"):
        for campaign, names in CAMPAIGNS.items():
            runs = [run(source, names, seed) for seed in options.seeds]
            pair = max(each[1] for each in runs)
            settings = ", ".join(each[3] for each in runs)
            for reference in runs[0][0]:
                e, on_axis = 100 * np.mean([each[0][reference] for each in runs], axis=0)
                limits = TARGETS[source, reference, campaign]
                figures[f"{source}, {campaign}, {reference}"] = [e, on_axis]
                rows.append(
                    [
                        source, campaign, reference, against(e, limits[0]),
                        against(on_axis, limits[1]) if np.isfinite(limits[1]) else on_axis,
                        against(pair, PAIR), max(each[2] for each in runs), settings,
                    ]
                )  # fmt: skip
    header = ["records", "campaign", "reference", "e [%]", "on axis [%]", "pair [of its modulus]",
              "time [s]", "order/past/pole/regularisation"]  # fmt: skip
    print(table(header, rows))
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
