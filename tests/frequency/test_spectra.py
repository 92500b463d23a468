"""Spectra and their composite against closed forms, textbooks and a general minimiser."""

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from truths.systems import DT, LAG, TWO, white

from casid import Record
from casid.frequency.spectra import (
    Conditioned,
    _blend,
    _weights_of_windows,
    composite,
    condition,
    record_spectra,
    transform,
)


def test_the_transform_gives_the_values_of_the_chirp_z_transform():
    x = np.random.default_rng(1).standard_normal((3, 200, 2))
    omega = np.linspace(0.5, 12.0, 23)
    edges = omega[[0, -1]] / (2 * np.pi)
    chirp = DT * scipy.signal.zoom_fft(x, edges, m=23, fs=1 / DT, endpoint=True, axis=1)
    np.testing.assert_allclose(transform(x, DT, omega), chirp, rtol=0, atol=1e-12)


def test_spectral_densities_add_up_to_the_variance():
    rng = np.random.default_rng(2)
    record = white(LAG, rng, duration=2000.0)
    omega = np.linspace(0.5, 30.0, 60)
    density = record_spectra([record], omega, 20.0).Guu[0, :, 0, 0].real
    # White noise of variance 1 has π/dt rad/s to spread over; 200 averages of 60 points.
    assert density.mean() == pytest.approx(DT / np.pi, rel=4 / np.sqrt(200 * 60))


def test_partial_coherence_is_that_of_the_textbook():
    """Of two inputs, from the conditioned spectra written out, T&R (9.22)."""
    record = white(TWO, np.random.default_rng(8), noise=0.3, mix=[[1.0, 0.0], [0.5, 1.0]])
    omega = np.geomspace(1.0, 8.0, 5)
    spectra = record_spectra([record], omega, 20.0)
    found = condition(spectra, conditioned=True)
    Guu, Guy, Gyy = spectra.Guu[0], spectra.Guy[0], spectra.Gyy[0]
    a, b = 0, 1
    between = np.abs(Guu[:, a, b]) ** 2 / (Guu[:, a, a] * Guu[:, b, b]).real
    for i in range(2):
        other = np.abs(Guy[:, b, i]) ** 2 / (Guu[:, b, b].real * Gyy[:, i])
        cross = Guy[:, a, i] - Guu[:, a, b] * Guy[:, b, i] / Guu[:, b, b]
        partial = np.abs(cross) ** 2 / (Guu[:, a, a].real * Gyy[:, i] * (1 - between) * (1 - other))
        np.testing.assert_allclose(found.coherence[:, i, a], partial, rtol=1e-9)


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


def test_a_window_counts_by_what_is_left_of_its_worst_output():
    lost = np.zeros((100, 2), dtype=bool)
    lost[3:7, 0] = lost[5, 1] = True  # windows of 40 samples from 0, 20, ...
    weights = _weights_of_windows(lost, 0.1, np.array([1.0, 12.0, 20.0]), 4.0)
    np.testing.assert_allclose(weights[0], [0.9, 0.9, 0.0])  # 0.4 s missing: up to 2π/0.4 rad/s
    np.testing.assert_allclose(weights[1:], 1.0)


def test_the_power_kept_is_that_of_the_windows_without_losses():
    t, omega = 0.05 * np.arange(4000), np.array([2.0])
    u = np.sin(2.0 * t)[:, None]
    whole = Record(t, u, u, ("u",), ("y",))
    lost = np.zeros((4000, 1), dtype=bool)
    lost[2000:2400] = True  # 20 s, several periods
    found, every = (record_spectra([whole], omega, 20.0, [x]) for x in (lost, lost & False))
    assert every.kept == 1.0
    assert 0.4 < found.kept < 0.9
    assert found.kept == pytest.approx(found.count / every.count, rel=0.01)  # all have one power


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
