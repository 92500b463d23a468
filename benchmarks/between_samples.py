"""An unstable helicopter flown in closed loop through brute force, estimated many times.

Flights are integrated on a grid of a twentieth of a sample, by no code of casid: seven parameters,
sticks with edges of one sample. Whole delays are held: the likelihood has a kink or a jump there.

    python -m benchmarks.between_samples [N] [CASE]  every hold, direct term and delay, N runs (100)
    python -m benchmarks.between_samples bo105 [N]   64 parameters, 2.25 samples late, N runs (40)

CASE, as "zoh yes 2.25", has the words of a row's first columns; "0-100" for N are certain runs.
"""

import argparse
import itertools
import sys
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from benchmarks import bo105
from benchmarks.tables import cell, table
from casid import Record, output_error
from tests.truths.brute_force import PARTS
from tests.truths.closed_roll import Roll

H = 0.04  # s
SIGMA = np.array([0.05, 0.005, 0.005])  # m/s^2, rad/s, rad; of v in place of ay m/s
X0, BIAS = np.array([0.3, -0.02, 0.01]), np.array([0.1, 0.01, -0.02])
BOUNDS = {"tau": (0.0, 0.5)}
DELAYS = (0.0, 0.3, 1.0, 2.25, 6.5)  # samples


class Smooth(Roll):
    """The same, its first output without direct term: lateral velocity."""

    outputs = ("v", "p", "phi")

    def C(self):
        return [[1, 0, 0], [0, 1, 0], [0, 0, 1]]

    def D(self):
        return [[0, 0], [0, 0], [0, 0]]


def fine_map(system):
    """Step of a part of a sample from (state, input, its rate)."""
    nx, nu = system.B.shape
    M = np.zeros((nx + 2 * nu, nx + 2 * nu))
    M[:nx, :nx], M[:nx, nx : nx + nu], M[nx : nx + nu, nx + nu :] = system.A, system.B, np.eye(nu)
    return expm(M * H / PARTS)[:nx]


def flight(model, hold, delay, rng, N=300):
    """One record: sharp random steps of both sticks, bank and rate fed back as measured.

    The lateral stick is heard ``delay`` samples late; the loop is integrated on a grid that holds
    the delay. Every edge of a stick is one sample wide.
    """
    plant, late = model.system(), round(delay * PARTS)
    E, x, felt, keep = fine_map(plant), X0, 0.0, np.exp(-H / 0.1)
    levels = rng.choice([-0.1, 0.0, 0.1], size=(N // 15 + 2, 2)).repeat(15, axis=0)[:N]
    levels[:25] = 0.0
    u, y = np.zeros((N + 1, 2)), np.empty((N, 3))
    fine = np.zeros(((N + 1) * PARTS + 1, 2))  # the sticks as flown, at every part's begin
    for k in range(N):
        heard = max(k * PARTS - late, 0)
        now = fine[[heard, k * PARTS], [0, 1]]
        y[k] = plant.C @ x + plant.D @ now + BIAS + SIGMA * rng.standard_normal(3)
        felt = keep * felt + (1 - keep) * (0.03 * y[k, 2] + 0.01 * y[k, 1])
        u[k + 1] = levels[min(k + 1, N - 1)] - [felt, 0.0]
        share = np.arange(PARTS + 1)[:, None] / PARTS * (hold == "foh")
        fine[k * PARTS : (k + 1) * PARTS + 1] = u[k] + share * (u[k + 1] - u[k])
        for part in range(k * PARTS, (k + 1) * PARTS):
            first = max(part - late, 0)
            begin = np.array([fine[first, 0], fine[part, 1]])
            rate = (hold == "foh") * np.array(
                [(fine[first + 1, 0] - begin[0]) * (part >= late), fine[part + 1, 1] - begin[1]]
            )
            x = E @ np.concatenate([x, begin, rate * PARTS / H])
        fine[(k + 1) * PARTS] = u[k + 1]
    t = H * np.arange(N)
    return Record(t, u[:N], y, model.inputs, model.outputs, hold=hold)


def estimate(hold, direct, delay, run, records=2):
    """(fit, truth) of a run; a delay at a whole number of samples is held."""
    truth = (Roll if direct else Smooth)(tau=delay * H)
    rng = np.random.default_rng([16, run, round(100 * delay), direct, hold == "foh"])
    flown = [flight(truth, hold, delay, rng) for _ in range(records)]
    fixed = ("tau",) if delay == int(delay) else ()
    return output_error(truth, flown, fixed=fixed, bounds=BOUNDS), truth


def campaign_run(hold, direct, delay, run):
    """Errors of the free parameters, their bounds of Cramér and Rao, and the standard errors."""
    fit, truth = estimate(hold, direct, delay, run)
    rows = [row for row in fit.parameters if row.name in fit.free_names]
    errors = [row.value - getattr(truth, row.name) for row in rows]
    return errors, [row.cramer_rao for row in rows], [row.std_error for row in rows]


def print_campaigns(runs, words=()):
    """A row for every hold, direct term and delay of these words."""
    rows = []
    for hold, direct, delay in itertools.product(("foh", "zoh"), (True, False), DELAYS):
        case = (hold, "yes" if direct else "no", f"{delay:g}")
        if set(words) <= set(case):
            found = [campaign_run(hold, direct, delay, run) for run in runs]
            rows.append((*case, *figures(*np.moveaxis(found, 1, 0))))
            print(*map(cell, rows[-1]), file=sys.stderr, flush=True)
    print(table(("between samples", "direct term", "delay, samples", *FIGURES), rows))


# ---- 64 parameters ------------------------------------------------------------------------------


def late_bo105(delay=2.25, N=500):
    """The Bo105's eight 3-2-1-1 in closed loop, all sticks late, integrated on the fine grid."""
    truth = replace(bo105.truth(), **dict.fromkeys(TAUS, delay * H))
    return truth, [
        late_record(truth, bo105.reference(stick, sign, H, N), round(delay * PARTS), name)
        for stick in truth.inputs for sign, name in ((1, f"{stick}+"), (-1, f"{stick}-"))
    ]  # fmt: skip


TAUS = ("tau_col", "tau_lat", "tau_lon", "tau_ped")


def late_record(model, reference, late, name):
    """One record; the sticks follow reference (N, 4) less the feedback by a lag of 60 ms."""
    plant, gain, keep = model.system(), bo105.feedback(), np.exp(-H / 0.06)
    E, (N, nu) = fine_map(plant), reference.shape
    x, u, y = np.zeros(plant.nx), np.zeros((N + 1, nu)), np.empty((N, plant.ny))
    fine = np.zeros(((N + 1) * PARTS + 1, nu))
    for k in range(N):
        y[k] = plant.C @ x + plant.D @ fine[max(k * PARTS - late, 0)]
        u[k + 1] = keep * u[k] + (1 - keep) * (reference[k] - gain @ y[k])
        share = np.arange(PARTS + 1)[:, None] / PARTS
        fine[k * PARTS : (k + 1) * PARTS + 1] = u[k] + share * (u[k + 1] - u[k])
        for part in range(k * PARTS - late, (k + 1) * PARTS - late):  # at rest before the record
            begin, end = fine[max(part, 0)], fine[max(part + 1, 0)]
            x = E @ np.concatenate([x, begin, (end - begin) * PARTS / H])
    return Record(H * np.arange(N), u[:N], y, model.inputs, model.outputs, name)


def late_estimates(runs):
    """As `campaign_run`, of all runs; nothing but delays is bounded."""
    truth, clean = late_bo105()
    free = {name: (-1e3, 1e3) for name in truth.parameter_names() if name not in TAUS}
    found = []
    for run in range(runs):
        rng = np.random.default_rng([225, run])
        records = [record.with_noise(bo105.NOISE, rng) for record in clean]
        fit = output_error(truth, records, interval=1.0, bounds=free)
        white, std = ([getattr(row, name) for row in fit.parameters] for name in STD)
        found.append((fit.model.vector() - truth.vector(), white, std))
        print(run, fit.iterations, file=sys.stderr, flush=True)
    return np.moveaxis(found, 1, 0)


STD = ("cramer_rao", "std_error")
FIGURES = (
    "RMSE / Cramér-Rao, mean", "expected scatter of it", "largest mean error, σ",
    "95 % intervals by Cramér-Rao cover, %",
)  # fmt: skip


def figures(errors, bounds, _):
    """Cells of a table, of errors (runs, parameters) and their Cramér-Rao bounds."""
    unit = np.sqrt(np.mean(bounds**2, axis=0))
    ratios = np.sqrt(np.mean(errors**2, axis=0)) / unit
    # The relative scatter of a mean square over n runs is √(2/n); two correlate as ρ².
    alike = np.mean(np.corrcoef(errors.T) ** 2)
    expected = np.sqrt(alike / (2 * len(errors)))
    covered = 100 * np.mean(np.abs(errors) < 1.96 * bounds)
    return ratios.mean(), expected, np.abs(errors.mean(axis=0) / unit).max(), covered


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", default="100", help="N, first-last, or bo105")
    parser.add_argument("words", nargs="*", help="of a case, or the runs of bo105")
    options = parser.parse_args()
    if options.runs == "bo105":
        found = late_estimates(int((options.words or [40])[0]))
        print(table(("runs", *FIGURES), [(f"{found.shape[1]}", *figures(*found))]))
    else:
        first, _, last = options.runs.rpartition("-")
        print_campaigns(range(int(first or 0), int(last)), options.words)


if __name__ == "__main__":
    main()
