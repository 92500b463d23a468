"""Weights by what a structure can reach.

By the size of the outputs or of their responses, one pair that the structure cannot make rules the
H-infinity norm. Divided by what a quadratic fit leaves of each pair, smoothed over frequency, the
norm says by how much the misfit exceeds its own typical one at worst.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.matching.comparison import Comparison, Source
from casid.matching.targets import Target, in_channels, row_sizes
from casid.model import Model
from casid.subspace.pbsid import BlackBox

SMOOTH = 0.35  # half width of the window over which a pair's misfit is averaged, in ln ω
LEAST = 0.05  # of its row's response: a misfit below this counts as this


def reachable(comparison: Comparison, system: StateSpace, stated: Sequence[Array]) -> Comparison:
    """A comparison with relative weights, its pairs divided by the misfit of a model instead.

    The system is what a quadratic fit to it reached; ``stated`` (K, ny, nu) are standard deviations
    of every source's response, 0 where unknown.
    """
    scale = comparison.input_scale
    sources = []
    for source, std in zip(comparison.sources, stated, strict=True):
        rows = row_sizes(source, scale)[:, :, None]
        rows = np.where(np.isfinite(rows), rows, 1.0)  # of outputs that this source does not have
        error = (system.response(source.omega, source.shift) - source.G) * scale
        typical = np.sqrt(_smoothed(np.abs(error) ** 2, source))
        W = source.W * rows / np.maximum(np.maximum(typical, std * scale), LEAST * rows)
        sources.append(replace(source, W=W, node_weights=W))
    return replace(comparison, sources=tuple(sources))


def _smoothed(squares: Array, source: Source) -> Array:
    """Mean of every pair's squares over the weighted points of a window about each frequency."""
    x, used = np.log(source.omega), source.W > 0
    near = (np.abs(x[:, None] - x) <= SMOOTH).astype(float)
    count = np.maximum(np.tensordot(near, used.astype(float), axes=1), 1.0)
    return np.asarray(np.tensordot(near, squares * used, axes=1) / count)


def stated_errors(model: Model, target: Target, source: Source) -> Array:
    """Standard deviation of a target's response as it states it, 0 where it does not, (K, ny, nu).

    That of a black box is the one on s = jω.
    """
    if isinstance(target, FrequencyResponse):
        at = np.searchsorted(target.omega, source.omega)
        relative = np.sqrt(2) * target.error[at]  # of gain and phase
        names = target.outputs, target.inputs
    elif isinstance(target, BlackBox) and target.uncertainty is not None:
        relative = np.hypot(*target.response_std(source.omega))
        names = target.system.outputs, target.system.inputs
    else:
        return np.zeros(source.W.shape)
    found = in_channels(model, *names, relative) * np.abs(source.G)
    return np.asarray(np.where(np.isfinite(found), found, 0.0))
