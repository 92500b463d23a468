"""Four measured systems of the DaISy database: simulation of the last third, against other tools.

    python -m benchmarks.daisy [FOLDER] [--only NAME ...] [--peers METHOD ...] [--log FILE]

FOLDER (or CASID_DAISY) holds CD_player_arm.dat, robot_arm.dat, flutter.dat and steamgen.dat. The
data are free for research, not to be redistributed: B. De Moor, P. De Gersem, B. De Schutter,
W. Favoreel, "DAISY: a database for identification of systems", Journal A 38 (1997) 4-5;
homes.esat.kuleuven.be/~smc/daisy.

casid is called without options and chooses everything from the first two thirds by itself. Every
other method chooses its order from the same grid, which ends where the windows of 20 samples do. It
is chosen on the first two thirds: their second half is cut into six stretches, each simulated by
the model of all that is before it, as the last third is by the model of both thirds, and the six
are judged as one. A sweep visits every frequency once; no stretch is far from what was learnt. A
package with several methods may choose one of them likewise: the row `sippy_unipi`.

VAF: mean over outputs of the variance accounted for, %. Where orders are chosen, simulations start
with the record, from the initial state of least squares over what the model was identified from, so
that nothing is fitted to a stretch. The last third is simulated from the initial state of least
squares over the whole of it.

Sums of errors are kept in the log as they come, and a run that finds them there goes on.
"""

import argparse
import os
import time
import warnings
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy.signal import cont2discrete

from benchmarks import peers
from benchmarks.tables import table
from casid import Record, StateSpace, pbsid
from casid.textfile import read_json, write_json

ORDERS = (*range(1, 11), *range(12, 21, 2))
HORIZON = 20
STRETCHES = 6
CHOICES = {"sippy_unipi": [method for method in peers.METHODS if method != "nfoursid"]}
DATA = {  # name: file, columns of inputs, of outputs
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


def error_sums(system, u, y, learnt=None):
    """Σe and Σe² (2, ny) of a simulation from its best initial state.

    With ``learnt`` that state is the best of so many samples, and the sums those after them.
    """
    known, shown = slice(0, learnt), slice(learnt, None)
    free = simulate(system, u)
    basis = np.empty((len(u), y.shape[1], system.nx))
    X = np.eye(system.nx)
    for k in range(len(u)):
        basis[k] = system.C @ X
        X = system.A @ X
    if not (np.isfinite(free).all() and np.isfinite(basis).all()):
        return np.full((2, y.shape[1]), np.inf)
    left = y - free
    columns = basis[known].reshape(-1, system.nx)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    x0 = np.linalg.lstsq(columns / size, left[known].ravel(), rcond=1e-12)[0] / size
    e = left[shown] - basis[shown] @ x0
    return np.array([e.sum(axis=0), (e**2).sum(axis=0)])


def vaf(sums, y):
    """Mean VAF [%] over outputs y (N, ny) of errors with these sums (2, ny)."""
    mean, square = sums / len(y)
    if not np.isfinite(square).all():
        return -np.inf
    return float(100 * np.mean(1 - (square - mean**2) / y.var(axis=0)))


def simulate(system, u):
    x, out = np.zeros(system.nx), np.empty((len(u), system.ny))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, now in enumerate(u):
            out[k] = system.C @ x + system.D @ now
            x = system.A @ x + system.B @ now
    return out


def ours(u, y):
    """The discrete model of the automatic black box, what was chosen, and the seconds it took."""
    t = np.arange(len(u), dtype=float)
    inputs = [f"u{i}" for i in range(u.shape[1])]
    outputs = [f"y{i}" for i in range(y.shape[1])]
    begin = time.perf_counter()
    box = pbsid(Record(t, u, y, inputs, outputs, "daisy", "zoh"))
    seconds = time.perf_counter() - begin
    found = box.system
    if found.dt is None:
        found = StateSpace(*cont2discrete((found.A, found.B, found.C, found.D), 1.0)[:4], 1.0)
    kind = "projections" if box.transform == "laguerre" else f"samples, {box.refinement}"
    return found, f"{box.order} ({kind})", seconds


class Log:
    """Seconds and sums of errors by data, method, samples learnt from and order, in a file.

    Results of other versions of the peers stay there and are not taken.
    """

    def __init__(self, path):
        self._path = path
        self._content = read_json(path) if path.exists() else {}

    def _key(self, data, method, learnt):
        return f"{data}, {learnt} samples, {method} of {' '.join(peers.PACKAGES)}"

    def __contains__(self, what):
        return self._key(*what) in self._content

    def write(self, data, method, learnt, found):
        self._content[self._key(data, method, learnt)] = found
        write_json(self._path, self._content)

    def stage(self, data, methods, learnt):
        """Seconds and sums by (method, order) of what was identified from so many samples."""
        return {
            (method, int(order)): (seconds, np.array(sums, dtype=float))
            for method in methods
            for order, (seconds, sums) in self._content[self._key(data, method, learnt)].items()
        }


def compare(u, y, name, methods, log):
    """Rows of method, order, VAF where it was chosen and of the last third, seconds."""
    third = len(u) // 3
    both = slice(0, 2 * third)
    u, y = ((v - v[both].mean(axis=0)) / v[both].std(axis=0) for v in (u, y))
    edges = np.linspace(third, 2 * third, STRETCHES + 1).astype(int).tolist()
    stretches = list(zip(edges, [*edges[1:], len(u)], strict=True))
    for end, after in track(stretches, name, transient=True):
        for method, models in identified(u[:end], y[:end], name, methods, log):
            found = {}
            for order, model in models.items():
                if after == len(u):
                    sums = error_sums(model.system, u[end:], y[end:])
                else:
                    sums = error_sums(model.system, u[:after], y[:after], learnt=end)
                found[str(order)] = [model.seconds, sums.tolist()]
            log.write(name, method, end, found)
    chosen_on, rest = y[edges[0] : edges[-1]], y[edges[-1] :]
    stages = [log.stage(name, methods, end) for end in edges]
    usable = set.intersection(*(set(stage) for stage in stages))
    scores = {key: vaf(sum(stage[key][1] for stage in stages[:-1]), chosen_on) for key in usable}
    rows = []
    own = {method: [method] for method in methods}
    for label, group in {**own, **CHOICES}.items():
        best = max((key for key in sorted(usable) if key[0] in group), key=scores.get, default=None)
        if best is not None:
            seconds, sums = stages[-1][best]
            chosen = f"{best[1]}" if group == [label] else f"{best[1]} ({best[0]})"
            values = (f"{v:.5g}" for v in (scores[best], vaf(sums, rest)))
            rows.append([label, chosen, *values, seconds])
    system, chosen, seconds = ours(u[both], y[both])
    final = vaf(error_sums(system, u[2 * third :], y[2 * third :]), rest)
    return [*rows, ["casid", chosen, "-", f"{final:.5g}", seconds]]


def identified(u, y, name, methods, log):
    """(method, models by order) of every method that is not in the log."""
    missing = [method for method in methods if (name, method, len(u)) not in log]
    if missing:
        models = peers.identify(u, y, ORDERS, horizon=HORIZON, feedthrough=True, methods=missing)
        for method in missing:
            yield method, {order: model for (of, order), model in models.items() if of == method}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=os.environ.get("CASID_DAISY"))
    parser.add_argument("--only", nargs="+", choices=list(DATA), default=list(DATA))
    parser.add_argument("--peers", nargs="+", choices=peers.METHODS, default=peers.METHODS)
    parser.add_argument("--log", type=Path, default=Path("out/daisy.json"))
    options = parser.parse_args()
    if options.folder is None:
        parser.error("name the folder of the data, or set CASID_DAISY")
    options.log.parent.mkdir(parents=True, exist_ok=True)
    log = Log(options.log)
    for name in options.only:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            data = load(Path(options.folder), name)
            rows = compare(*data, name, options.peers, log)
        print(f"\n{name}\n")
        print(table(["method", "order", "choice [%]", "VAF [%]", "time [s]"], rows), flush=True)


if __name__ == "__main__":
    main()
