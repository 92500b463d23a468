"""How far apart two frequency responses are in decibels and degrees: the cost J of T&R.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*),
section 11.2; for one pair, over its n_ω frequencies,

    J = 20/n_ω Σ W_γ [W_g Δ² + W_p Δφ²],    W_γ = [1.58 (1 - exp(-γ²))]²,  W_g = 1,  W_p = 0.01745,

with Δ in dB, Δφ in degrees, wrapped, and γ² the coherence (not squared once more).
"""

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray

POINTS = 20.0  # to which T&R normalise the number of frequencies
DB = 20 / np.log(10)  # dB per neper
DEG = 180 / np.pi
PHASE = 0.01745  # W_p: 1 dB weighs as much as 7.57 degrees

GOOD = 100.0  # J below which T&R call a model satisfactory, and 50 nearly indistinguishable


def coherence_weight(coherence: Array) -> Array:
    """W_γ, in [0, 1]; the coherence is γ²."""
    return np.asarray((1.58 * (1 - np.exp(-coherence))) ** 2)


def log_ratio(G: ComplexArray, measured: ComplexArray) -> ComplexArray:
    """ln(G/measured): gain difference in nepers and phase difference in rad, wrapped to ±π."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(G / measured))


def residuals(G: ComplexArray, measured: ComplexArray, weight: Array) -> Array:
    """Weighted gain and phase errors whose squares add up to J, (2, ...).

    Parameters
    ----------
    G, measured : (...) complex array
        Model and measurement.
    weight : (...) array
        W_γ 20/n_ω; zero leaves a point out.
    """
    used = weight > 0
    ratio = np.where(used, G, 1) / np.where(used, measured, 1)
    difference = log_ratio(ratio.astype(complex), np.ones(ratio.shape, dtype=complex))
    root = np.sqrt(weight)
    return np.stack([
        root * DB * difference.real, root * np.sqrt(PHASE) * DEG * difference.imag
    ])  # fmt: skip


def pair_weights(coherence: Array, used: BoolArray) -> Array:
    """W_γ 20/n_ω of every point, (K, ...); n_ω counts the points used of each pair."""
    count = np.maximum(used.sum(axis=0), 1)
    return np.where(used, coherence_weight(np.where(used, coherence, 0.0)) * POINTS / count, 0.0)
