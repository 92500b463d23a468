"""What lost samples, gaps, rates and outliers cost: estimates from spoiled UH-60 records.

All eight records with noise are spoiled and estimated from as they are; errors are medians of
e(ω), those of a linear model of the noise-free records being the truth (`benchmarks.uh60`), and
stand beside those of the same records whole. Means over the seeds.

Run: python -m benchmarks.flights [estimator [seeds]]      (estimator: response, black-box,
output-error, or all; some minutes each)
"""

import sys
import warnings
from dataclasses import replace

import numpy as np

from benchmarks.tables import against, table
from benchmarks.uh60 import (
    NOISE,
    OMEGA,
    OUTPUTS,
    STEPS,
    SWEEPS,
    best_linear_approximation,
    errors,
    nonlinear_records,
)
from casid import frequency_response, match, outliers, output_error, pbsid
from models.hybrid_flap import HybridFlap

RATES = dict.fromkeys(("ax", "ay", "az"), 2) | dict.fromkeys(("phi", "theta"), 4)  # every n-th
FAR = 20.0  # of the noise, an outlier
BLACK_BOX = {
    "order": 18, "pole": 10.0, "past": 10, "future": 10, "feedthrough": ["ax", "ay", "az"]
}  # fmt: skip
TRIM = {"U0": 40.922, "V0": 2.811, "W0": 2.054, "phi0": 0.0213, "theta0": 0.0531}


def bursts(record, rng):
    """Four samples of all outputs lost every 2 s, in the lateral records."""
    if not record.name.endswith("_lat"):
        return record
    k = (np.arange(record.N) + rng.integers(100)) % round(2 / record.dt)
    return record.mask(np.broadcast_to((k < 4)[:, None], record.y.shape))


def scattered(record, rng):
    """A fifth of all output samples lost at random."""
    return record.mask(rng.random(record.y.shape) < 0.2)


def rates(record, rng):
    """Rates at 50 Hz, specific forces at 25 Hz, attitudes at 12.5 Hz."""
    every = np.array([RATES.get(name, 1) for name in record.outputs])
    phase = np.array([rng.integers(n) for n in every])
    return record.mask((np.arange(record.N)[:, None] + phase) % every != 0)


def gappy(record, rng):
    """One sample in a hundred lost, and all within two gaps of 0.5 s."""
    lost = rng.random(record.y.shape) < 0.01
    for at in rng.uniform(0.2, 0.8, 2) * record.duration:
        lost |= (np.abs(record.t - record.t[0] - at) < 0.25)[:, None]
    return record.mask(lost)


def spiked(record, rng):
    """Five outliers."""
    y = record.y.copy()
    for k in rng.choice(record.N - 20, 5, replace=False) + 10:
        i = int(rng.integers(len(OUTPUTS)))
        y[k, i] += FAR * NOISE[OUTPUTS[i]] * rng.choice([-1, 1])
    return replace(record, y=y)


def masked(record, rng):
    """The same outliers, found and marked as missing."""
    spoiled = spiked(record, rng)
    return spoiled.mask(outliers(spoiled))


SPOILED = {  # limit on the error, in that of the whole records
    bursts: 1.15, scattered: 1.25, rates: 1.1, gappy: 1.2, spiked: 1.1, masked: 1.02,
}  # fmt: skip


def response(records, _):
    """Response, points that count and the stated error of each pair."""
    found = frequency_response(records, omega=OMEGA)
    return found.G, found.coherence >= 0.6, found.error


def black_box(records, _):
    found = pbsid(records, **BLACK_BOX)
    return found.continuous().system.response(OMEGA), None, None


def estimated(records, start):
    fit = output_error(start, fractions(r for r in records if r.name in STEPS), interval=1.0)
    return fit.model.system().response(OMEGA) / 100, None, None


def fractions(records):
    """Sticks from percent to fractions of full travel, as the structure has them."""
    return [replace(record, u=record.u / 100) for record in records]


ESTIMATORS = {"response": response, "black-box": black_box, "output-error": estimated}


def error(found, truth, records):
    """Median error over frequencies; of a response where it is coherent, pair by pair."""
    G, seen, _ = found
    if seen is None:
        return errors(G, truth, records)[0]
    return float(np.median(np.abs(G / truth - 1)[seen]))


def covered(found, truth):
    """Share of points whose error is within two stated ones, of a complex normal one."""
    G, seen, stated = found
    if stated is None:
        return np.nan
    return float(np.mean((np.abs(G / truth - 1) < np.sqrt(-2 * np.log(0.05)) * stated)[seen]))


def main():
    which = sys.argv[1] if sys.argv[1:] else "all"
    seeds = int(sys.argv[2]) if sys.argv[2:] else 2
    truth = best_linear_approximation()
    start = HybridFlap(**TRIM)
    if which in ("output-error", "all"):
        whole = fractions(nonlinear_records(SWEEPS + STEPS, 99))
        start = match(start, pbsid(whole, **BLACK_BOX), norm="quadratic").model
    for name, estimate in ESTIMATORS.items():
        if which not in (name, "all"):
            continue
        rows = {how: [] for how in (None, *SPOILED)}
        for seed in range(seeds):
            whole = nonlinear_records(SWEEPS + STEPS, seed)
            for how, row in rows.items():
                rng = np.random.default_rng([seed, 5])
                records = whole if how is None else [how(each, rng) for each in whole]
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    found = estimate(records, start)
                row.append(
                    [
                        error(found, truth, whole),
                        covered(found, truth) if found[2] is not None else np.nan,
                    ]
                )
        mean = {how: np.mean(row, axis=0) for how, row in rows.items()}
        base = mean[None][0]
        print(f"\n{name}: {100 * base:.2f} % from the whole records", flush=True)
        print(table(["records", "error, in that of the whole ones", "covered"], [
            [how.__doc__.rstrip("."), against(mean[how][0] / base, limit), float(mean[how][1])]
            for how, limit in SPOILED.items()
        ]))  # fmt: skip


if __name__ == "__main__":
    main()
