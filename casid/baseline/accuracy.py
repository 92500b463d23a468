"""Accuracy of parameters fitted to frequency responses, as T&R define and judge it.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*),
chapter 12: Cramér-Rao figures 2 √(H⁻¹)ᵢᵢ up to 20 % of the value and insensitivities 1/√Hᵢᵢ up to
10 % are satisfactory, H the Hessian of the cost J.
"""

from typing import Any

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray

CRAMER_RAO, INSENSITIVITY = 20.0, 10.0  # guidelines, % of the value


def accuracy(
    jacobian: Array, active: BoolArray, ties: Array | None = None
) -> tuple[Array, Array, Array]:
    """√(H⁻¹)ᵢᵢ, 1/√Hᵢᵢ and H⁻¹ of the cost Σ r², H = 2 JᵀJ, T&R chapter 12.

    Parameters
    ----------
    jacobian : (residuals, nf) array
        dr/dλ.
    active : (nf,) bool array
        Parameters on a bound: known, and without uncertainty (NaN).
    ties : (m, nf) array
        Gradients of relations that hold between the parameters.

    Returns
    -------
    (nf,), (nf,), (nf, nf) array
        Infinite where the data do not tell parameters apart.
    """
    H = 2 * jacobian.T @ jacobian
    size = np.sqrt(np.diag(H))
    with np.errstate(divide="ignore"):
        insensitivity = np.where(size > 0, 1 / size, np.inf)
    inside = np.flatnonzero(~active & (size > 0))
    covariance = np.full(H.shape, np.nan)
    if len(inside):
        unit = H[np.ix_(inside, inside)] / np.outer(size[inside], size[inside])
        Z = np.eye(len(inside))
        if ties is not None and len(ties):
            Z = scipy.linalg.null_space(ties[:, inside] / size[inside])
        eigenvalues, V = np.linalg.eigh(Z.T @ unit @ Z)
        lost = eigenvalues <= len(inside) * np.finfo(float).eps * eigenvalues[-1]
        V = Z @ V
        inverse = (V[:, ~lost] / eigenvalues[~lost]) @ V[:, ~lost].T
        blind = (np.abs(V[:, lost]) > 1e-6).any(axis=1)
        inverse[np.ix_(blind, blind)] += np.diag(np.full(int(blind.sum()), np.inf))
        covariance[np.ix_(inside, inside)] = inverse / np.outer(size[inside], size[inside])
    return np.sqrt(np.diag(covariance)), insensitivity, covariance


def scatter(jacobian: Array, covariance: Array, noise: Array) -> Array:
    """Standard deviations of λ that independent errors of the residuals cause, (nf,)."""
    known = np.nan_to_num(covariance, nan=0.0, posinf=0.0)
    gain = 2 * known @ jacobian.T  # dλ = H⁻¹ 2Jᵀ dr
    spread = np.sqrt(np.sum((gain * noise) ** 2, axis=1))
    return np.asarray(np.where(np.isfinite(np.diag(covariance)), spread, np.nan))


def accuracy_row(
    name: str, value: float, std: float, insensitivity: float, scatter: float
) -> dict[str, Any]:
    """One row of the accuracy table: percentages of the value, and the guidelines it misses."""
    size = abs(value)
    cr = 200 * std / size if size > 0 else np.inf
    i = 100 * insensitivity / size if size > 0 else np.inf
    misses = [word for word, bad in (("CR", cr > CRAMER_RAO), ("I", i > INSENSITIVITY)) if bad]
    return {
        "name": name, "value": float(value), "cramer_rao_percent": float(cr),
        "insensitivity_percent": float(i), "scatter": float(scatter), "misses": misses,
    }  # fmt: skip
