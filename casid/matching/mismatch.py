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
TURN = np.sqrt(PHASE) * DEG  # what a radian weighs beside `DB` for a neper
TINY = 1e-12  # of the squared gain ratio, keeps its logarithm finite where a response vanishes

GOOD = 100.0  # J below which T&R call a model satisfactory, and 50 nearly indistinguishable


def coherence_weight(coherence: Array) -> Array:
    """W_γ, in [0, 1], of a squared error; the coherence is γ²."""
    return np.asarray((1.58 * (1 - np.exp(-coherence))) ** 2)


def log_ratio(G: ComplexArray, measured: ComplexArray) -> ComplexArray:
    """ln(G/measured): gain difference in nepers and phase difference in rad, wrapped to ±π."""
    z = np.asarray(G / measured)
    return np.asarray(np.log(np.abs(z) ** 2 + TINY) / 2 + 1j * np.angle(z))


def weighted_errors(G: ComplexArray, measured: ComplexArray, weight: Array) -> Array:
    """Weighted gain and phase errors whose squares add up to J, (2, ...)."""
    # The weights W_γ 20/n_ω may be zero.
    used, root = weight > 0, np.sqrt(weight)
    e = log_ratio(np.where(used, G, 1), np.where(used, measured, 1))
    return np.stack([root * DB * e.real, root * TURN * e.imag])


def residual_slopes(G: ComplexArray, dG: ComplexArray, data: ComplexArray, weight: Array) -> Array:
    """Derivatives of `weighted_errors` from those of the model, ``dG`` (nf, ...); (nf, 2, ...)."""
    used, root = weight > 0, np.sqrt(weight)
    floor = TINY * np.abs(np.where(used, data, 1)) ** 2
    e = dG * np.where(used, root * np.conj(G) / (np.abs(G) ** 2 + floor), 0)
    found = np.stack([e.real, e.imag], axis=1)
    found[:, 0] *= DB
    found[:, 1] *= TURN
    return found


def pair_weights(coherence: Array, used: BoolArray) -> Array:
    """W_γ 20/n_ω of every point, (K, ...); n_ω counts the points used of each pair."""
    count = np.maximum(used.sum(axis=0), 1)
    return np.where(used, coherence_weight(np.where(used, coherence, 0.0)) * POINTS / count, 0.0)
