"""Errors of the poles of a model by its modes, also where these nearly meet.

Poles part by the square root of what moves them: near a double one their own slopes grow beyond all
bounds, and B and C of the modes with them, so that models drawn from the errors of modes would be
no models near this one. The coefficients of ∏ (s - λ) over poles that may meet are regular there,
of two their sum and product: with errors to first order, which no parametrisation changes, they
are drawn as normal numbers, and their roots are poles.

Of poles nearer to each other than rounding lets modes tell, errors are those of a model in which
they are a little apart: in coordinates that are regular it is next to the given one.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.eigenmodes import NEAR, SAMPLES, deviations
from casid.subspace.modal import Modal

AGAINST = 0.5  # of the error of their gap: that of the sum of two that noise parts, at most
PAIR, REAL = 0.005, 0.015  # of their modulus: half the distance of poles that rounding lets tell


def parted(modal: Modal) -> Modal:
    """The model, or that next to it whose poles are far enough apart for its errors to be told."""
    lam, B, C = (each.astype(complex) for each in (modal.lam, modal.B, modal.C))
    for k in np.flatnonzero((lam.imag > 0) & (lam.imag < PAIR * np.abs(lam))):
        turn = np.exp(-0.5j * np.angle(np.sum(C[:, k] ** 2)))  # its C as real as can be
        b, c = B[k] / turn, C[:, k] * turn
        r = lam[k].imag / (PAIR * abs(lam[k]))
        if np.linalg.norm(c.imag) < r * np.linalg.norm(c.real):
            lam[k] = lam[k].real + 1j * lam[k].imag / r
            B[k], C[:, k] = b.real + 1j * r * b.imag, c.real + 1j * c.imag / r
    for pair in map(list, combinations(np.flatnonzero(modal.real), 2)):
        (one, other), mean = C[:, pair].real.T, lam[pair].mean()
        r = np.ptp(lam[pair].real) / max(2 * REAL * abs(mean), 1e-300)
        share = one @ other / max(other @ other, 1e-300)
        if not 0 < r < 1 or not share:
            continue
        size = np.array([1.0, share])
        c, b = C[:, pair] * size, B[pair] / size[:, None]  # alike in C
        c_mean, b_mean = c.mean(axis=1, keepdims=True), b.mean(axis=0)
        if np.linalg.norm(c[:, :1] - c_mean) < r * np.linalg.norm(c_mean):
            lam[pair] = mean + (lam[pair] - mean) / r
            B[pair], C[:, pair] = b_mean + r * (b - b_mean), c_mean + (c - c_mean) / r
    return replace(modal, lam=lam, B=B, C=C)


def pole_errors(
    lam: ComplexArray, around: ComplexArray, factor: ComplexArray
) -> tuple[Array, Array]:
    """Standard deviations of the real and imaginary parts of poles (nm,), Im >= 0.

    The ``factor`` (nm, rank + 1) times standard normal numbers moves them, to first order, where
    they are those ``around``, (nm,), of `parted`. Of poles that may be a pair or both real the
    errors are as in `casid.eigenmodes.deviations`, those of an imaginary part above 0 of a real
    one, too. Only these are along so flat a valley of the likelihood that steps towards its maximum
    may end far before it: the last column is what is left. All others have errors of first order.
    """
    own = factor[:, :-1]
    real, imag = np.linalg.norm(own.real, axis=1), np.linalg.norm(own.imag, axis=1)
    for group in _groups(around, own, lam != around):
        off = deviations(_drawn(lam[group], around[group], factor[group]), lam[group])
        if off[1].any():  # else none of them ever became a pair, or two real ones
            real[group], imag[group] = off[:2]
    return real, imag


def _groups(lam: ComplexArray, factor: ComplexArray, close: np.ndarray) -> list[np.ndarray]:
    """Modes that may meet one another, or of one pair, its own other half."""
    single = lam.imag == 0
    flat = single | close | (lam.imag < NEAR * np.linalg.norm(factor.imag, axis=1))
    apart, along = (
        np.linalg.norm(factor.real[:, None] + sign * factor.real, axis=-1) for sign in (-1, 1)
    )
    # Of two whose sum is known no better, one is vague and passes the other, which stays.
    met = np.abs(np.subtract.outer(lam.real, lam.real)) < NEAR * apart
    met &= along < AGAINST * apart
    met &= flat & flat[:, None]
    count, label = scipy.sparse.csgraph.connected_components(met, directed=False)
    groups = [np.flatnonzero((label == k) & flat) for k in range(count)]
    return [group for group in groups if len(group) > 1 or not single[group].all()]


def _drawn(lam: ComplexArray, around: ComplexArray, factor: ComplexArray) -> list[Array]:
    """Companion matrices of polynomials with roots λ, drawn from errors of roots around there."""
    pair = lam.imag > 0
    every, near, steps = (
        np.concatenate([each, each[pair].conj()]) for each in (lam, around, factor)
    )
    slopes = np.array([-np.poly(np.delete(near, k)) for k in range(len(near))])
    root = (slopes.T @ steps).real
    z = np.random.default_rng(0).standard_normal((root.shape[1], SAMPLES))
    coefficients = np.poly(every)[1:].real[:, None] + root @ z
    return [scipy.linalg.companion([1.0, *own]) for own in coefficients.T]
