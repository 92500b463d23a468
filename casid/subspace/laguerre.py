"""Laguerre projections of sampled signals and the bilinear maps that go with them.

Source: M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", equations (3)-(6), *the paper* here; Y. Ohta, T. Kawai, MTNS 2004.

With ℓ(τ) = exp(A_L τ) b, the impulse responses of the filters (3), the projections (4) of v

    z(t) = ∫_0^∞ ℓ(τ) v(t + τ) dτ        obey        dz/dt = -A_L z - b v

and are computed backwards in time, exactly for a signal that is linear (or constant) between its
samples, whatever their spacing.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.linear import StateSpace, foh_step, recursion, step_groups
from casid.record import Hold

Maps = tuple[Array, Array, Array]  # E, F0, F1 of a step backwards

REACH = 2.0  # of `support`: beyond it a kernel has less than 1 % of its norm


def laguerre(a: float, n: int) -> tuple[Array, Array]:
    """A_L (n, n) and b (n,) of the first n Laguerre functions with pole a > 0 [rad/s]."""
    A_L = np.tril(np.full((n, n), -2 * a), -1) - a * np.eye(n)
    return A_L, np.full(n, np.sqrt(2 * a))


def support(a: float, k: int) -> float:
    """Time [s] within which the k-th function (from 0) has 99 % of its norm.

    Its turning point (2k + 1)/a and twice the width of the Airy region behind it; the first few
    functions, which have hardly a turning point, decay like exp(-a t).
    """
    return float(max((2 * k + 1) + REACH * (4 * k + 2) ** (1 / 3), np.log(100.0)) / a)


def project_blocks(
    t: Array, v: Array, a: float, n: int, hold: Hold = "foh", size: int = 4096
) -> Iterator[tuple[int, Array]]:
    """Projections on the first n functions of pole ``a`` [rad/s], from the record's end backwards.

    The signal v (N, nv) at instants t (N,) [s] of any spacing is zero after its last sample. Yields
    start and block, of ``size`` samples: its element [i, k] is z_k(t_{start + i}) of every channel,
    paper (4).
    """
    A_L, b = laguerre(a, n)
    steps, which = step_groups(t)
    maps = [_backward_step(A_L, b, step, hold) for step in steps]
    z = np.zeros((n, v.shape[1]))
    end = len(t)
    while end > 0:
        start = max(end - size, 0)
        block = _block(maps, which[start:end], v[start : end + 1], z)[: end - start]
        z = block[0]
        yield start, block
        end = start


def _block(maps: Sequence[Maps], which: np.ndarray, v: Array, z: Array) -> Array:
    """Projections at the samples v (N, nv) backwards from z (n, nv) at the last, (N, n, nv)."""
    if len(maps) == 1:
        E, F0, F1 = maps[0]
        forcing = F0 * v[:-1, None] + F1 * v[1:, None]
        return recursion(E, forcing[::-1], z)[::-1]
    block = np.empty((len(v), *z.shape))
    block[-1] = z
    for i in reversed(range(len(v) - 1)):
        E, F0, F1 = maps[which[i]]
        block[i] = E @ block[i + 1] + F0 * v[i] + F1 * v[i + 1]
    return block


def _backward_step(A_L: Array, b: Array, h: float, hold: Hold) -> Maps:
    """E, F0, F1 of z(t) = E z(t + h) + F0 v(t) + F1 v(t + h)."""
    E, F1, F0 = foh_step(A_L, b[:, None], h)  # τ runs from t to t + h: the weights swap sides
    if hold == "zoh":
        return E, F0 + F1, np.zeros_like(F1)
    return E, F0, F1


def from_laguerre(system: StateSpace, K_o: Array, a: float) -> tuple[StateSpace, Array]:
    """Continuous model and gain of a transformed one (A_o, B_o, C_o, D_o), K_o: paper (6) inverted.

    The printed K_o has its factors in an order that cannot be multiplied; here
    K_o = √(2a) (Â - aI)⁻¹ K̂ (I - Ĉ(Â - aI)⁻¹ K̂)⁻¹. ValueError: a transformed pole at 1, which
    would be a continuous pole at infinity.
    """
    A_o, B_o, C_o, D_o = system.A, system.B, system.C, system.D
    eye, root = np.eye(len(A_o)), np.sqrt(2 * a)
    if np.linalg.cond(A_o - eye) > 1e13:
        raise ValueError(
            f"a transformed pole lies at 1: a continuous pole much faster than a = {a:g} rad/s; "
            "lower the order or raise the Laguerre pole"
        )
    A = a * scipy.linalg.solve((A_o - eye).T, (A_o + eye).T).T
    shifted = A - a * eye
    B = shifted @ B_o / root
    C = -C_o @ shifted / root
    D = D_o + C_o @ np.linalg.solve(eye - A_o, B_o)
    M = np.linalg.solve(root * eye + K_o @ C, K_o)
    names = system.inputs, system.outputs, system.states
    return StateSpace(A, B, C, D, None, *names), shifted @ M
