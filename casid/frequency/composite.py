"""One set of spectra from several window lengths, by their random errors.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*),
chapter 10. Departure: the errors of the cross-spectrum are weighed relative to its magnitude, so
that the composite does not depend on where its phase happens to lie.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.frequency.spectra import Conditioned

FIELDS = ("Gxx", "Gxy", "Gyy", "random_error", "multiple_coherence", "condition")


def composite(parts: Sequence[Conditioned], usable: BoolArray, iterations: int = 8) -> Conditioned:
    """One set of spectra that explains those of all window lengths best, T&R chapter 10.

    Minimises per pair and frequency, by Gauss-Newton steps on all of them at once,

        Σ_w W_w [(Gxx/Gxx_w - 1)² + (Gyy/Gyy_w - 1)² + |Gxy - Gxy_w|²/|Gxy_w|² + 5 (γ²/γ_w² - 1)²],

    W_w = (ε_w / min ε)⁻⁴, over the ``usable`` windows (windows, K); NaN where there is none. The
    residuals are small and the start is their weighted mean, so that few iterations do.
    """
    stacked = {name: np.array([getattr(part, name) for part in parts]) for name in FIELDS}
    W = window_weights(stacked["random_error"], usable)  # (windows, K, ny, nu)
    means = {name: _mean(W, stacked[name]) for name in ("Gxx", "Gyy", "Gxy", "random_error")}
    # Relative to the weighted means: four unknowns of order one, the phase of the mean removed.
    a, b, z = (_relative(W, stacked[name], means[name]) for name in ("Gxx", "Gyy", "Gxy"))
    c = np.zeros((4, *W.shape[1:]))
    c[:3] = 1.0
    limits = np.array([0.1, 0.1, -9.0, -9.0])[:, None, None, None]
    for _ in range(iterations):
        c = np.clip(c - _step(c, np.sqrt(W), a, b, z), limits, 9.0)
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


def window_weights(error: Array, usable: BoolArray) -> Array:
    """W_w of every window length, adding up to one; zero where it may not be used."""
    known = np.where(np.isfinite(error), np.maximum(error, 1e-6), 1e6)
    trusted = np.where(usable[:, :, None, None], known, np.inf)
    best = trusted.min(axis=0)
    W = np.where(np.isfinite(trusted), (trusted / np.where(np.isfinite(best), best, 1)) ** -4.0, 0)
    total = W.sum(axis=0)
    return np.asarray(W / np.where(total > 0, total, 1.0))


def _step(c: Array, sw: Array, a: Array, b: Array, z: ComplexArray) -> Array:
    """Gauss-Newton step of the composite's four unknowns, (4, K, ny, nu)."""
    size = np.maximum(np.abs(z), 1e-12)
    gamma_w = np.maximum(size**2 / (a * b), 1e-12)
    gamma = (c[2] ** 2 + c[3] ** 2) / (c[0] * c[1])
    five = np.sqrt(5.0)
    real, imag = (c[2] - z.real) / size, (c[3] - z.imag) / size
    r = np.stack([c[0] / a - 1, c[1] / b - 1, real, imag, five * (gamma / gamma_w - 1)])
    J = np.zeros((5, 4, *z.shape))
    J[0, 0], J[1, 1], J[2, 2], J[3, 3] = 1 / a, 1 / b, 1 / size, 1 / size
    modulus = c[0] * c[1] * gamma_w / five
    J[4, 0], J[4, 1] = -five * gamma / gamma_w / c[0], -five * gamma / gamma_w / c[1]
    J[4, 2], J[4, 3] = 2 * c[2] / modulus, 2 * c[3] / modulus
    r, J = sw * r, sw * J
    H = np.einsum("rawkij,rbwkij->kijab", J, J)
    g = np.einsum("rawkij,rwkij->kija", J, r)
    H[~sw.any(axis=0)] = np.eye(4)
    return np.moveaxis(np.linalg.solve(H, g[..., None])[..., 0], -1, 0)
