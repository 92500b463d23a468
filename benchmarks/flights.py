"""What lost samples, gaps, rates and outliers cost: estimates from spoiled UH-60 records.

All eight records with noise are spoiled and estimated from as they are; errors are medians of
e(ω), those of a linear model of the noise-free records being the truth (`benchmarks.uh60`), and
stand beside those of the same records whole. Means over the seeds.

Beside each stands the floor: by how much fewer samples of the same noise raise the error that an
unbiased estimate has at least, the Cramér-Rao bound of a black box of this order (at the one of the
noise-free records, of their lines below the slowest channels' Nyquist frequency) and of output
error's parameters, the stated error of a frequency response. What is possible for these very
records, model error and all, the black box's last table tells: the maximum likelihood from the
model of the noise-free records, which nobody has, and the black box of whole records with noise
that much denser, which has to read nothing between samples.

Output error is that of the lateral structure on the two lateral 3-2-1-1, of which the estimates'
largest change is printed too, in standard errors.

Run: python -m benchmarks.flights [estimator [seeds [first seed]]]      (estimator: response,
black-box, output-error, or all; a minute or two each)
"""

import argparse
import warnings
from dataclasses import replace
from functools import cache, partial

import numpy as np

from benchmarks.tables import against, table
from benchmarks.uh60 import (
    INPUTS,
    NOISE,
    OMEGA,
    OUTPUTS,
    STEPS,
    SWEEPS,
    best_linear_approximation,
    errors,
    linear_records,
    nonlinear_records,
    oracle,
)
from casid import frequency_response, outliers, output_error, pbsid
from casid.records import standard_deviations
from casid.subspace import modal as modes
from casid.subspace.campaign import Campaign
from casid.subspace.fourier import Spectrum
from casid.subspace.likelihood import parts
from casid.subspace.pooled_spectra import alike
from casid.subspace.refinement import refine
from casid.subspace.settings import HIGHEST
from casid.subspace.slopes import normal_equations, response_derivative
from models.lateral_directional import LateralDirectional

RATES = dict.fromkeys(("ax", "ay", "az"), 2) | dict.fromkeys(("phi", "theta"), 4)  # every n-th
DROPOUT = 7.0, 12.0  # s
FAR = 20.0  # of the noise, an outlier
BLACK_BOX = {
    "order": 18, "pole": 10.0, "past": 10, "future": 10, "feedthrough": ["ax", "ay", "az"]
}  # fmt: skip
SLOWEST = 39.0  # rad/s, the Nyquist frequency of the attitudes
START = LateralDirectional(U0=40.9)


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


def dropped(record, rng):  # noqa: ARG001 - as the others
    """Rows missing for 5 s, against the flight cut in two."""
    return record.take((record.t <= DROPOUT[0]) | (record.t > DROPOUT[1]))


SPOILED = {  # limit on the error, in that of the whole records
    bursts: 1.15, scattered: 1.25, rates: 1.1, gappy: 1.2, spiked: 1.1, masked: 1.02,
}  # fmt: skip


def response(records):
    """Response, points that count and the stated error of each pair."""
    found = frequency_response(records, omega=OMEGA)
    return found.G, found.coherence >= 0.6, found.error


def black_box(records):
    found = pbsid(records, **BLACK_BOX)
    return found.continuous().system.response(OMEGA), None, least(records)


@cache
def noise_free():
    """The noise-free records, their lines, and the black box of them in modal form."""
    flown = Campaign.of(nonlinear_records(SWEEPS + STEPS), BLACK_BOX["feedthrough"])
    system = pbsid(flown.records, **BLACK_BOX).continuous().system
    lines = flown.spectra(BLACK_BOX["pole"], SLOWEST)
    return flown, lines, modes.to_modal(system, flown.su, flown.sy, flown.mask)


def least(records):
    """Root mean square of e(ω) that an unbiased black box has at least, (K,)."""
    flown, data, modal = noise_free()
    noise, free = np.array([NOISE[name] for name in OUTPUTS]) / flown.sy, np.argwhere(flown.mask)
    weights = [
        np.tile(np.sqrt(np.isfinite(record.y).mean(axis=0) / record.dt) / noise, (len(s.omega), 1))
        for s, record in zip(data, records, strict=True)
    ]
    H, _ = normal_equations(modal, parts(modal, alike(data, weights)), free)
    unit = partial(Spectrum, OMEGA, Y=np.zeros((len(OMEGA), len(OUTPUTS))), h=None, hold="foh")
    G, dG = response_derivative(modal, free, unit, len(OMEGA))
    off = np.einsum("koip,pr->koir", dG, modes.covariance_factor(H, modal) / np.sqrt(2))
    return np.linalg.norm(off.reshape(len(G), -1), axis=1) / np.linalg.norm(G, axis=(1, 2))


def lateral(records, start=START):
    """Output error of the lateral structure, sticks as fractions of full travel."""
    channels = {"inputs": start.inputs, "outputs": start.outputs}
    flown = [r.select(**channels) for r in records if r.name in ("3211_lat", "3211_ped")]
    return output_error(start, [replace(r, u=r.u / 100) for r in flown])


ESTIMATORS = {"response": response, "black-box": black_box}


def error(found, truth, records):
    """Median error over frequencies; of a response where it is coherent, pair by pair."""
    G, seen, _ = found
    if seen is None:
        return errors(G, truth, records)[0]
    return float(np.median(np.abs(G / truth - 1)[seen]))


def covered(found, truth):
    """Share of points whose error is within two stated ones, of a complex normal one."""
    G, seen, stated = found
    if seen is None:
        return np.nan
    return float(np.mean((np.abs(G / truth - 1) < np.sqrt(-2 * np.log(0.05)) * stated)[seen]))


def size(found):
    """Median stated error."""
    _, seen, stated = found
    return float(np.median(stated if seen is None else stated[seen]))


def noisier(records, density, seed):
    """Whole records with noise of so many times the density: what is known from fewer samples."""
    rng = np.random.default_rng([seed, 6])
    more = {name: NOISE[name] * np.sqrt(density(name) - 1) for name in OUTPUTS}
    return [record.with_noise(more, rng) for record in records]


def likeliest(records):
    """The maximum of the likelihood next to the model of the noise-free records."""
    flown, _, modal = noise_free()
    start = modes.from_modal(modal, flown.su, flown.sy, oracle())
    seen = Campaign.of(records, BLACK_BOX["feedthrough"])
    data = seen.spectra(BLACK_BOX["pole"], HIGHEST * BLACK_BOX["pole"])
    found, _ = refine(start, data, seen.su, seen.sy, seen.mask, BLACK_BOX["pole"])
    return found.response(OMEGA), None, None


def bound(seeds, truth):
    """Errors of black boxes beside what is possible, in those of the whole records."""
    densities = {scattered: lambda _: 1.25, rates: lambda name: RATES.get(name, 1)}
    found = {}
    for seed in seeds:
        whole = nonlinear_records(SWEEPS + STEPS, seed)
        for how in (None, *densities):
            spoiled = done(how, whole, seed)
            for estimate in (black_box, likeliest):
                found.setdefault((how, estimate), []).append(error(estimate(spoiled), truth, whole))
            if how:
                denser = error(black_box(noisier(whole, densities[how], seed)), truth, whole)
                found.setdefault((how, noisier), []).append(denser)
    base, best = (np.array(found[None, estimate]) for estimate in (black_box, likeliest))
    lines = [["nothing: error [%]", *(f"{100 * np.mean(e):.2f}" for e in (base, best)), ""]]
    for how in densities:
        pairs = ((black_box, base), (likeliest, best), (noisier, base))
        lines.append([told(how), *(ratio(np.array(found[how, of]), e) for of, e in pairs)])
    heading = ["error, in that of the whole ones", "black box",
               "maximum likelihood from the noise-free model", "whole, noise as dense"]  # fmt: skip
    print("\n" + table(heading, lines), flush=True)


def ratio(errors, base):
    """Ratio of means and its standard error, in words."""
    mean = errors.mean() / base.mean()
    off = (errors - mean * base) / base.mean()
    return f"{mean:.3f} ± {off.std() / max(len(off) - 1, 1) ** 0.5:.3f}"


def compared(name, estimate, seeds, truth, flown=nonlinear_records):
    """Errors of a response or a black box, of all that is done to records."""
    rows = {how: [] for how in (None, *SPOILED)}
    for seed in seeds:
        whole = flown(SWEEPS + STEPS, seed)
        for how, row in rows.items():
            found = estimate(done(how, whole, seed))
            row.append([error(found, truth, whole), size(found), covered(found, truth)])
    mean = {how: np.mean(row, axis=0) for how, row in rows.items()}
    base, floor, held = mean[None]
    print(f"\n{name}: {100 * base:.2f} % from the whole records, floor {100 * floor:.2f} %")
    lines = [["Nothing", "1", 1.0, held]] + [
        [told(how), against(mean[how][0] / base, limit), mean[how][1] / floor, mean[how][2]]
        for how, limit in SPOILED.items()
    ]
    heading = ["records", "error, in that of the whole ones", "floor", "covered"]
    print(table(heading, lines), flush=True)


def refined(seeds, truth):
    """Errors and changes of output error of the lateral structure."""
    rows = {how: [] for how in (*SPOILED, dropped)}
    places = np.ix_(
        [OUTPUTS.index(n) for n in START.outputs], [INPUTS.index(n) for n in START.inputs]
    )
    for seed in seeds:
        whole = nonlinear_records(STEPS, seed)
        base = lateral(whole)
        apart = [
            piece for r in whole for piece in (r.cut(0, DROPOUT[0]), r.cut(DROPOUT[1] + 0.001, 99))
        ]
        parts = lateral(apart, base.model)
        for how, row in rows.items():
            fit = lateral(done(how, whole, seed), base.model)
            to = parts if how is dropped else base
            change = [abs(fit[n].value - to[n].value) / to[n].std_error for n in base.free_names]
            e = [misfit(each.model, truth[:, *places], whole) for each in (fit, to)]
            floor = [fit[n].cramer_rao / to[n].cramer_rao for n in base.free_names]
            row.append([e[0] / e[1], np.nanmedian(floor), np.nanmax(change)])
    whole_error = 100 * misfit(base.model, truth[:, *places], whole)
    print(f"\noutput error: {whole_error:.2f} % from the whole records")
    lines = [[told(how), *map(float, np.mean(row, axis=0))] for how, row in rows.items()]
    heading = ["records", "error, in that of the whole ones", "floor", "largest change [σ]"]
    print(table(heading, lines), flush=True)


def misfit(model, truth, records):
    """Median of e(ω) of the lateral structure."""
    channels = {"inputs": START.inputs, "outputs": START.outputs}
    su, sy = standard_deviations([record.select(**channels) for record in records])
    G, unit = model.system().response(OMEGA) / 100, su / sy[:, None]
    off, size = (np.linalg.norm(each * unit, axis=(1, 2)) for each in (G - truth, truth))
    return float(np.median(off / size))


def done(how, records, seed):
    """Records with something done to them."""
    rng = np.random.default_rng([seed, 5])
    return records if how is None else [how(each, rng) for each in records]


def told(how):
    """What a function does, from its docstring."""
    return how.__doc__.rstrip(".")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "estimator", nargs="?", default="all", choices=(*ESTIMATORS, "output-error", "all")
    )
    parser.add_argument("seeds", nargs="?", type=int, default=2)
    parser.add_argument("first", nargs="?", type=int, default=0)
    options = parser.parse_args()
    which, seeds = options.estimator, range(options.first, options.first + options.seeds)
    truth = best_linear_approximation()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, estimate in ESTIMATORS.items():
            if which in (name, "all"):
                compared(name, estimate, seeds, truth)
        if which in ("response", "all"):
            linear = oracle().response(OMEGA)
            compared("response of the 32-state model", response, seeds, linear, linear_records)
        if which in ("black-box", "all"):
            bound(seeds, truth)
        if which in ("output-error", "all"):
            refined(seeds, truth)


if __name__ == "__main__":
    main()
