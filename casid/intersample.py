"""What inputs do between samples, delayed exactly, and how states answer.

Between samples the inputs of a record are straight lines ("foh") or steps ("zoh"); a delay shifts
just that. Over the step of length h that begins at t_k

    u(t_k + s - τ) = value + slope s + Σ_i jump_i (s - s_i)₊^(p-1),       p = 2 (foh), 1 (zoh)

with a break wherever a delayed sample falls inside the step, and the states move to

    e^{Ah} x + P_1(h) B value + P_2(h) B slope + Σ_i P_p(h - s_i) B jump_i,
    P_p(r) = ∫_0^r e^{A(r-s)} s^(p-1)/(p-1)! ds,    dP_p/dr = P_{p-1},    P_0(r) = e^{Ar}.

So the derivative by τ is P_{p-1} in the place of P_p, with the opposite sign: exact, no Padé
approximation, no state for the delay. The states have a kink in τ where breaks pass samples if the
inputs are steps; the outputs of a direct term have a kink (foh) or a jump (zoh) there.
"""

from typing import NamedTuple

import numpy as np

from casid.arrays import Array
from casid.record import Hold

ORDER = {"foh": 2, "zoh": 1}  # p of the maps of breaks
ROUNDING = 1e-9  # of the shortest sampling interval: what falls together so closely is one instant


class DelayedInput(NamedTuple):
    """u(t - τ) of one record."""

    value: Array  # (N, nu) at every sample
    slope: Array  # (N, nu) after it until the next break
    instant: float  # [s]: rests that differ by less are equal
    channel: np.ndarray  # (n,) input of every break
    step: np.ndarray  # (n,) number of the sample before it
    rest: Array  # (n,) time from the break to the next sample [s]
    jump: Array  # (n,) what changes there: the slope (foh) or the input itself (zoh)


def delayed_input(
    t: Array, u: Array, tau: Array, hold: Hold, within: Array | None = None
) -> DelayedInput:
    """Inputs (N, nu) held between the instants t (N,) and then delayed by τ (nu,) [s].

    Before the first sample they rest at their first value. The order of breaks and samples is that
    of the delays ``within`` (nu,), τ itself unless given: with a delay between two whole numbers of
    samples there, all is analytic in τ up to both and beyond.
    """
    rate = np.zeros_like(u)
    if hold == "foh":
        rate[:-1] = np.diff(u, axis=0) / np.diff(t)[:, None]
    start, level = np.concatenate([t[:1], t]), np.concatenate([u[:1], u])
    rate = np.concatenate([np.zeros_like(u[:1]), rate])
    jumps = np.diff(rate if hold == "foh" else level, axis=0)
    value, slope, none = np.empty_like(u), np.empty_like(u), np.zeros(0)
    breaks = [(none.astype(int), none.astype(int), none, none)]
    instant, k = float(ROUNDING * np.diff(t).min()), np.arange(len(t))
    h = (t[-1] - t[0]) / (len(t) - 1)
    even = bool(np.abs(t - t[0] - h * k).max() < instant / 4)
    for j, late in enumerate(tau if within is None else within):
        if even and late >= 0:
            whole = int(np.ceil((late - instant) / h))
            piece = np.maximum(k + 1 - whole, 0)
            knot = np.arange(piece[0], piece[-1])
            step = knot + whole - 1
        else:
            piece = np.searchsorted(t + late, t + instant, side="right")
            knot = np.arange(piece[0], piece[-1])
            step = np.searchsorted(piece, knot, side="right") - 1
        slope[:, j] = rate[piece, j]
        value[:, j] = level[piece, j] + slope[:, j] * (t - tau[j] - start[piece])
        rest = t[step + 1] - t[knot] - tau[j]
        breaks.append((np.full(len(knot), j), step, rest, jumps[knot, j]))
    parts = (np.concatenate(part) for part in zip(*breaks, strict=True))
    return DelayedInput(value, slope, instant, *parts)


def integrals(A: Array, times: Array) -> Array:
    """e^{Ar}, P_1(r) and P_2(r) at times r (n,) [s]: an array (3, n, nx, nx)."""
    return integral_slopes(A, times, np.zeros((*A.shape, 0)))[..., 0]


def integral_slopes(A: Array, times: Array, A_lam: Array) -> Array:
    """The same, and behind each its derivatives: (3, n, nx, nx, 1 + nf), A_lam (nx, nx, nf).

    Taylor's series in ‖A‖ r <= 1/2, its powers of A shared by all times, then doubling:

        P_0(2r) = P_0 P_0,  P_1(2r) = P_1 + P_0 P_1,  P_2(2r) = P_2 + r P_1 + P_0 P_2.
    """
    size = np.abs(A).sum(axis=0).max() * np.abs(times).max(initial=0.0)
    doublings = max(0, int(np.ceil(np.log2(max(2 * size, 1e-300)))))
    r, (nx, _, nf) = times / 2.0**doublings, A_lam.shape
    slope = A_lam.transpose(0, 2, 1).reshape(nx * nf, nx)
    powers = np.zeros((18, nx, 1 + nf, nx))  # and behind each, in the middle, its derivatives
    powers[0, :, 0] = np.eye(nx)
    factors = np.empty((18, 3, len(r)))  # r^(n+p) / (n+p)!
    factors[0] = np.ones_like(r), r, r * r / 2
    for n in range(17):
        powers[n + 1] = (A @ powers[n].reshape(nx, -1)).reshape(nx, 1 + nf, nx)
        powers[n + 1, :, 1:] += (slope @ powers[n, :, 0]).reshape(nx, nf, nx)
        factors[n + 1] = factors[n] * r / (n + 1 + np.arange(3))[:, None]
    P = (factors.reshape(18, -1).T @ powers.reshape(18, -1)).reshape(3, len(r), nx, 1 + nf, nx)
    for _ in range(doublings):
        old, E = P.copy(), P[0, :, :, 0].copy()
        ahead = (E @ old.reshape(3, len(r), nx, -1)).reshape(P.shape)
        P[0] = ahead[0]
        P[1:] += ahead[1:]
        moved = old[0, :, :, 1:].reshape(len(r), nx * nf, nx) @ old[:, :, :, 0]
        P[:, :, :, 1:] += moved.reshape(3, len(r), nx, nf, nx)
        P[2] += r[:, None, None, None] * old[1]
        r = 2 * r
    return np.moveaxis(P, 3, 4)


def break_forcing(held: DelayedInput, A: Array, B: Array, order: int) -> Array:
    """What the breaks of delayed inputs add to the states (N - 1, nx) over each step."""
    rest, place = distinct(held.rest, held.instant)
    forcing = np.zeros((len(held.value) - 1, len(A)))
    acting = (held.rest != 0) | (order == 0)  # P_1(0) = P_2(0) = 0: no delay adds nothing
    for k in range(0, len(rest), 1000):  # bounds the memory
        near = np.flatnonzero(acting & (place >= k) & (place < k + 1000))
        columns = integrals(A, rest[k : k + 1000])[order] @ B
        moved = columns[place[near] - k, :, held.channel[near]] * held.jump[near, None]
        np.add.at(forcing, held.step[near], moved)
    return forcing


def distinct(times: Array, unit: float) -> tuple[Array, np.ndarray]:
    """Different times among those given, but for roundings by a unit, and which each is."""
    if not len(times) or np.ptp(times) <= unit:
        return times[:1] * 0 + times.sum() / max(len(times), 1), np.zeros(len(times), dtype=int)
    _, first, place = np.unique(np.round(times / unit), return_index=True, return_inverse=True)
    return times[first], place


# What a simulation needs of this, for files that simulate without casid.
PARTS = (DelayedInput, delayed_input, integrals, integral_slopes, break_forcing, distinct)
