"""Refinement of a black box of samples by what it is to be used for: simulation.

Prediction errors weigh frequencies by the inverse spectrum of the noise, and an order too low for
the data then bends the response where a simulation shows it most. Here the outputs are simulated
from the inputs alone, the model of output error,

    x⁺ = A x + B u        ŷ = C x + D u + c        min log det Σ (y - ŷ)(y - ŷ)ᵀ

with the initial state and a constant c free for every stretch: `casid.subspace.prediction` with K =
0. It is unbiased in open loop whatever the noise, and efficient where that is white; under feedback
it is biased, and it cannot follow an unstable system. Source: L. Ljung, System Identification, 2nd
ed., sections 4.2 and 8.5.

Errors may be divided by their local level. Where amplitudes vary, errors grow with them, and the
large ones would otherwise drown what the rest of the record shows.

The cost has local minima, so there may be several starts; the likeliest end counts.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace.modal import Modal, from_modal, to_modal
from casid.subspace.prediction import Stretch, fitted, stretches

STEPS = 40  # Gauss-Newton steps a round: simulations settle more slowly than predictions


def refine_simulation(
    starts: Sequence[StateSpace],
    records: Sequence[Record],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    *,
    local: bool = False,
) -> StateSpace:
    """Refine a discrete black box by the simulation of its records.

    Parameters
    ----------
    starts : sequence of StateSpace
        Discrete, of one order; unstable poles are first moved into the unit circle.
    records : sequence of Record
        Equidistant, of one sampling interval; missing outputs (NaN) split them.
    su, sy : (nu,), (ny,) array
        Standard deviations of the channels.
    feedthrough : (ny, nu) bool array
        Where the direct term is free; elsewhere it is zero.
    local : bool
        Whether errors are divided by their local level. The likeliest model without that is one
        more start then.

    Returns
    -------
    StateSpace
        Stable, in real modal coordinates.
    """
    data = [
        replace(each, v=each.v[:, : len(su)])
        for each in stretches(records, su, sy, starts[0].nx + 2)
    ]
    free = np.argwhere(feedthrough)
    several = [to_modal(start, su, sy, feedthrough) for start in starts]
    best = _likeliest(several, data, free, local=False)
    if local:
        best = _likeliest([*several, best], data, free, local=True)
    return _discrete(best, su, sy, starts[0])


def _likeliest(
    starts: Sequence[Modal], data: Sequence[Stretch], free: np.ndarray, *, local: bool
) -> Modal:
    ends = [fitted(start, data, free, STEPS, local=local) for start in starts]
    return min(ends, key=lambda end: _spread(end[1]))[0]


def _spread(W: Array) -> float:
    """Logarithm of the determinant of the errors' covariance, of its whitener."""
    return float(-2 * np.linalg.slogdet(W)[1])


def _discrete(modal: Modal, su: Array, sy: Array, like: StateSpace) -> StateSpace:
    found = from_modal(modal, su, sy, like)
    return StateSpace(found.A, found.B, found.C, found.D, like.dt, like.inputs, like.outputs)
