"""Whether a filter's innovations are white, as they are if its model of turbulence is right.

What drives the states of a filter is taken for white noise. A gust that lasts for seconds is not,
nor is what a structure misses: the filter then calls some of the inputs' effect the air's.
Correlations of whitened innovations over the first lags tell, all outputs together,

    Q = Σ_m Σ_ab (Σ_i r̃_a(i) r̃_b(i + m))² / n_ab(m),

which is χ² of a degree of freedom a term if they are white (J. R. M. Hosking, The multivariate
portmanteau statistic, J. Am. Stat. Assoc. 75, 1980).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.special import chdtri

from casid.arrays import Array
from casid.errors import warn
from casid.shooting.programme import Programme

LAGS = 10  # samples
LEVEL = 1e-6  # of the test


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


def correlations(residuals: Sequence[Array]) -> Array:
    """Correlations (lags, ny, ny) in standard deviations of those of white noise; 0 of no pairs.

    Of whitened residuals (N, ny) of every record, 0 where missing.
    """
    ny, found = residuals[0].shape[1], []
    variance = sum(np.sum(r**2, axis=0) for r in residuals)
    variance = variance / np.maximum(sum(np.sum(r != 0, axis=0) for r in residuals), 1)
    for m in range(1, LAGS + 1):
        products, pairs = np.zeros((ny, ny)), np.zeros((ny, ny))
        for r in residuals:
            products += r[:-m].T @ r[m:]
            pairs += (r[:-m] != 0).T.astype(float) @ (r[m:] != 0)
        size = np.sqrt(np.maximum(pairs, 1) * np.outer(variance, variance))
        found.append(products / np.where(size > 0, size, 1.0))
    return np.array(found)


def warn_of_colour(programme: Programme, x: Array) -> None:
    """Tell of a filter whose innovations are not white, at scaled variables x."""
    found = correlations(whitened(programme, x))
    square = found**2
    if square.sum() < chdtri(found.size, LEVEL):
        return
    names = programme.free.model.outputs
    most = names[int(np.argmax(square.sum(axis=(0, 2)) + square.sum(axis=(0, 1))))]
    warn(
        f"filter error: innovations are correlated in time ({most} most), so that what drives the "
        "states is not the white noise that it is taken for: gusts of seconds are not, nor is what "
        "the structure misses. Derivatives may be several of their standard errors off: give gusts "
        "a state of their own in the structure, or the structure what it lacks"
    )
