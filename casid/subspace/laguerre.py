"""Laguerre projections of sampled signals and the bilinear maps that go with them.

Source: M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", equations (3)-(6), *the paper* here; Y. Ohta, T. Kawai, MTNS 2004.

With ℓ(τ) = exp(A_L τ) b, the impulse responses of the filters (3), the projections (4) of v

    z(t) = ∫_0^∞ ℓ(τ) v(t + τ) dτ        obey        dz/dt = -A_L z - b v

and are computed backwards in time, exactly for a signal that is linear (or constant) between its
samples, whatever their spacing.
"""

from collections.abc import Iterator

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.linear import StateSpace, foh_step, step_groups
from casid.record import Hold

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


def project(t: Array, v: Array, a: float, n: int, hold: Hold = "foh") -> Array:
    """Projections of every channel on the first n functions, seen from every sample.

    Parameters
    ----------
    t : (N,) array
        Instants [s], any spacing.
    v : (N, nv) array
        Signal, finite; zero after its last sample.
    a : float
        Laguerre pole [rad/s].
    n : int
        Number of functions.
    hold : {"foh", "zoh"}
        What the signal does between samples.

    Returns
    -------
    (N, n, nv) array
        Element [i, k] is z_k(t_i), paper (4).
    """
    blocks = list(project_blocks(t, v, a, n, hold, len(t)))
    return blocks[0][1]


def project_blocks(
    t: Array, v: Array, a: float, n: int, hold: Hold = "foh", size: int = 4096
) -> Iterator[tuple[int, Array]]:
    """`project` from the end of the record backwards, ``size`` samples at a time.

    Yields
    ------
    (start, block)
        The block holds the projections of the samples ``start`` to ``start + len(block) - 1``.
    """
    A_L, b = laguerre(a, n)
    steps, which = step_groups(t)
    maps = [_backward_step(A_L, b, step, hold) for step in steps]
    z = np.zeros((n, v.shape[1]))
    end = len(t)
    while end > 0:
        start = max(end - size, 0)
        block = np.empty((end - start, n, v.shape[1]))
        for i in range(end - 1, start - 1, -1):
            if i < len(t) - 1:
                E, F0, F1 = maps[which[i]]
                z = E @ z + F0 * v[i] + F1 * v[i + 1]
            block[i - start] = z
        yield start, block
        end = start


def _backward_step(A_L: Array, b: Array, h: float, hold: Hold) -> tuple[Array, Array, Array]:
    """E, F0, F1 of z(t) = E z(t + h) + F0 v(t) + F1 v(t + h)."""
    E, F1, F0 = foh_step(A_L, b[:, None], h)  # τ runs from t to t + h: the weights swap sides
    if hold == "zoh":
        return E, F0 + F1, np.zeros_like(F1)
    return E, F0, F1


# ---- bilinear maps ------------------------------------------------------------------------------


def to_laguerre(system: StateSpace, K: Array, a: float) -> tuple[StateSpace, Array]:
    """Transformed model (A_o, B_o, C_o, D_o) and gain K_o of a continuous one; paper (6).

    The printed K_o has its factors in an order that cannot be multiplied; here
    K_o = √(2a) (Â - aI)⁻¹ K̂ (I - Ĉ(Â - aI)⁻¹ K̂)⁻¹.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    shifted = A - a * np.eye(len(A))
    root = np.sqrt(2 * a)
    N = np.linalg.solve(shifted, K)  # (Â - aI)⁻¹ K̂
    A_o = np.linalg.solve(shifted, A + a * np.eye(len(A)))
    B_o = root * np.linalg.solve(shifted, B)
    C_o = -root * np.linalg.solve(shifted.T, C.T).T
    D_o = D - C @ np.linalg.solve(shifted, B)
    K_o = root * np.linalg.solve((np.eye(len(C)) - C @ N).T, N.T).T
    names = system.inputs, system.outputs, system.states
    return StateSpace(A_o, B_o, C_o, D_o, 1.0, *names), K_o


def from_laguerre(system: StateSpace, K_o: Array, a: float) -> tuple[StateSpace, Array]:
    """Inverse of `to_laguerre`: the continuous model and gain of a transformed one.

    Raises
    ------
    ValueError
        A transformed pole at 1, which would be a continuous pole at infinity.
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
