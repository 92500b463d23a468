"""Refinement of a black box of samples by what it is to be used for: simulation.

Prediction errors weigh frequencies by the inverse spectrum of the noise, and an order too low for
the data then bends the response where a simulation shows it most. Here the outputs are simulated
from the inputs alone, the model of output error,

    x⁺ = A x + B u        ŷ = C x + D u + c        min log det Σ (y - ŷ)(y - ŷ)ᵀ

with the initial state and a constant c free for every stretch: `casid.subspace.prediction` with K =
0. Unbiased in open loop whatever the noise, biased under feedback, and unable to follow an unstable
system. Source: L. Ljung, System Identification, 2nd ed., sections 4.2 and 8.5. Errors may be
divided by their local level, or large ones would drown what the rest of a record shows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace.modal import from_modal, to_modal
from casid.subspace.prediction import Stretch, fitted, stretches

STEPS = 15  # Gauss-Newton steps a round: simulations settle more slowly than predictions


def refine_simulation(
    start: StateSpace,
    records: Sequence[Record],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    *,
    local: bool = False,
) -> StateSpace:
    """Refine a discrete black box by the simulation of its records; stable, in modal coordinates.

    Unstable poles are first moved into the unit circle. The records are equidistant, of one
    interval; missing outputs split them. Channels are scaled by ``su`` (nu,), ``sy`` (ny,); the
    direct term is free where ``feedthrough`` (ny, nu) is, zero elsewhere. In a second descent
    errors are divided by their ``local`` level, if asked.
    """
    data: Sequence[Stretch] = [
        replace(each, v=each.v[:, : len(su)]) for each in stretches(records, su, sy, start.nx + 2)
    ]
    free = np.argwhere(feedthrough)
    modal = to_modal(start, su, sy, feedthrough)
    for levelled in (False, True) if local else (False,):
        modal, _, _ = fitted(modal, data, free, STEPS, local=levelled)
    found = from_modal(modal, su, sy, start)
    return StateSpace(found.A, found.B, found.C, found.D, start.dt, start.inputs, start.outputs)
