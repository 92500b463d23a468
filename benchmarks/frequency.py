"""Frequency responses and the fit to them: accuracy and time beside SciPy's own tools.

1. Eight UH-60 records with noise, 40 frequencies, five windows, against the 32-state model of the
   same helicopter; beside it Welch's estimate with `scipy.signal.csd` from each axis's sweep alone,
   one window length, inputs taken one at a time.
   Then its errors axis by axis, from the sweeps alone.
2. Records simulated from the 32-state model itself, where the truth is known exactly: rms error in
   dB and how it compares with the stated random error.
3. `derivid` with 64 parameters from 20 starts, beside `scipy.optimize.least_squares` on the same
   residuals and Jacobian from the same kind of starts.

Run: python -m benchmarks.frequency
"""

import json
import time
import warnings
from dataclasses import replace

import numpy as np
import scipy.optimize
import scipy.signal
import scipy.special

from benchmarks.uh60 import (
    OMEGA,
    ORACLE,
    ORACLE_DELAY,
    STEPS,
    SWEEPS,
    errors,
    linear_records,
    nonlinear_records,
    oracle,
)
from casid import DataWarning, derivid, frequency_response
from casid.baseline.pairs import select
from casid.evaluation import MatrixFunction
from casid.free import free_parameters
from casid.matching.mismatch import DB, DEG, PHASE, weighted_errors
from models.six_dof import SixDof


def welch(records, omega, length=20.0):
    """H1 by SciPy, each axis from its own sweep, the other inputs ignored, (K, ny, nu)."""
    G = np.empty((len(omega), 8, 4), dtype=complex)
    for j, record in enumerate(records):
        n = round(length / record.dt)
        settings = {"fs": 1 / record.dt, "nperseg": n, "noverlap": 2 * n // 3, "nfft": 8 * n}
        f, Guu = scipy.signal.welch(record.u[:, j], **settings)
        for i in range(record.ny):
            cross = scipy.signal.csd(record.u[:, j], record.y[:, i], **settings)[1]
            G[:, i, j] = np.interp(omega, 2 * np.pi * f, cross / Guu)
    return G


def responses():
    records = nonlinear_records(SWEEPS + STEPS, seed=0)
    began = time.process_time()
    found = frequency_response(records, omega=OMEGA)
    seconds = time.process_time() - began
    truth = oracle(ORACLE_DELAY).response(OMEGA)
    own, other = (errors(G, truth, records) for G in (found.G, welch(records[:4], OMEGA)))
    print(f"eight UH-60 records with noise, 40 frequencies, {len(found.windows)} windows")
    for name, (e, axis) in (("casid", own), ("scipy, SISO", other)):
        print(f"  {name:12}  e {100 * e:5.1f} %   on axis {100 * axis:4.1f} %")
    print(f"  {seconds:.2f} s")


def on_axis():
    """Every axis from the four sweeps alone, where coherence is 0.8 or more."""
    found = frequency_response(nonlinear_records(SWEEPS, seed=0), omega=OMEGA)
    ratio = np.log(found.G / oracle(ORACLE_DELAY).response(OMEGA))
    print("| pair | points | median gain error [dB] | median phase error [deg] |")
    for output, name in (("az", "col"), ("p", "lat"), ("q", "lon"), ("r", "ped")):
        i, j = found.index(output, name)
        error = ratio[found.coherence[:, i, j] >= 0.8, i, j]
        gain, phase = (np.median(np.abs(part)) for part in (DB * error.real, DEG * error.imag))
        print(f"| {output}/{name} | {len(error)} | {gain:.2f} | {phase:.1f} |")


def linear():
    truth = oracle().response(OMEGA)
    scores, decibel, off = [], [], []
    for seed in range(5):
        found = frequency_response(linear_records(SWEEPS, seed), omega=OMEGA)
        seen = found.coherence >= 0.6
        scores.append((np.abs(found.G / truth - 1) / found.random_error)[seen])
        ratio = np.log(found.G / truth)[seen]
        decibel.append(DB * ratio.real)
        off.append(np.abs([ratio.real, ratio.imag]) / found.error[seen])
    scores = np.concatenate(scores)
    print("sweeps of the 32-state model with noise, five seeds, coherence >= 0.6")
    print(f"  rms error {np.sqrt(np.mean(np.concatenate(decibel) ** 2)):.2f} dB; error over stated")
    print(f"  random error: median {np.median(scores) / 1.177:.2f} of the expected,"
          f" {100 * np.mean(scores < 3):.1f} % within 3 (98.9 expected)")  # fmt: skip
    off = np.concatenate(off, axis=None)
    chance = scipy.special.ndtri(1 - 1 / (4 * len(off)))
    print(f"  error, of gain or phase: {100 * np.mean(off < 1.96):.1f} % within 1.96, largest "
          f"{off.max():.1f} ({chance:.1f} of so many normal numbers)")  # fmt: skip


def structure():
    """Six degrees of freedom at the trim of the oracle."""
    trim = json.loads(ORACLE.read_text())["trim_x0_ftlb"]
    U0, V0, W0 = 0.3048 * np.array(trim[:3])
    return SixDof(U0=U0, V0=V0, W0=W0, theta0=trim[7])


def fits(starts=20):
    records = [replace(record, u=record.u / 100) for record in nonlinear_records(SWEEPS, seed=0)]
    frf = frequency_response(records, omega=np.geomspace(0.4, 12, 20))
    model = structure()
    began = time.process_time()
    fit = derivid(model, frf, starts=starts)
    seconds = time.process_time() - began
    costs = np.array([row.J for row in fit.notes.starts])
    print(f"derivid, 64 parameters, {starts} starts")
    print(f"  casid         J {fit.cost:.1f}, reached from {np.sum(costs < 1.001 * fit.cost)}"
          f" starts, {seconds:.1f} s")  # fmt: skip
    free = free_parameters(model)
    target = select(model, frf)
    used, weight = target.W > 0, target.decibel_weight
    matrices = MatrixFunction(free)
    scale = free.scale[free.index]
    lower, upper = free.lower[free.index] / scale, free.upper[free.index] / scale
    root = np.sqrt(weight)

    def r(x):
        G = matrices(x * scale).response(target.s)
        return weighted_errors(np.where(np.abs(G) > 0, G, 1e-9), target.G, weight)[:, used].ravel()

    def jacobian(x):
        G, slope = matrices(x * scale).response_slopes(target.s)
        d = (slope / np.where(np.abs(G) > 0, G, 1e-9) * root)[:, used].T * scale
        return np.vstack([DB * d.real, np.sqrt(PHASE) * DEG * d.imag])

    rng = np.random.default_rng(0)
    began, ends = time.process_time(), []
    for k in range(starts):
        x = free.guess / scale + (0.5 * rng.standard_normal(len(scale)) if k else 0)
        x = np.clip(x, lower + 1e-6, upper - 1e-6)
        found = scipy.optimize.least_squares(r, x, jacobian, bounds=(lower, upper), max_nfev=200)
        ends.append(2 * found.cost)
    ends = np.array(ends)
    near, seconds = np.sum(ends < 1.001 * fit.cost), time.process_time() - began
    print(f"  least_squares J {ends.min():.1f}, casid's reached from {near}, {seconds:.1f} s")


if __name__ == "__main__":
    warnings.simplefilter("ignore", DataWarning)
    responses()
    on_axis()
    linear()
    fits()
