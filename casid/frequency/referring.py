"""Responses to inputs from responses of inputs and outputs to references: the joint approach.

References r move inputs u and outputs y of a loop from outside (L. Ljung, System Identification,
2nd ed., section 13.5):

    G = G_yr G_ur⁻¹,      δG = (δG_yr − G δG_ur) G_ur⁻¹ = M [δG_ur; δG_yr] G_ur⁻¹,   M = [−G, I],

so errors of covariance S over outputs and P over references become M S Mᴴ and G_ur⁻ᵀ P G_ur⁻*.
"""

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.frequency.spectra import correlation


def of_inputs(
    G: ComplexArray, error: Array, outputs: ComplexArray, inputs: ComplexArray, nu: int
) -> tuple[ComplexArray, Array, ComplexArray, ComplexArray]:
    """Response, relative error and correlations of what references move by way of nu inputs.

    From those of inputs, then outputs, to references.
    """
    known = np.isfinite(G).all(axis=(1, 2), keepdims=True)
    inverse = np.linalg.inv(np.where(known, G[:, :nu], np.eye(nu)))
    found = np.where(known, G[:, nu:] @ inverse, np.nan)
    # Variances are nearly products of an output's and a reference's.
    squared = np.where(known, (error * np.abs(G)) ** 2, 1.0)
    sigma = squared.mean(axis=2)
    pi = np.sqrt((squared / np.maximum(sigma, 1e-300)[:, :, None]).mean(axis=1))
    sigma = np.sqrt(sigma)
    S, P = (r[:, :, None] * each * r[:, None] for r, each in ((sigma, outputs), (pi, inputs)))
    one = np.broadcast_to(np.eye(G.shape[1] - nu), (len(G), *(G.shape[1] - nu,) * 2))
    M = np.concatenate([-np.nan_to_num(found), one], axis=2)
    S = M @ S @ M.conj().swapaxes(1, 2)
    P = inverse.swapaxes(1, 2) @ P @ inverse.conj()
    variance = np.einsum("kii->ki", S).real[:, :, None] * np.einsum("kjj->kj", P).real[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(known, np.sqrt(variance) / np.abs(found), np.nan)
    return found, error, correlation(S), correlation(P)
