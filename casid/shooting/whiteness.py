"""Whether a filter's innovations are white, as they are if its model of turbulence is right.

What drives the states of a filter is taken for white noise. A gust that lasts for seconds is not,
nor is what a structure misses: the filter then calls some of the inputs' effect the air's.
Correlations of whitened innovations over the first lags tell, all outputs together,

    Q = Σ_m Σ_ab (Σ_i r̃_a(i) r̃_b(i + m))² / n_ab(m),

which is χ² of a degree of freedom a term if they are white (J. R. M. Hosking, The multivariate
portmanteau statistic, J. Am. Stat. Assoc. 75, 1980). So they do at m = 0, of pairs a < b, where one
gust drives several states that a filter takes for driven independently; and the sizes of records'
innovations, where one flew in rougher air than another that shares its process noise. Residuals of
output error may be coloured, unless inputs come to follow them: what is simulated then knows some
of the noise to come, and estimates are biased however long records are (`casid.subspace.feedback`).
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from scipy.special import chdtri

from casid.arrays import Array
from casid.display import listed
from casid.errors import warn
from casid.nonlinear.model import NonlinearModel
from casid.shooting.programme import Programme
from casid.slow_sources import repeats_told
from casid.subspace.feedback import followed

LAGS = 10  # samples
LEVEL = 1e-6  # of each test
ROUNDING = 1e-5  # of an output: a residual as small is that of the computation
UNEVEN = 2.0  # times the variance of another record's innovations

FED = "output error: residuals are correlated in time"  # how what is told of feedback begins


def whitened(programme: Programme, x: Array) -> list[Array]:
    """Residuals or innovations (N, ny) of every record, whitened, 0 where missing.

    At scaled variables x.
    """
    sweep = programme.blocks(x).sweep
    white = np.empty_like(sweep.motion.residuals)
    for kind, W in enumerate(sweep.W):
        mine = sweep.kind == kind
        white[mine] = sweep.motion.residuals[mine] @ W.T
    edges = np.cumsum([0, *(record.N for record in programme.evaluator.layout.records)])
    return [white[a:b] for a, b in pairwise(edges)]


def correlations(residuals: Sequence[Array], lags: Iterable[int] = range(1, LAGS + 1)) -> Array:
    """Correlations (lags, ny, ny) in standard deviations of those of white noise; 0 of no pairs.

    Of whitened residuals (N, ny) of every record, 0 where missing.
    """
    ny, found = residuals[0].shape[1], []
    variance = sum(np.sum(r**2, axis=0) for r in residuals)
    variance = variance / np.maximum(sum(np.sum(r != 0, axis=0) for r in residuals), 1)
    for m in lags:
        products, pairs = np.zeros((ny, ny)), np.zeros((ny, ny))
        for r in residuals:
            early, late = r[: len(r) - m], r[m:]
            products += early.T @ late
            pairs += (early != 0).T.astype(float) @ (late != 0)
        size = np.sqrt(np.maximum(pairs, 1) * np.outer(variance, variance))
        found.append(products / np.where(size > 0, size, 1.0))
    return np.array(found)


def warn_of_innovations(programme: Programme, x: Array) -> None:
    """Tell of a filter whose innovations are not what it takes them for, at scaled variables x."""
    residuals, names = whitened(programme, x), programme.free.model.outputs
    said = [
        _coloured(correlations(residuals), names),
        _together(correlations(residuals, [0])[0], names),
        _uneven(residuals, names, [record.name for record in programme.evaluator.layout.records]),
    ]
    for each in filter(None, said):
        warn(f"filter error: {each}")


def _coloured(found: Array, names: Sequence[str]) -> str:
    square = found**2
    if square.sum() < chdtri(found.size, LEVEL):
        return ""
    most = names[int(np.argmax(square.sum(axis=(0, 2)) + square.sum(axis=(0, 1))))]
    return (
        f"innovations are correlated in time ({most} most), so the noise that drives the states "
        "is not white, as is assumed: neither gusts of seconds nor what the structure misses is. "
        "Derivatives may be off by several of their standard errors: give gusts a state of their "
        "own in the structure, or add what it lacks"
    )


def _together(found: Array, names: Sequence[str]) -> str:
    """Of correlations (ny, ny) at one instant."""
    pairs = np.triu(found, 1)
    if (pairs**2).sum() < chdtri(max(pairs.size - len(pairs), 2) / 2, LEVEL):
        return ""
    a, b = (int(k) for k in np.unravel_index(np.abs(pairs).argmax(), pairs.shape))
    return (
        f"innovations of {names[a]} and {names[b]} are correlated, {found[a, b]:+.0f} standard "
        "deviations more than by chance: one gust drives several states, or one noise several "
        "outputs, but they are assumed independent. Derivatives may be off by several of their "
        'standard errors: take process_noise="gain" with R="full", or give the gust a state of '
        "its own in the structure"
    )


def _uneven(residuals: Sequence[Array], outputs: Sequence[str], records: Sequence[str]) -> str:
    """Of records, where one's innovations of an output have many times the variance of another's.

    Output by output: gusts move some of them, sensor noise is most of the others.
    """
    counts = np.array([np.sum(r != 0, axis=0) for r in residuals])
    sizes = np.array([np.sum(r**2, axis=0) for r in residuals]) / np.maximum(counts, 1)
    least = np.where(counts, sizes, np.inf).argmin(axis=0)
    most, every = sizes.argmax(axis=0), np.arange(len(outputs))
    wide = np.sqrt(2 / np.maximum(counts, 1) * chdtri(1, LEVEL / len(outputs)))
    chance = np.exp(wide[least, every] + wide[most, every])  # of a ratio
    ratio = sizes[most, every] / np.maximum(sizes[least, every], 1e-300)
    ratio[ratio <= np.maximum(UNEVEN, chance)] = 0.0
    i = int(ratio.argmax())
    if not ratio[i]:
        return ""
    return (
        f"innovations of {outputs[i]} in {records[most[i]]} have {ratio[i]:.2g} times the "
        f"variance of those in {records[least[i]]}: the air of {records[most[i]]} was rougher, "
        "or its sensors noisier, than one process noise and one R for all records can describe. "
        f"{records[least[i]]} gets too little weight and standard errors are too small: estimate "
        "records from similar air together"
    )


def warn_of_followed(programme: Programme, x: Array) -> bool:
    """Tell of coloured residuals of output error that go into inputs, at scaled variables x.

    Whether there are any.
    """
    model, records = programme.free.model, programme.evaluator.layout.records
    linear = not isinstance(model, NonlinearModel)
    direct = not linear or bool(model.system().D.any())
    now = direct or any(record.hold == "foh" for record in records)
    dt = max(record.dt for record in records)
    power = np.mean(programme.values(x).motion.residuals ** 2, axis=0)
    y = np.nan_to_num(np.concatenate([record.y for record in records]))
    residuals = [r * (power > ROUNDING**2 * np.mean(y**2, axis=0)) for r in whitened(programme, x)]
    coloured, followers = followed(residuals, [r.u for r in records], dt, now=now)
    if not followers.any() or repeats_told(records):  # held samples colour them, and are told
        return False
    outputs, inputs = (
        listed([name for name, which in zip(names, found, strict=True) if which])
        for names, found in ((model.outputs, coloured), (model.inputs, followers))
    )
    ways = "process_noise=True (filter error)"
    if linear:
        ways += ' or, if it is sensors that colour them, with domain="frequency"'
    else:
        ways += f" and {type(model).__name__}().at(trim), as a nonlinear structure has none"
    warn(
        f"{FED} ({outputs}), and later inputs ({inputs}) follow them, as where a pilot or "
        "controller reacts to gusts. Output error assumes that inputs do not depend on earlier "
        "residuals: parameters, delays above all, are biased by more than their standard errors. "
        f"Estimate with {ways}, or identify the closed loop with its reference as the input"
    )
    return True
