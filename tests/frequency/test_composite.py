"""The composite of several window lengths against a general minimiser."""

import numpy as np
import pytest
import scipy.optimize
from truths.systems import TWO, white

from casid.frequency.composite import _blend, composite
from casid.frequency.spectra import Conditioned, condition, record_spectra


def test_the_composite_minimises_its_cost():
    rng = np.random.default_rng(13)
    parts = []
    for _ in range(3):
        Gxx, Gyy = 1 + 0.2 * rng.standard_normal(), 2 + 0.3 * rng.standard_normal()
        Gxy = 1.1 * np.exp(0.5j) + 0.1 * rng.standard_normal() + 0.1j * rng.standard_normal()
        values = {"Gxx": Gxx, "Gxy": Gxy, "Gyy": Gyy, "random_error": 0.1 + 0.05 * rng.random()}
        pair = {name: np.full((1, 1, 1), value) for name, value in values.items()}
        parts.append(Conditioned(**pair, multiple_coherence=np.ones((1, 1)), condition=np.ones(1)))
    error = np.array([part.random_error.item() for part in parts])
    W = (error / error.min()) ** -4

    def cost(c):
        total, gamma = 0.0, (c[2] ** 2 + c[3] ** 2) / (c[0] * c[1])
        for weight, part in zip(W, parts, strict=True):
            z, own = part.Gxy.item(), part.coherence.item()
            total += weight * (
                (c[0] / part.Gxx.item() - 1) ** 2
                + (c[1] / part.Gyy.item() - 1) ** 2
                + abs(c[2] + 1j * c[3] - z) ** 2 / abs(z) ** 2
                + 5 * (gamma / own - 1) ** 2
            )
        return total

    best = scipy.optimize.minimize(cost, [1, 2, 1, 0.5], method="BFGS", options={"gtol": 1e-9})
    merged = composite(parts, np.ones((3, 1), dtype=bool))
    found = [merged.Gxx.item(), merged.Gyy.item(), merged.Gxy.item().real, merged.Gxy.item().imag]
    # Gauss-Newton on a small-residual problem: digits a step, BFGS stops at about 1e-6.
    np.testing.assert_allclose(found, best.x, rtol=1e-4)


def test_the_composite_of_one_window_is_that_window():
    record = white(TWO, np.random.default_rng(14), noise=0.3)
    part = condition(record_spectra([record], np.array([2.0, 5.0]), 20.0), conditioned=True)
    merged = composite([part], np.ones((1, 2), dtype=bool))
    for name in ("Gxx", "Gxy", "Gyy", "random_error", "multiple_coherence"):
        np.testing.assert_allclose(getattr(merged, name), getattr(part, name), rtol=1e-9)


def test_correlations_of_windows_are_blended_where_known_and_none_elsewhere():
    # Two lengths of two outputs at three frequencies: both used; one lost; neither used.
    one, other = (
        np.tile(np.array([[1.0, r], [r, 1.0]], dtype=complex), (3, 1, 1)) for r in (0.2, 0.6)
    )
    other[1] = np.nan
    W = np.zeros((2, 3, 2, 1))
    W[:, :2] = np.array([0.25, 0.75])[:, None, None, None]
    found = _blend(W, [one, other])
    np.testing.assert_allclose(found[0], [[1.0, 0.5], [0.5, 1.0]], rtol=1e-12)
    np.testing.assert_array_equal(found[1:], np.tile(np.eye(2), (2, 1, 1)))
    assert _blend(W, [one, None]) is None


@pytest.mark.parametrize("ratio", [1.0, 30.0, 1000.0])
def test_windows_of_unequal_power_that_say_the_same_are_not_contradicted(ratio):
    # Two lengths see other records: inputs of other power, one response and coherence.
    parts = []
    for Gxx in (1.0, ratio):
        pair = {"Gxx": Gxx, "Gxy": (2 - 1j) * Gxx, "Gyy": 5 / 0.98 * Gxx, "random_error": 0.1}
        pair = {name: np.full((1, 1, 1), value) for name, value in pair.items()}
        parts.append(Conditioned(**pair, multiple_coherence=np.ones((1, 1)), condition=np.ones(1)))
    merged = composite(parts, np.ones((2, 1), dtype=bool))
    assert merged.response.item() == pytest.approx(2 - 1j, rel=1e-6)
    assert merged.coherence.item() == pytest.approx(0.98, rel=1e-6)
