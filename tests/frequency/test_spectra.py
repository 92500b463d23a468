"""Spectra and their composite against closed forms, textbooks and a general minimiser."""

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from truths.systems import DT, LAG, TWO, white

from casid import Record
from casid.frequency.spectra import (
    _weights_of_windows,
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


def test_power_of_records_shorter_than_a_window_is_not_kept():
    # White inputs have power by duration; windows of 40 s see nothing of the second record.
    rng, omega = np.random.default_rng(3), np.linspace(1.0, 20.0, 80)
    records = [white(LAG, rng, duration=duration) for duration in (120.0, 60.0, 30.0)]
    inside, beyond = (record_spectra(records, omega, length).kept for length in (20.0, 40.0))
    np.testing.assert_array_equal(inside, 1.0)
    assert np.all(beyond < 1)
    assert beyond.mean() == pytest.approx(180 / 210, abs=0.03)
