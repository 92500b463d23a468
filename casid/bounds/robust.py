"""Tests of what is held, right also where residuals are correlated or the structure is not all.

Holding combinations A λ of the parameters raises a likelihood's cost by half of Σ w_i χ²_i, one
degree of freedom each, with w the eigenvalues of (A P Aᵀ)⁻¹ A V Aᵀ, P the inverse information and V
the covariance that the estimates really have (J. T. Kent, Biometrika 69(1), 1982). They are 1 where
residuals are white and the structure is true, n/(n - p) where R comes from those residuals.
"""

import numpy as np
import scipy

from casid.arrays import Array
from casid.fit import AnyFit
from casid.shooting.precision import OutputErrorNotes

SMALLEST = 1e-9  # variance of a direction that is held already, of the largest


def weights(fit: AnyFit, A: Array) -> Array:
    """The w of combinations A (m, nf) of the free parameters; none of those held already.

    Empty for a fit without a likelihood, or with parameters that it does not determine.
    """
    root, V = _whitener(fit, A)
    return np.linalg.eigvalsh(root.T @ V @ root)


def p_value(statistic: float, w: Array) -> float:
    """Probability that Σ w_i χ²_i exceeds the statistic.

    By χ² with mean and variance adjusted (A. Satorra, P. M. Bentler, in: Latent Variables Analysis,
    1994, section 16.3), which is exact where all w are equal.
    """
    if not len(w):
        return 1.0
    scale = float(w @ w / w.sum())
    return float(scipy.special.chdtrc(w.sum() / scale, statistic / scale))


def price_p_values(fit: AnyFit, A: Array, prices: Array) -> Array:
    """Probabilities (m,) of multipliers this far from 0 if the data did not mind what is held.

    ``prices`` (m,) are those of combinations A held on their own in the fit's place. NaN where the
    fit says nothing of them.
    """
    root, V = _whitener(fit, A)
    inverse = root @ root.T  # of A P Aᵀ
    variance = np.diag(inverse @ V @ inverse)
    z = np.abs(prices) / np.sqrt(np.where(variance > 0, variance, np.nan))
    return np.asarray(2 * scipy.special.ndtr(-z))


def _whitener(fit: AnyFit, A: Array) -> tuple[Array, Array]:
    """T (m, k), so that Tᵀ A P Aᵀ T = I in the directions that are free, and A V Aᵀ (m, m)."""
    nothing = np.zeros((len(A), 0)), np.zeros((len(A), len(A)))
    if not isinstance(fit.notes, OutputErrorNotes) or fit.covariance is None or not len(A):
        return nothing
    P, V = fit.notes.cramer_rao, fit.covariance
    if not (np.isfinite(P).all() and np.isfinite(V).all()):
        return nothing
    sizes = np.linalg.norm(A * np.sqrt(np.diag(P)), axis=1)
    least = [fit[name].insensitivity for name in fit.free_names]  # infinite of one without effect
    alone = np.linalg.norm(np.multiply(A, least, out=np.zeros(A.shape), where=A != 0), axis=1)
    # A parameter on its bound has the variance of a rounding: as nothing beside that with all
    # others known, which is the least one that moves can have but for ties.
    unit = 1 / np.where(sizes > SMALLEST * np.nan_to_num(alone), sizes, np.inf)
    values, vectors = np.linalg.eigh(A @ P @ A.T * np.outer(unit, unit))
    free = values > SMALLEST * max(values.max(), SMALLEST)
    return unit[:, None] * vectors[:, free] / np.sqrt(values[free]), A @ V @ A.T
