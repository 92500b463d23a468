"""Tests of what is held, right also where residuals are correlated or the structure is not all.

Holding combinations A λ of the parameters raises a likelihood's cost by half of Σ w_i χ²_i, one
degree of freedom each, with w the eigenvalues of (A P Aᵀ)⁻¹ A V Aᵀ, P the inverse information and V
the covariance that the estimates really have (J. T. Kent, Biometrika 69(1), 1982). They are 1 where
residuals are white and the structure is true, n/(n - p) where R comes from those residuals.

What a structure misses in one part of a manoeuvre it may make good in another, or miss alike in all
of it: how estimates scatter from flight to flight, no part of a record tells. One combination a is
therefore tested by the scores g_c of whole records c, where there are enough of them,

    aᵀ V a = Σ_c (aᵀ T (I - H_c)^-½ Tᵀ g_c)²,    P = T Tᵀ,    H_c = Tᵀ F_c T,    Σ_c H_c = I,

F_c the information of record c, and by Student's t of as many degrees of freedom as give that sum
its variance where residuals are white (R. M. Bell, D. F. McCaffrey, Survey Methodology 28(2),
2002; J. E. Pustejovsky, E. Tipton, J. Business & Economic Statistics 36(4), 2018).
"""

import numpy as np
import scipy

from casid.arrays import Array
from casid.fit import AnyFit
from casid.shooting.precision import OutputErrorNotes
from casid.shooting.scores import left_out

SMALLEST = 1e-9  # variance of a direction that is held already, of the largest
ROUNDING = 1e-12  # of the variances in units of standard errors
ENOUGH = 2.0  # degrees of freedom: below, Student's t has no variance
FALSE = 0.05  # of parameters said to scatter, those that do by chance


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


def ratio_p_value(fit: AnyFit, A: Array, statistic: float) -> float:
    """Probability of a likelihood ratio this large if the data did not mind that A λ is held."""
    root, V = _whitener(fit, A)
    if root.shape[1] == 1:
        (variance,), (freedom,) = _by_records(fit, root.T @ A)
        if freedom >= ENOUGH:
            return 2 * float(scipy.special.stdtr(freedom, -np.sqrt(statistic / variance)))
    return p_value(statistic, np.linalg.eigvalsh(root.T @ V @ root))


def price_p_values(fit: AnyFit, A: Array, prices: Array) -> Array:
    """Probabilities (m,) of multipliers this far from 0 if the data did not mind what is held.

    ``prices`` (m,) are those of combinations A held on their own in the fit's place. NaN where the
    fit says nothing of them.
    """
    root, V = _whitener(fit, A)
    if root.shape == (1, 1):  # its price is what the ratio falls by
        return np.array([ratio_p_value(fit, A, float(prices[0] / root[0, 0]) ** 2)])
    inverse = root @ root.T  # of A P Aᵀ
    variance = np.diag(inverse @ V @ inverse)
    z = np.abs(prices) / np.sqrt(np.where(variance > 0, variance, np.nan))
    return np.asarray(2 * scipy.special.ndtr(-z))


def scattered(fit: AnyFit) -> dict[str, float]:
    """Parameters whose estimates scatter from record to record by more than their errors say.

    With how many times as much. One in twenty of those named, at most, is by chance (Y. Benjamini,
    Y. Hochberg, J. Royal Statistical Society B 57(1), 1995). None where errors allow for it, where
    too few records tell of a parameter, and of fits that do not know how records scatter.
    """
    notes = fit.notes
    if not isinstance(notes, OutputErrorNotes) or fit.covariance is None:
        return {}
    if notes.between_records.size or not len(notes.record_scores):
        return {}
    stated = np.diag(fit.covariance)
    told = _by_records(fit, np.eye(len(stated)))
    found = {}
    for name, own, variance, freedom in zip(fit.free_names, stated, *told, strict=True):
        if freedom >= ENOUGH and 0 < own < np.inf:
            chance = float(scipy.special.chdtrc(freedom, freedom * variance / own))
            found[name] = variance / own, chance
    order = sorted(found, key=lambda name: found[name][1])
    last = [k for k, name in enumerate(order, 1) if found[name][1] <= FALSE * k / len(order)]
    return {name: float(np.sqrt(found[name][0])) for name in order[: max(last, default=0)]}


def _by_records(fit: AnyFit, A: Array) -> tuple[Array, Array]:
    """Variances (m,) of combinations A (m, nf) by whole records, and degrees of freedom.

    0 of no records.
    """
    g, F = fit.notes.record_scores, fit.notes.record_information
    if not len(g):
        return np.zeros(len(A)), np.zeros(len(A))
    size = np.sqrt(np.diag(fit.notes.cramer_rao))
    unit = np.where(size > 0, size, 1.0)
    values, axes = np.linalg.eigh(fit.notes.cramer_rao / np.outer(unit, unit))
    known = values > ROUNDING * values.max()
    T = unit[:, None] * axes[:, known] * np.sqrt(values[known])  # P = T Tᵀ
    H = T.T @ F @ T
    b = np.array([A @ T @ left_out(share, 0.5) for share in H])  # (records, m, k)
    told = b @ H
    # Σ (b_cᵀ Tᵀ g_c)² is a quadratic form of white residuals, this its matrix but for rotations.
    form = -np.einsum("cmi,dmi->mcd", told, told)
    records = np.arange(len(g))
    form[:, records, records] += np.sum(b * told, axis=2).T
    size = np.sum(form**2, axis=(1, 2))
    freedom = np.trace(form, axis1=1, axis2=2) ** 2 / np.where(size > 0, size, np.inf)
    variance = np.sum(np.einsum("cmi,ci->cm", b, g @ T) ** 2, axis=0)
    return variance, freedom  # none of a record alone


def _whitener(fit: AnyFit, A: Array) -> tuple[Array, Array]:
    """T (m, k), so that Tᵀ A P Aᵀ T = I in the directions that are free, and A V Aᵀ (m, m)."""
    nothing = np.zeros((len(A), 0)), np.zeros((len(A), len(A)))
    if not isinstance(fit.notes, OutputErrorNotes) or fit.covariance is None or not len(A):
        return nothing
    P, V = fit.notes.cramer_rao, fit.notes.on_bounds(fit.covariance)
    if not (np.isfinite(P).all() and np.isfinite(V).all()):
        return nothing
    sizes = np.linalg.norm(A * np.sqrt(np.diag(P)), axis=1)
    least = [fit[name].insensitivity for name in fit.free_names]  # infinite of one without effect
    alone = np.linalg.norm(np.multiply(A, least, out=np.zeros(A.shape), where=A != 0), axis=1)
    # A parameter on its bound has the variance of a rounding: as nothing beside that with all
    # others known, which is the least one that moves can have but for ties.
    unit = 1 / np.where(sizes > SMALLEST * np.nan_to_num(alone), sizes, np.inf)
    values, vectors = np.linalg.eigh(A @ P @ A.T * np.outer(unit, unit))
    free = values > max(SMALLEST * values.max(), ROUNDING)
    return unit[:, None] * vectors[:, free] / np.sqrt(values[free]), A @ V @ A.T
