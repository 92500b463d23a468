"""One set of spectra from several window lengths, by their random errors.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*),
chapter 10. Departures: the errors of the cross-spectrum are weighed relative to its magnitude, so
that the composite does not depend on where its phase happens to lie. Where a sweep begins or ends
long windows hold much less of it than short ones, and errors relative to little power count most:
windows with less than a quarter of what the most accurate one has are left out.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.frequency.spectra import Conditioned

FIELDS = ("Gxx", "Gxy", "Gyy", "random_error", "multiple_coherence", "condition")
STEPS = 60  # at most; five or six where windows hardly differ
DAMPING, RISE = 1e-3, 10.0  # of the first step; where a step fails, and back where it does not
SETTLED = 1e-10  # of the unknowns, relative, that the last step moves
FARTHEST = 3.0  # a step of a logarithm
LEAST = 0.25  # of the input's spectrum in the window of the least random error
TINY = 1e-12  # of a mean, the least size


def composite(parts: Sequence[Conditioned], usable: BoolArray) -> Conditioned:
    """One set of spectra that explains those of all window lengths best, T&R chapter 10.

    Minimises per pair and frequency, by damped Gauss-Newton steps on all of them at once,

        Σ_w W_w [(Gxx/Gxx_w - 1)² + (Gyy/Gyy_w - 1)² + |Gxy - Gxy_w|²/|Gxy_w|² + 5 (γ²/γ_w² - 1)²],

    W_w = (ε_w / min ε)⁻⁴, over the ``usable`` windows (windows, K); NaN where there is none. Inputs
    of windows of other records differ in power: what they say need not be nearly the same. Zero is
    W_w where Gxx_w is less than a quarter of that of the least ε.
    """
    stacked = {name: np.array([getattr(part, name) for part in parts]) for name in FIELDS}
    W = window_weights(parts, usable)  # (windows, K, ny, nu)
    means = {name: _mean(W, stacked[name]) for name in ("Gxx", "Gyy", "Gxy", "random_error")}
    # Relative to the weighted means: four unknowns of order one, the phase of the mean removed.
    a, b, z = (_relative(W, stacked[name], means[name]) for name in ("Gxx", "Gyy", "Gxy"))
    c = _minimised(W, a, b, z)
    none = ~np.asarray(usable.any(axis=0), dtype=bool)
    lost = np.where(none, np.nan, 1.0)
    multiple = _mean(W.mean(axis=3), stacked["multiple_coherence"])
    G = {name: lost[:, None, None] * value for name, value in means.items()}
    driven = [np.zeros(0) if part.driven is None else part.driven for part in parts]
    return Conditioned(
        Gxx=c[0] * G["Gxx"],
        Gyy=c[1] * G["Gyy"],
        Gxy=(c[2] + 1j * c[3]) * G["Gxy"],
        random_error=G["random_error"],
        multiple_coherence=lost[:, None] * multiple,
        condition=np.max(stacked["condition"], axis=0),
        output_correlation=_blend(W, [part.output_correlation for part in parts]),
        input_correlation=_blend(W, [part.input_correlation for part in parts]),
        driven=_mean(W.mean(axis=2), np.array(driven)) if driven[0].size else None,
    )


def _blend(W: Array, matrices: Sequence[ComplexArray | None]) -> ComplexArray | None:
    """Mean (K, n, n) over window lengths, of those that are used; none, uncorrelated."""
    if any(each is None for each in matrices):
        return None
    weight = W.mean(axis=(2, 3))
    weight = weight / np.maximum(weight.sum(axis=0), 1e-300)
    mean = np.einsum("wk,wkij->kij", weight, np.array(matrices))
    lost = ~np.isfinite(mean).all(axis=(1, 2)) | (weight.sum(axis=0) < 0.5)
    return np.where(lost[:, None, None], np.eye(mean.shape[1]), mean)


def _mean(W: Array, values: Any) -> Any:  # noqa: ANN401 - real or complex
    """Mean over window lengths with weights that add up to one."""
    return np.sum(np.where(W > 0, W * np.where(W > 0, values, 0), 0), axis=0)


def _relative(W: Array, values: Any, mean: Any) -> Any:  # noqa: ANN401 - real or complex
    """Values over their mean; one where they do not count."""
    counts = (W > 0) & (np.abs(mean) > 0)
    return np.where(counts, values, 1.0) / np.where(counts, mean, 1.0)


def window_weights(parts: Sequence[Conditioned], usable: BoolArray) -> Array:
    """W_w of every window length, adding up to one; zero where it may not be used."""
    error, power = (np.array([getattr(p, name) for p in parts]) for name in ("random_error", "Gxx"))
    known = np.where(np.isfinite(error), np.maximum(error, 1e-6), 1e6)
    trusted = np.where(usable[:, :, None, None], known, np.inf)
    best = trusted.min(axis=0)
    W = np.where(np.isfinite(trusted), (trusted / np.where(np.isfinite(best), best, 1)) ** -4.0, 0)
    most = np.take_along_axis(power, W.argmax(axis=0)[None], axis=0)
    W = np.where(power < LEAST * most, 0.0, W)
    total = W.sum(axis=0)
    return np.asarray(W / np.where(total > 0, total, 1.0))


def _minimised(W: Array, a: Array, b: Array, z: ComplexArray) -> Array:
    """The composite's four unknowns, (4, K, ny, nu): Gxx, Gyy and Gxy over their means.

    Levenberg's and Marquardt's steps in the logarithms of the densities, so that these stay
    positive, from where each term alone is least.
    """
    start = [_least(W, each, np.abs(each)) for each in (a, b)]
    cross = _least(W, z, np.abs(z))
    q = np.array([*np.log(start), cross.real, cross.imag])
    damping = np.full(q.shape[1:], DAMPING)
    r, J = _residuals(q, np.sqrt(W), a, b, z)
    for _ in range(STEPS):
        H = np.einsum("rawkij,rbwkij->kijab", J, J)
        g = np.einsum("rawkij,rwkij->kija", J, r)
        H[~W.any(axis=0)] = np.eye(4)
        H = H * (1 + damping[..., None, None] * np.eye(4))
        step = np.moveaxis(np.linalg.solve(H, g[..., None])[..., 0], -1, 0)
        tried = q - np.clip(step, -FARTHEST, FARTHEST)
        r_tried, J_tried = _residuals(tried, np.sqrt(W), a, b, z)
        better = np.sum(r_tried**2, axis=(0, 1)) <= np.sum(r**2, axis=(0, 1))
        q, r, J = (
            np.where(better, new, old) for new, old in ((tried, q), (r_tried, r), (J_tried, J))
        )
        damping = np.where(better, damping / RISE, damping * RISE)
        if np.all(np.abs(step) <= SETTLED * np.maximum(np.abs(q), 1)):
            break
    return np.array([*np.exp(q[:2]), *q[2:]])


def _least(W: Array, values: Any, size: Array) -> Any:  # noqa: ANN401 - real or complex
    """The c that minimises Σ W |c - value|²/size²."""
    weight = W / np.maximum(size, TINY) ** 2
    total = weight.sum(axis=0)
    return np.where(total > 0, np.sum(weight * values, axis=0) / np.maximum(total, TINY), 1.0)


def _residuals(q: Array, sw: Array, a: Array, b: Array, z: ComplexArray) -> tuple[Array, Array]:
    """Residuals (5, windows, K, ny, nu) of log Gxx, log Gyy and Gxy, times roots of the weights.

    And their derivatives, (5, 4, windows, K, ny, nu).
    """
    size = np.maximum(np.abs(z), TINY)
    Gxx, Gyy = np.exp(q[:2])
    gamma = np.sqrt(5.0) * (q[2] ** 2 + q[3] ** 2) / (Gxx * Gyy) * a * b / size**2
    slope = 2 * np.sqrt(5.0) / (Gxx * Gyy) * a * b / size**2
    real, imag = (q[2] - z.real) / size, (q[3] - z.imag) / size
    r = np.stack([Gxx / a - 1, Gyy / b - 1, real, imag, gamma - np.sqrt(5.0)])
    J = np.zeros((5, 4, *z.shape))
    J[0, 0], J[1, 1], J[2, 2], J[3, 3] = Gxx / a, Gyy / b, 1 / size, 1 / size
    J[4, 0], J[4, 1], J[4, 2], J[4, 3] = -gamma, -gamma, slope * q[2], slope * q[3]
    return sw * r, sw * J
