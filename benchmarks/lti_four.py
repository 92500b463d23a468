"""A four-state system in open and closed loop, from samples: accuracy and time against other tools.

    python -m benchmarks.lti_four

Fit, 100 (1 - ‖y - ŷ‖/‖y - mean‖) %, of a simulation of noise-free validation data, mean over both
outputs and the three seeds of each kind; for the three records of `batch`, output by output. Order,
past and future are those of the data set (4, 10, 10), D = 0 unless said. The peers' N4SID, MOESP,
CVA and `nfoursid` have no treatment of feedback. `data/README.md` says where the data come from.
"""

import time
import warnings
from pathlib import Path

import numpy as np

from benchmarks.peers import identify
from benchmarks.tables import against, table
from casid import DataWarning, Record, pbsid

DATA = Path(__file__).resolve().parent / "data" / "lti_four.npz"
CHANNELS = ("u1", "u2"), ("y1", "y2")
REPEATS = 5  # of each timing; the shortest counts
PEERS = ("N4SID", "PARSIM-K", "PARSIM-S", "PARSIM-P", "nfoursid")


def load(name):
    """One record of the data set."""
    found = np.load(DATA)
    u, y = (found[f"{letter}_{name}"].astype(float) for letter in "uy")
    return Record(np.arange(len(u), dtype=float), u, y, *CHANNELS, name, "zoh")


def fit(system):
    """Fit [%] of each output on the validation data."""
    found = np.load(DATA)
    u, y = found["uv"].astype(float), found["yv"].astype(float)
    x, out = np.zeros(system.nx), np.empty_like(y)
    for k, now in enumerate(u):
        out[k] = system.C @ x + system.D @ now
        x = system.A @ x + system.B @ now
    return 100 * (1 - np.linalg.norm(y - out, axis=0) / np.linalg.norm(y - y.mean(0), axis=0))


def ours(names, **options):
    """Black box of these records, shortest time and whether a warning was given."""
    records = [load(name) for name in names]
    seconds = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(REPEATS):
            begin = time.perf_counter()
            box = pbsid(records, order=4, past=10, transform="none", **options)
            seconds.append(time.perf_counter() - begin)
    return box.system, min(seconds), any(w.category is DataWarning for w in caught)


def main():
    rows = []
    for kind, title, limit in (("ol", "open", 97.6), ("cl", "closed", 94.4)):
        names = [f"{kind}{i}" for i in range(3)]
        for label, options in (
            ("casid", {"feedthrough": False}),
            ("casid, unrefined", {"feedthrough": False, "refine": False}),
            ("casid, D free", {"feedthrough": True}),
        ):
            runs = [ours([name], **options) for name in names]
            mean = float(np.mean([fit(run[0]) for run in runs]))
            figure = (
                against(mean, limit, above=True, digits=4) if label == "casid" else f"{mean:.2f}"
            )
            warned = "warns" if all(run[2] for run in runs) else "-"
            rows.append([title, label, figure, np.mean([run[1] for run in runs]), warned])
        data = [load(name) for name in names]
        for method in PEERS:
            found = [
                identify(r.u, r.y, [4], horizon=10, feedthrough=False, methods=[method])
                for r in data
            ]
            models = [each[method, 4] for each in found if (method, 4) in each]
            mean = f"{np.mean([fit(m.system) for m in models]):.2f}" if models else "fails"
            seconds = np.mean([m.seconds for m in models]) if models else "-"
            rows.append([title, method, mean, seconds, "-"])
    system, seconds, _ = ours(["batch0", "batch1", "batch2"], feedthrough=False)
    figures = zip(fit(system), (95.6, 96.2), strict=True)
    figure = ", ".join(against(value, limit, above=True, digits=4) for value, limit in figures)
    rows.append(["batch", "casid", figure, seconds, "-"])
    print(table(["data", "method", "fit [%]", "time [s]", "D free"], rows))


if __name__ == "__main__":
    main()
