"""Four measured systems of the DaISy database: simulation of the last third, against other tools.

    python benchmarks/daisy.py [FOLDER] [--only NAME ...] [--peers METHOD ...] [--ours METHOD ...]

FOLDER (or CASID_DAISY) holds CD_player_arm.dat, robot_arm.dat, flutter.dat and steamgen.dat. The
data are free for research, not to be redistributed: B. De Moor, P. De Gersem, B. De Schutter,
W. Favoreel, "DAISY: a database for identification of systems", Journal A 38 (1997) 4-5;
homes.esat.kuleuven.be/~smc/daisy.

Every method may choose its order from the same grid, by simulating the last third of the first two
thirds with the model of the rest of them; then it is identified from both. A package with several
methods may choose one of them likewise, beside its order: that is the row of `sippy_unipi` and the
row "casid", chosen from its four refinements. The initial state of a simulation is that of least
squares over all of it, for every method. VAF: mean over outputs of the variance accounted for, %.
"""

import argparse
import os
import time
import warnings
from pathlib import Path

import numpy as np
import peers
from tables import table

from casid import Record, pbsid

ORDERS = range(1, 11)
HORIZON = 20
REFINEMENTS = {
    "casid, unrefined": {"refine": False},
    "casid, prediction": {},
    "casid, simulation": {"refine": "simulation"},
    "casid, local": {"refine": "simulation", "noise": "local"},
}
CHOICES = {  # package: its methods
    "sippy_unipi": [method for method in peers.METHODS if method != "nfoursid"],
    "casid": list(REFINEMENTS),
}
DATA = {  # name: file, columns of inputs, of outputs, direct term
    "CD player arm": ("CD_player_arm.dat", (0, 1), (2, 3)),
    "robot arm": ("robot_arm.dat", (0,), (1,)),
    "flutter": ("flutter.dat", (0,), (1,)),
    "steam generator": ("steamgen.dat", (1, 2, 3, 4), (5, 6, 7, 8)),
}


def load(folder, name):
    """Inputs and outputs of one system, unit sampling interval."""
    file, iu, iy = DATA[name]
    values = np.loadtxt(folder / file)
    return values[:, list(iu)], values[:, list(iy)]


def vaf(system, u, y):
    """Mean VAF [%] over outputs of a simulation from its best initial state."""
    free = simulate(system, u)
    if not np.isfinite(free).all():
        return -np.inf
    basis = np.empty((len(u), y.shape[1], system.nx))
    X = np.eye(system.nx)
    for k in range(len(u)):
        basis[k] = system.C @ X
        X = system.A @ X
    basis = basis.reshape(-1, system.nx)
    if not np.isfinite(basis).all():
        return -np.inf
    left = (y - free).ravel()
    size = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    x0 = np.linalg.lstsq(basis / size, left, rcond=1e-12)[0]
    e = (left - basis / size @ x0).reshape(y.shape)
    return float(100 * np.mean(1 - e.var(axis=0) / y.var(axis=0)))


def simulate(system, u):
    x, out = np.zeros(system.nx), np.empty((len(u), system.ny))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, now in enumerate(u):
            out[k] = system.C @ x + system.D @ now
            x = system.A @ x + system.B @ now
    return out


def ours(u, y, orders, **options):
    """Models by order, and the seconds each took."""
    t = np.arange(len(u), dtype=float)
    inputs = [f"u{i}" for i in range(u.shape[1])]
    outputs = [f"y{i}" for i in range(y.shape[1])]
    record = Record(t, u, y, inputs, outputs, "daisy", "zoh")
    models = {}
    for order in orders:
        begin = time.perf_counter()
        try:
            box = pbsid([record], order=order, past=HORIZON, transform="none", **options)
        except (ValueError, np.linalg.LinAlgError) as error:
            print(f"    order {order}: {error}")
            continue
        models[order] = peers.PeerModel(box.system, time.perf_counter() - begin)
    return models


def everybody(u, y, orders, methods, refinements):
    """Models of all methods by (method, order)."""
    models = peers.identify(u, y, orders, horizon=HORIZON, feedthrough=True, methods=methods)
    for name in refinements:
        for order, model in ours(u, y, orders, **REFINEMENTS[name]).items():
            models[name, order] = model
    return models


def compare(u, y, methods, refinements):
    """Rows of method, order, VAF where it was chosen and of the last third, seconds."""
    third = len(u) // 3
    learn, rest = slice(0, 2 * third), slice(2 * third, None)
    mu, my = u[learn].mean(axis=0), y[learn].mean(axis=0)
    su, sy = u[learn].std(axis=0), y[learn].std(axis=0)
    u, y = (u - mu) / su, (y - my) / sy
    first, check = slice(0, 4 * third // 3), slice(4 * third // 3, 2 * third)
    tried = everybody(u[first], y[first], ORDERS, methods, refinements)
    score = {key: vaf(model.system, u[check], y[check]) for key, model in tried.items()}
    final = everybody(u[learn], y[learn], ORDERS, methods, refinements)
    rows = []
    own = {method: [method] for method in dict.fromkeys(key[0] for key in tried)}
    for label, group in {**own, **CHOICES}.items():
        best = max((key for key in score if key[0] in group), key=score.get, default=None)
        if best in final:
            chosen = f"{best[1]}" if group == [label] else f"{best[1]} ({best[0]})"
            values = (score[best], vaf(final[best].system, u[rest], y[rest]))
            rows.append([label, chosen, *(f"{v:.5g}" for v in values), final[best].seconds])
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=os.environ.get("CASID_DAISY"))
    parser.add_argument("--only", nargs="+", choices=list(DATA), default=list(DATA))
    parser.add_argument("--peers", nargs="+", choices=peers.METHODS, default=peers.METHODS)
    parser.add_argument("--ours", nargs="+", choices=list(REFINEMENTS), default=list(REFINEMENTS))
    options = parser.parse_args()
    folder = options.folder
    if folder is None:
        parser.error("name the folder of the data, or set CASID_DAISY")
    for name in options.only:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows = compare(*load(Path(folder), name), options.peers, options.ours)
        print(f"\n{name}\n")
        print(table(["method", "order", "choice [%]", "VAF [%]", "time [s]"], rows), flush=True)


if __name__ == "__main__":
    main()
