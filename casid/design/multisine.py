"""Powers of orthogonal multisines: harmonics shared out among the axes, a convex programme.

In the steady state a sine of unit power at ω on axis j gives the information

    F_jω = Re Jᴴ R⁻¹ J,    J = ∂G/∂λ (jω) u(jω),    u = (I + K G)⁻¹ e_j

per sample, and powers add: F = Σ p_jω F_jω, so that the means of F⁻¹ are convex in p. The powers of
each axis, whose sum its amplitude allows, are found by the multiplicative algorithm (D. M.
Titterington, 1978; S. D. Silvey, D. M. Titterington, B. Torsney, 1978): each is multiplied by its
own directional derivative over the mean of its axis. At the optimum no derivative exceeds that mean
(the equivalence theorem of Kiefer and Wolfowitz), which says how far from it one is.
"""

import numpy as np

from casid.arrays import Array
from casid.design.criterion import Goal
from casid.evaluation import Matrices

ROUNDS = 400
SETTLED = 1e-3  # excess of a directional derivative over its axis's mean


def shared_out(count: int, nu: int) -> np.ndarray:
    """Axis of each of ``count`` harmonics: interleaved, so that each axis has the whole band."""
    return np.arange(count) % nu


def unit_information(at: Matrices, K: Array, R: Array, omega: Array, axis: np.ndarray) -> Array:
    """F_jω per sample (n, nf, nf) of sines of unit power at ω (n,) on the axes given."""
    G, slope = at.response_slopes(1j * omega)
    eye = np.eye(G.shape[2])
    u = np.linalg.inv(eye + K @ G)[np.arange(len(omega)), :, axis]
    moves = np.einsum("lkij,kj->kil", slope, u)
    white = np.linalg.inv(np.linalg.cholesky(R)) @ moves
    return np.asarray((white.conj().transpose(0, 2, 1) @ white).real)


def best_powers(goal: Goal, units: Array, axis: np.ndarray, budget: Array) -> tuple[Array, float]:
    """Powers (n,) with the sum ``budget`` (nu,) on each axis, and how far they are from optimal.

    The second number bounds how much lower the criterion could be.
    """
    counts = np.bincount(axis, minlength=len(budget))
    p = budget[axis] / counts[axis]
    excess = np.inf
    for _ in range(ROUNDS):
        M = goal(np.tensordot(p, units, 1))[1]
        gain = np.maximum(-np.tensordot(units, M, ([1, 2], [0, 1])), 0.0)
        mean = np.bincount(axis, p * gain, len(budget)) / budget
        most = np.array([gain[axis == j].max(initial=0.0) for j in range(len(budget))])
        excess = float(budget @ (most - mean))
        if excess < SETTLED:
            break
        p *= np.sqrt(gain / np.maximum(mean[axis], 1e-300))
        p *= (budget / np.maximum(np.bincount(axis, p, len(budget)), 1e-300))[axis]
    return p, excess


def schroeder(powers: Array, axis: np.ndarray) -> Array:
    """Phases (n,) of low peak for given powers (M. R. Schroeder, 1970), axis by axis."""
    phases = np.zeros(len(powers))
    for j in np.unique(axis):
        share = powers[axis == j] / max(powers[axis == j].sum(), 1e-300)
        before = np.concatenate([[0.0], np.cumsum(share)[:-1]])
        phases[axis == j] = -2 * np.pi * np.cumsum(before)
    return phases
