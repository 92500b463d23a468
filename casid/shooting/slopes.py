"""Derivatives of whitened residuals: by the parameters, all else following, and by that itself."""

from collections.abc import Callable, Iterator

import numpy as np

from casid.arrays import Array
from casid.shooting.programme import Programme


def slopes(
    programme: Programme, x: Array, follow: Array
) -> Callable[[Array], Iterator[Iterator[Array]]]:
    """Total derivatives of every record's whitened residuals by the scaled unknowns.

    ``follow`` is as `casid.shooting.precision.information` has it; they come times an (nf, k)
    array, in pieces (n, ny, k).
    """
    e, s, layout = programme.evaluator, programme.scales, programme.evaluator.layout
    sweep = programme.blocks(x).sweep
    nf, nx, ny, first = e.nf, e.nx, e.ny, programme.first_node
    move = np.zeros((programme.J, nf + nx + ny, nf))  # chronological
    move[:, :nf] = np.diag(s.lam)
    move[:, nf : nf + nx] = follow[first - nf :].reshape(programme.J, nx, nf) * s.state[:, None]
    if programme.biases:
        bias = follow[: first - nf].reshape(-1, ny, nf) * s.bias[:, None]
        move[:, nf + nx :] = bias[programme.record]
    return lambda root: sweep.influence(move[layout.node] @ root)


def beginnings(programme: Programme, x: Array) -> Iterator[Iterator[Array]]:
    """Derivatives of every record's whitened residuals by its scaled initial state and biases.

    In pieces (n, ny, nx + biases).
    """
    e, s, layout = programme.evaluator, programme.scales, programme.evaluator.layout
    blocks, nf, nx = programme.blocks(x), e.nf, e.nx
    biased = np.flatnonzero(~np.isin(programme.free.model.outputs, programme.free.unbiased))
    biased = biased[: len(biased) * programme.biases]
    move = np.zeros((programme.J, nf + nx + e.ny, nx + len(biased)))  # chronological
    state = np.eye(nx)
    for j in range(programme.J):
        if j == 0 or programme.record[j] != programme.record[j - 1]:
            state = np.eye(nx)
        move[j, nf : nf + nx, :nx] = state * s.state[:, None]
        state = blocks.slope_n[j] @ state
    move[:, nf + nx + biased, nx + np.arange(len(biased))] = s.bias[biased]
    return blocks.sweep.influence(move[layout.node])
