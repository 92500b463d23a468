"""The cost in decibels and degrees against its definition."""

import numpy as np
import pytest

from casid.matching.mismatch import coherence_weight, pair_weights, residual_slopes, weighted_errors

G = np.array([2 - 1j, 0.3j, -1.5 + 0.1j, -0.2 - 4j] * 5).reshape(20, 1, 1)


def test_the_cost_is_that_of_the_definition():
    """Written out for one pair: 1 dB and 10 degrees off everywhere, coherence 0.7."""
    off = G * 10 ** (1 / 20) * np.exp(1j * np.radians(10))
    weight = pair_weights(np.full(G.shape, 0.7), np.ones(G.shape, dtype=bool))
    J = np.sum(weighted_errors(off, G, weight) ** 2)
    assert pytest.approx(20 * (1.58 * (1 - np.exp(-0.7))) ** 2 * (1 + 0.01745 * 100)) == J
    half = weighted_errors(off[:10], G[:10], pair_weights(np.full((10, 1, 1), 0.7), G[:10] != 0))
    assert np.sum(half**2) == pytest.approx(J)  # normalised to 20 points


def test_phase_differences_are_wrapped():
    G = np.exp(1j * np.radians([170.0, -170.0]))
    phase = weighted_errors(G[:1], G[1:], np.ones(1))[1]
    assert phase**2 == pytest.approx(0.01745 * 20**2, rel=1e-4)


def test_full_coherence_weighs_one():
    assert coherence_weight(np.array(1.0)) == pytest.approx(0.9975, abs=1e-3)


def test_slopes_are_those_of_differences():
    rng = np.random.default_rng(1)
    measured = rng.standard_normal((6, 2)) + 1j * rng.standard_normal((6, 2))
    weight = np.array([1.0, 0.0, 0.3, 2.0, 1.0, 0.5])[:, None] * np.ones(2)
    start, slope = measured * (1.2 + 0.3j), measured * (0.4 - 0.7j)
    h = 1e-6
    expected = (weighted_errors(start + h * slope, measured, weight)
                - weighted_errors(start - h * slope, measured, weight)) / (2 * h)  # fmt: skip
    found = residual_slopes(start, slope[None], measured, weight)[0]
    np.testing.assert_allclose(found, expected, atol=1e-8)
    assert not found[:, 1].any()


def test_a_response_that_vanishes_is_120_decibels_off():
    gain, phase = weighted_errors(np.zeros(1, dtype=complex), np.ones(1, dtype=complex), np.ones(1))
    assert gain[0] == pytest.approx(-120.0)
    assert phase[0] == 0.0
