"""Exact one-step maps of a linear model, and their derivatives with respect to its parameters.

    x(t + h) = A_d x(t) + B0 u(t) + B1 u(t + h) + K_d e(t)

for an input linear over the step ("foh"), or with B1 = 0 for one that rests ("zoh"), and an
innovation e that rests: blocks of one exponential of the augmented matrix (Van Loan, IEEE Trans.
Automatic Control 23, 1978). The derivative of exp(M) in the direction E is the upper right block of
exp([[M, E], [0, M]]) (Najfeld & Havel, Adv. Appl. Math. 16, 1995), exact as the exponential itself.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.record import Hold


@dataclass(frozen=True, eq=False)
class StepMap:
    """One step, or its derivatives: then every array has a last axis (nf,) more.

    ``Ad`` (nx, nx), ``B0`` and ``B1`` (nx, nu), ``Kd`` (nx, ne).
    """

    Ad: Array
    B0: Array
    B1: Array
    Kd: Array


def step_map(A: Array, B: Array, K: Array, h: float, hold: Hold) -> StepMap:
    """Map over one step of h seconds.

    Parameters
    ----------
    A, B, K : (nx, nx), (nx, nu), (nx, ne) array
        Continuous model; ne = 0 without innovations.
    h : float
        Length of the step [s].
    hold : {"foh", "zoh"}
        What the input does meanwhile.
    """
    M = np.zeros((A.shape[0] + 2 * (B.shape[1] + K.shape[1]),) * 2)
    _place(M, A, B, K, h)
    return _parts(scipy.linalg.expm(M), A, B, K, hold)


def step_slopes(
    A: Array, B: Array, K: Array, h: float, hold: Hold, slopes: tuple[Array, Array, Array]
) -> StepMap:
    """Derivatives of the map, from those of A, B, K (last axis nf)."""
    n = A.shape[0] + 2 * (B.shape[1] + K.shape[1])
    A_lam, B_lam, K_lam = (np.moveaxis(slope, 2, 0) for slope in slopes)
    moves = [part.any(axis=(1, 2)) for part in (A_lam, B_lam, K_lam)]
    moving = np.flatnonzero(np.any(moves, axis=0))
    block = np.zeros((len(moving), 2 * n, 2 * n))
    _place(block[:, :n, :n], A, B, K, h)
    block[:, n:, n:] = block[:, :n, :n]
    _place(block[:, :n, n:], A_lam[moving], B_lam[moving], K_lam[moving], h, shift=False)
    slope = np.zeros((n, n, len(A_lam)))
    if len(moving):
        slope[:, :, moving] = np.moveaxis(scipy.linalg.expm(block)[:, :n, n:], 0, 2)
    return _parts(slope, A, B, K, hold)


def _place(M: Array, A: Array, B: Array, K: Array, h: float, shift: bool = True) -> None:
    """[A h, (B K) h, 0; 0, 0, I; 0, 0, 0]: its exponential holds both input integrals."""
    nx, m = A.shape[-2], B.shape[-1] + K.shape[-1]
    M[..., :nx, :nx] = A * h
    M[..., :nx, nx : nx + m] = np.concatenate([B, K], axis=-1) * h
    if shift:
        M[..., nx : nx + m, nx + m :] = np.eye(m)


def _parts(P: Array, A: Array, B: Array, K: Array, hold: Hold) -> StepMap:
    nx, nu, m = A.shape[0], B.shape[1], B.shape[1] + K.shape[1]
    G0, G1 = P[:nx, nx : nx + m], P[:nx, nx + m :]
    B0, B1, Kd = G0[:, :nu], G1[:, :nu], G0[:, nu:]
    if hold == "zoh":
        return StepMap(P[:nx, :nx], B0, np.zeros_like(B1), Kd)
    return StepMap(P[:nx, :nx], B0 - B1, B1, Kd)
