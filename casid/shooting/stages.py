"""Inputs at the stages of Runge-Kutta steps, delayed exactly.

Where a delayed sample falls inside a step of length η, the inputs have a kink or a jump there. The
classical fourth-order method sees the inputs at the step's ends and its middle; these are given the
values u_0, u_½, u_1 with which a linear system would move as under the inputs themselves, as far as
ẋ = A x + B u is concerned to A²,

    M_k = ∫_0^η (η - σ)^k/k! u(σ) dσ:  M_0 = η (u_0 + 4 u_½ + u_1)/6,
    M_1 = η² (u_0 + 2 u_½)/6,          M_2 = η³ (u_0 + u_½)/12;

straight lines have their own values. All is analytic in τ between whole steps.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.intersample import ORDER, DelayedInput
from casid.record import Hold

NODES = np.array([0.0, 0.5, 1.0])  # of the stages, in a step
FACTORIAL = np.array([1.0, 1.0, 2.0, 6.0, 24.0])


def stage_inputs(
    held: Sequence[DelayedInput], holds: Sequence[Hold], h: Array, substeps: int
) -> tuple[Array, Array]:
    """Inputs at the stages of all steps, and their derivatives by the delay of each input.

    Two arrays (N, substeps, 3, nu), for sampling intervals h (N,) in so many steps each.
    """
    value, slope = (np.concatenate([getattr(part, n) for part in held]) for n in ("value", "slope"))
    eta = h / substeps
    at = (np.arange(substeps)[:, None] + NODES) * eta[:, None, None]
    u = value[:, None, None] + slope[:, None, None] * at[..., None]
    late = np.broadcast_to(-slope[:, None, None], u.shape).copy()
    first = 0
    for part, hold in zip(held, holds, strict=True):
        _add_breaks(part, ORDER[hold], first, eta, (u, late))
        first += len(part.value)
    return u, late


def _add_breaks(
    held: DelayedInput, order: int, first: int, eta: Array, into: tuple[Array, Array]
) -> None:
    """Add what the breaks of one record change, whose samples begin at ``first``."""
    mine = np.flatnonzero(held.jump)
    row, channel, jump = first + held.step[mine], held.channel[mine], held.jump[mine]
    length, substeps = eta[row], into[0].shape[1]
    for s in range(substeps):
        c = held.rest[mine] - (substeps - 1 - s) * length  # from the break to the step's end
        inside, behind = (c > 0) & (c < length), c >= length
        u, late = _inside(np.clip(c, 0.0, length), length, order)
        past = (np.maximum(c - length, 0.0)[:, None] + NODES * length[:, None]) ** (order - 1)
        u = np.where(behind[:, None], past, u * inside[:, None])
        late = np.where(behind[:, None], -float(order - 1), late * inside[:, None])
        for target, values in zip(into, (u, late), strict=True):
            for stage in range(len(NODES)):
                np.add.at(target[:, s, stage], (row, channel), values[:, stage] * jump)


def _inside(c: Array, eta: Array, order: int) -> tuple[Array, Array]:
    """Stage values (n, 3) for a unit break at c before the end of steps of length eta, and d/dτ."""

    def moments(p: int) -> Array:
        k = np.arange(3)
        scaled = c[:, None] ** (k + p) / FACTORIAL[k + p]
        return np.asarray(scaled / eta[:, None] ** (k + 1))

    return _values(moments(order)), -_values(moments(order - 1))


def _values(M: Array) -> Array:
    """Stage values (n, 3) of moments over η, η², η³: (n, 3)."""
    middle, first = 6 * M[:, 1] - 12 * M[:, 2], 24 * M[:, 2] - 6 * M[:, 1]
    return np.column_stack([first, middle, 6 * M[:, 0] - first - 4 * middle])
