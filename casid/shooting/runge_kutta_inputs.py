"""Inputs at the stages of Runge-Kutta steps, delayed exactly.

A sampling interval has so many steps. Where a delayed sample falls inside one of length η,
the inputs have a kink or a jump there, and the step is cut in two: within each part they are
straight lines or constant, and nothing but the method's own error of fourth order is left, whatever
the structure. The cut moves with the delay, and the parts' lengths with it.

Where all that inputs do is to add to the right-hand side, a step need not be cut. The method sees
the inputs at the step's ends and its middle; these are given the values u_0, u_½, u_1 with which a
linear system would move as under the inputs themselves, as far as ẋ = A x + B u is concerned to A²,

    M_k = ∫_0^η (η - σ)^k/k! u(σ) dσ:  M_0 = η (u_0 + 4 u_½ + u_1)/6,
    M_1 = η² (u_0 + 2 u_½)/6,          M_2 = η³ (u_0 + u_½)/12;

straight lines have their own values. They may leave the inputs' range, so that the square or the
root of an input would be wrong. All is analytic in τ between whole steps.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, BoolArray
from casid.intersample import ORDER, ROUNDING, DelayedInput
from casid.record import Hold

NODES = np.array([0.0, 0.5, 1.0])  # of the stages, in a step
FACTORIAL = np.array([1.0, 1.0, 2.0, 6.0, 24.0])
LEAST = 1e-9  # of a channel's largest break: smaller ones are roundings, and cut nothing


@dataclass(frozen=True, eq=False)
class Stages:
    """Steps within all sampling intervals, of which the first ``count`` are used.

    Each is one of those that share, at ``share``, a part between two breaks.
    """

    u: Array  # (N, S, 3, nu) inputs at the stages
    late: Array  # (N, S, 3, nu) their derivatives by their own delays, the steps' ends held
    eta: Array  # (N, S) lengths [s]
    mover: np.ndarray  # (N, parts + 1) input whose delay moves a part's beginning; -1: none does
    count: np.ndarray  # (N,)
    least: int  # of the counts
    share: Array  # (shares + 1,) ends of the steps within a part, 0 to 1


class _Breaks(NamedTuple):
    """Breaks of all records, n of them."""

    row: np.ndarray  # sample before
    channel: np.ndarray
    order: np.ndarray  # p: 1 a jump, 2 a kink
    place: Array  # time from the sample [s]
    size: Array  # what changes there
    cut: BoolArray  # whether the step is cut there


def stage_inputs(
    held: Sequence[DelayedInput],
    holds: Sequence[Hold],
    h: Array,
    steps: tuple[int, int],
    cut: Collection[Hold] = ("foh", "zoh"),
    tau_lam: Array | None = None,
) -> Stages:
    """Steps and inputs of sampling intervals h (N,), cut at the breaks.

    Not those of records whose inputs are held otherwise than ``cut`` says: these have the moments.
    ``steps`` are in how many an interval is divided before the cuts, and each of these afterwards.
    ``tau_lam`` (nu, nf), derivatives of the delays, say which move and which move together.
    """
    value, slope = (np.concatenate([getattr(part, n) for part in held]) for n in ("value", "slope"))
    (N, nu), (whole, shares) = value.shape, steps
    moves = np.zeros((nu, 0)) if tau_lam is None else tau_lam
    breaks = _breaks(held, holds, h, whole, cut, np.asarray(moves.any(axis=1)))
    times, mover, count, number = _parts(breaks, h, whole, moves)
    eta, parts = np.diff(times, axis=1), times.shape[1] - 1
    changes = np.zeros((2, N, parts + 1, nu))
    np.add.at(changes, (breaks.order - 1, breaks.row, number, breaks.channel), breaks.size)
    level, rate = changes.cumsum(axis=2)[:, :, :parts]
    rate += slope[:, None]
    level += value[:, None]
    level[:, 1:] += (rate * eta[..., None]).cumsum(axis=1)[:, :-1]
    share = _shares(shares, even="foh" not in cut)
    place = (share[:-1, None] + NODES * np.diff(share)[:, None]) * eta[:, :, None, None]
    u = level[:, :, None, None] + rate[:, :, None, None] * place[..., None]
    u, eta = u.reshape(N, -1, len(NODES), nu), (eta[:, :, None] * np.diff(share)).reshape(N, -1)
    late = np.repeat(np.repeat(-rate, shares, axis=1)[:, :, None], len(NODES), axis=2)
    first, some = 0, slice(whole * shares)
    for part, hold in zip(held, holds, strict=True):
        if hold not in cut:
            _add_breaks(part, ORDER[hold], first, h / some.stop, (u[:, some], late[:, some]))
        first += len(part.value)
    return Stages(u, late, eta, mover, count * shares, int(count.min()) * shares, share)


def _shares(n: int, *, even: bool) -> Array:
    """Ends of n steps within a part, 0 to 1.

    Uneven ones are shorter towards its ends, so that many steps follow the root of an input that
    comes from zero.
    """
    s: Array = np.linspace(0.0, 1.0, n + 1)
    return s if even else s * s * (3 - 2 * s)


def _breaks(
    held: Sequence[DelayedInput],
    holds: Sequence[Hold],
    h: Array,
    whole: int,
    cut: Collection[Hold],
    moving: BoolArray,
) -> _Breaks:
    """Breaks at which steps are cut, or so close to their ends that none need be.

    One whose delay moves is a cut even there: it is how the states depend on the delay.
    """
    none = np.zeros(0, dtype=int)
    found, first = [_Breaks(none, none, none, np.zeros(0), np.zeros(0), none > 0)], 0
    for part, hold in zip(held, holds, strict=True):
        if hold in cut:
            largest = np.zeros(part.value.shape[1])
            np.maximum.at(largest, part.channel, np.abs(part.jump))
            some = np.flatnonzero(part.jump)
            row, channel, size = first + part.step[some], part.channel[some], part.jump[some]
            place = np.clip(h[row] - part.rest[some], 0.0, h[row])
            even = h[row] * (np.round(whole * place / h[row]) / whole)
            inside = np.abs(place - even) > part.instant
            away = (inside | moving[channel]) & (np.abs(size) > LEAST * largest[channel])
            order = np.full(len(some), ORDER[hold])
            found.append(_Breaks(row, channel, order, place, size, away))
        first += len(part.value)
    return _Breaks(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _parts(
    breaks: _Breaks, h: Array, substeps: int, moves: Array
) -> tuple[Array, np.ndarray, np.ndarray, np.ndarray]:
    """Ends of the steps (N, S + 1) [s], movers and counts, and the step that each break begins.

    Breaks whose delays are one begin one step.
    """
    N, cut = len(h), np.flatnonzero(breaks.cut)
    row = np.concatenate([np.repeat(np.arange(N), substeps), breaks.row[cut]])
    even = h[:, None] * np.arange(substeps) / substeps
    place = np.concatenate([even.ravel(), breaks.place[cut]])
    alike = np.unique(moves, axis=0, return_inverse=True)[1].ravel()
    kind = np.concatenate([np.full(N * substeps, -1), alike[breaks.channel[cut]]])
    channel = np.concatenate([np.full(N * substeps, -1), breaks.channel[cut]])
    order = np.lexsort((kind, place, row))
    row, place, kind, channel = row[order], place[order], kind[order], channel[order]
    new = np.append(True, (np.diff(row) != 0) | (np.diff(place) != 0) | (np.diff(kind) != 0))
    count = np.bincount(row[new], minlength=N)
    rank = np.cumsum(new) - 1 - (np.cumsum(count) - count)[row]
    times = np.repeat(h[:, None], count.max() + 1, axis=1)
    mover = np.full(times.shape, -1)
    times[row[new], rank[new]], mover[row[new], rank[new]] = place[new], channel[new]
    number = np.empty(len(order), dtype=int)
    number[order] = rank
    begun = np.empty(len(breaks.row), dtype=int)
    begun[cut] = number[N * substeps :]
    rest = np.flatnonzero(~breaks.cut)
    near = breaks.place[rest] - ROUNDING * h[breaks.row[rest]]
    begun[rest] = (times[breaks.row[rest]] < near[:, None]).sum(axis=1)
    return times, mover, count, begun


def _add_breaks(
    held: DelayedInput, order: int, first: int, eta: Array, into: tuple[Array, Array]
) -> None:
    """Add what the breaks of one record change, whose samples begin at ``first``.

    One at a step's end is in one of the two: it still moves with its delay, as one within.
    """
    mine = np.flatnonzero(held.jump)
    row, channel, jump = first + held.step[mine], held.channel[mine], held.jump[mine]
    length, substeps = eta[row], into[0].shape[1]
    own = substeps - 1 - np.clip(held.rest[mine] // length, 0, substeps - 1)
    for s in range(substeps):
        c = held.rest[mine] - (substeps - 1 - s) * length  # from the break to the step's end
        inside, behind = own == s, own < s
        u, late = _inside(c, length, order)
        past = ((c - length)[:, None] + NODES * length[:, None]) ** (order - 1)
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
