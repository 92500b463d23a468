"""Bias of windows against the true one, and against noise that is none."""

import numpy as np
import pytest
from truths.systems import LAG, white

from casid import Record, StateSpace, frequency_response
from casid.frequency.leakage import leakage
from casid.frequency.spectra import Conditioned

LIGHT = StateSpace([[0, 1], [-4, -0.4]], [[0], [4]], [[1, 0]], [[0]], None, ("u",), ("y",))


MANY = np.array([10.0])  # rad/s: 30 periods in 20 s


def swept(system, *, linear):
    """A sweep from 0.3 to 15 rad/s that begins and ends abruptly, without noise."""
    t = 0.02 * np.arange(3001)
    rate = np.log(15 / 0.3)
    phase = 0.3 * t + 14.7 * t**2 / 120 if linear else 18 / rate * np.expm1(rate * t / 60)
    u = np.sin(phase)[:, None]
    return Record(t, u, system.simulate(t, u), ("u",), ("y",), "sweep")


@pytest.mark.parametrize("system", [LAG, LIGHT], ids=["lag", "light damping"])
@pytest.mark.parametrize("linear", [True, False], ids=["linear", "logarithmic"])
def test_the_stated_error_of_a_noise_free_sweep_is_that_of_its_windows(system, linear):
    found = frequency_response(swept(system, linear=linear), method="windows")
    error = np.abs(found.G / system.response(found.omega) - 1)[:, 0, 0] / np.sqrt(2)
    score = error / found.error[:, 0, 0]
    assert np.sqrt(np.mean(score**2)) < 1.1
    assert score.max() < 3
    leaking = (error > 2 * found.random_error[:, 0, 0]) & (found.omega < 3.0)
    if linear:  # coherence of 0.99, 2 dB off: what windows leak is told as large as it is
        assert leaking.sum() > 4
        # Of 60 % of a response: what is stated has limits, as a logarithm's error has.
        assert 0.5 < np.sqrt(np.mean(score[leaking] ** 2)) < 1.2
    else:
        assert np.sqrt(np.mean(score**2)) > 0.5


@pytest.mark.second
@pytest.mark.parametrize("method", ["local", pytest.param("windows", marks=pytest.mark.campaign)])
def test_noise_is_not_taken_for_leakage(method):
    inflation, inside = [], []
    for seed in range(8):
        record = white(LAG, np.random.default_rng(seed), noise=0.5)
        found = frequency_response(record, omega=np.geomspace(0.7, 15, 30), method=method)
        inflation.append(found.error / found.random_error)
        gain = np.log(np.abs(found.G / LAG.response(found.omega)))
        inside.append(np.abs(gain) < 1.96 * found.error)
    assert np.median(inflation) < 1.15
    # 240 points, of which neighbours are alike: 0.95 ± 0.02.
    assert 0.91 < np.mean(inside) < 0.99


def windowed(lengths, bias):
    """What windows see of responses of 2 that are biased by ``bias(length)``, (1, 1, pairs)."""
    parts = []
    for length in lengths:
        G = 2.0 * (1 + np.reshape(bias(length), (1, 1, -1)))
        one = np.ones(G.shape)
        parts.append(
            Conditioned(Gxx=one, Gxy=G, Gyy=np.abs(G) ** 2, random_error=1e-9 * one,
                        multiple_coherence=np.ones((1, 1)), condition=np.ones(1))
        )  # fmt: skip
    return parts


def test_few_periods_are_taken_for_biased_by_one_over_the_length_and_all_pairs_alike():
    lengths = [10.0, 10 * np.sqrt(2)]
    parts = windowed(lengths, lambda length: np.array([0.0, 1.0, 1.0, 3.0]) / length)
    usable = np.array([[False], [True]])
    found = leakage(parts, usable, lengths, np.array([1.0]))[0, 0]  # 2.3 periods
    wanted = np.array([1.0, 1.0, 1.0, 3.0]) / lengths[1]
    np.testing.assert_allclose(found, wanted / (1 + np.array([0.1, 1, 1, 3]) * 0.07), rtol=0.1)
    many = leakage(parts, usable, lengths, MANY)[0, 0]
    np.testing.assert_allclose(many[1:], found[1:] / (1 + np.sqrt(2)), rtol=1e-9)
    assert many[0] == 0


def test_a_bias_that_falls_with_the_square_of_the_length_is_found_exactly():
    lengths, c = [10.0, 10 * np.sqrt(2), 20.0], 8.0 * np.exp(0.3j)
    parts = windowed(lengths, lambda length: c / length**2)
    for k in (1, 2):  # one window alone counts
        usable = (np.arange(3) == k)[:, None]
        bias = leakage(parts, usable, lengths, MANY).item()
        wanted = np.abs(c) / lengths[k] ** 2 / np.abs(1 + c / lengths[k] ** 2)
        assert bias == pytest.approx(wanted, rel=1e-6)
    assert leakage(parts[:1], usable[:1], lengths[:1], MANY).item() == 0.0
