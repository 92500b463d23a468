"""Residuals on lines that follow the inputs."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from truths.closed_roll import NOISE, TRUTH, campaign, lag

from casid import DataWarning, output_error
from casid.shooting.independence import _bands, _of_output

FOLLOW = "residuals of .* follow the inputs"


def chance(rng, follows=0.0):
    """Of noise with a spectrum that falls off, beside two inputs, on 120 lines."""
    K = 120
    noise = rng.standard_normal((K, 3)) + 1j * rng.standard_normal((K, 3))
    U, omega = noise[:, 1:], 0.3 * np.arange(1, K + 1)
    E = noise[:, 0] / omega + follows * U[:, 0] / omega
    return _of_output(_bands(omega, 6), U, E, 10 * U[:, 0] / omega, 1 / omega, np.ones(K))


def test_chance_of_noise_is_what_it_says():
    found = np.array([chance(np.random.default_rng(seed)).chance for seed in range(400)])
    # A gamma distribution for a sum of unlike ones; binomial deviations are 0.025 and 0.011.
    assert np.mean(found < 0.5) == pytest.approx(0.5, abs=0.08)
    assert np.mean(found < 0.05) == pytest.approx(0.05, abs=0.035)


def test_what_follows_an_input_is_told_apart_from_noise():
    found = chance(np.random.default_rng(1), follows=2.0)
    assert found.chance < 1e-9
    assert found.share == pytest.approx(0.2, rel=0.15)


def sluggish(records, T_lag=0.15):
    """The records of an aircraft with actuators, by superposition: outputs lag as inputs do."""
    slow = [lag(each.t, each.y - each.y[0], T_lag) + each.y[0] for each in records]
    return [replace(each, y=y) for each, y in zip(records, slow, strict=True)]


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:.*rests on few lines")
def test_a_missing_lag_is_told():
    rng = np.random.default_rng(0)
    records = [each.with_noise(NOISE, rng) for each in sluggish(campaign())]
    with pytest.warns(DataWarning, match=FOLLOW):
        output_error(TRUTH, records, domain="frequency")


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("colour", [0.0, 0.5])
def test_noise_under_the_true_structure_is_not(colour):
    for seed in range(3):
        rng, noisy = np.random.default_rng(seed), []
        for each in campaign():
            white = rng.standard_normal((each.N, 3)) * [NOISE[name] for name in each.outputs]
            noisy.append(replace(each, y=each.y + lfilter([1], [1, -colour], white, axis=0)))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            output_error(TRUTH, noisy, domain="frequency")
        assert not [str(one.message) for one in told if "follow" in str(one.message)]
