"""Exact one-step maps of a linear model, and their derivatives with respect to its parameters.

    x(t + h) = A_d x(t) + B0 u(t) + B1 u(t + h)

for an input linear over the step ("foh"), or with B1 = 0 for one that rests ("zoh"): blocks of one
exponential of the augmented matrix (Van Loan, IEEE Trans. Automatic Control 23, 1978). The
derivative of exp(M) in the direction E is the upper right block of exp([[M, E], [0, M]]) (Najfeld &
Havel, Adv. Appl. Math. 16, 1995), exact as the exponential itself.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.record import Hold


@dataclass(frozen=True, eq=False)
class StepMap:
    """One step of length h, with derivatives along the last axis where they were asked for.

    Parameters
    ----------
    Ad, B0, B1 : (nx, nx), (nx, nu), (nx, nu) array
        The map.
    Ad_lam, B0_lam, B1_lam : (nx, nx, nf), (nx, nu, nf), (nx, nu, nf) array
        Its derivatives; nf = 0 if none were asked for.
    """

    Ad: Array
    B0: Array
    B1: Array
    Ad_lam: Array
    B0_lam: Array
    B1_lam: Array


def step_map(
    A: Array, B: Array, h: float, hold: Hold, dA: Array | None = None, dB: Array | None = None
) -> StepMap:
    """Map over one step of h seconds.

    Parameters
    ----------
    A, B : (nx, nx), (nx, nu) array
        Continuous model.
    h : float
        Length of the step [s].
    hold : {"foh", "zoh"}
        What the input does meanwhile.
    dA, dB : (nx, nx, nf), (nx, nu, nf) array
        Derivatives of A and B; no derivatives come out without them.
    """
    nx, nu = B.shape
    M = _augmented(A, B, h)
    P = _parts(scipy.linalg.expm(M), nx, nu, hold)
    if dA is None or dB is None:
        empty = np.zeros((nx, nx, 0)), np.zeros((nx, nu, 0)), np.zeros((nx, nu, 0))
        return StepMap(*P, *empty)
    nf, n = dA.shape[2], len(M)
    moving = np.flatnonzero(np.abs(dA).sum(axis=(0, 1)) + np.abs(dB).sum(axis=(0, 1)))
    block = np.zeros((len(moving), 2 * n, 2 * n))
    block[:, :n, :n] = block[:, n:, n:] = M
    block[:, :nx, n : n + nx] = np.moveaxis(dA[:, :, moving], 2, 0) * h
    block[:, :nx, n + nx : n + nx + nu] = np.moveaxis(dB[:, :, moving], 2, 0) * h
    dP = np.zeros((n, n, nf))
    if len(moving):
        dP[:, :, moving] = np.moveaxis(scipy.linalg.expm(block)[:, :n, n:], 0, 2)
    return StepMap(*P, *_parts(dP, nx, nu, hold))


def _augmented(A: Array, B: Array, h: float) -> Array:
    """[A h, B h, 0; 0, 0, I; 0, 0, 0]: its exponential holds both input integrals."""
    nx, nu = B.shape
    M = np.zeros((nx + 2 * nu, nx + 2 * nu))
    M[:nx, :nx] = A * h
    M[:nx, nx : nx + nu] = B * h
    M[nx : nx + nu, nx + nu :] = np.eye(nu)
    return M


def _parts(P: Array, nx: int, nu: int, hold: Hold) -> tuple[Array, Array, Array]:
    Ad, G0, G1 = P[:nx, :nx], P[:nx, nx : nx + nu], P[:nx, nx + nu :]
    if hold == "zoh":
        return Ad, G0, np.zeros_like(G1)
    return Ad, G0 - G1, G1
