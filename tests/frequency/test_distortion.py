"""Noise and nonlinear distortion told apart by two amplitudes."""

from dataclasses import replace

import numpy as np
import pytest

from casid import FrequencyResponse, Record, distortion, frequency_response
from casid.frequency.distortion import TOGETHER, _difference
from casid.frequency.response import FED_BACK

OMEGA = np.geomspace(1.0, 12.0, 20)
DT = 0.04


def swept(rng, size, damping, noise):
    """A sweep of p' = -2 p - c p abs(p) - 0.3 phi + 20 lat, noise on p and phi."""
    t = DT * np.arange(1751)
    rate = np.log(50)
    phase = 0.3 * 62 / rate * (np.exp(rate * np.clip(t - 3, 0, 62) / 62) - 1)
    u = size * np.clip(np.minimum((t - 3) / 5, (65 - t) / 3), 0, 1) * np.sin(phase)
    y, x = np.zeros((len(t), 2)), np.zeros(2)

    def slope(x, u):
        return np.array([-2 * x[0] - damping * x[0] * abs(x[0]) - 0.3 * x[1] + 20 * u, x[0]])

    for n in range(len(t) - 1):
        middle = (u[n] + u[n + 1]) / 2
        first = slope(x, u[n])
        second = slope(x + DT / 2 * first, middle)
        third = slope(x + DT / 2 * second, middle)
        fourth = slope(x + DT * third, u[n + 1])
        x = x + DT / 6 * (first + 2 * second + 2 * third + fourth)
        y[n + 1] = x
    y += noise * rng.standard_normal(y.shape)
    return Record(t, u[:, None], y, ("lat",), ("p", "phi"), f"size {size}")


def flown(seed, damping, sizes=(0.03, 0.03, 0.06, 0.06), noise=0.003):
    rng = np.random.default_rng(seed)
    return [swept(rng, size, damping, noise) for size in sizes]


@pytest.mark.parametrize(
    "runs", [pytest.param(4, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.campaign)]
)
def test_noise_raises_no_alarm(runs):
    found = [distortion(flown([seed, 40], 0.0, (0.03, 0.06)), omega=OMEGA) for seed in range(runs)]
    assert not any(each.nonlinear for each in found)
    assert "no more than noise" in found[0].sentence()
    # Of a unit error; neighbours' errors are modelled as alike, which they are to a tenth or so.
    assert 0.6 < np.mean([each.excess for each in found]) < 2.0


@pytest.mark.campaign
def test_damping_that_grows_with_rate_is_told_from_noise_and_sized():
    low, shares = OMEGA < 4.0, []
    for seed in (1, 2, 3):
        told = distortion(flown(seed, 0.5), omega=OMEGA)
        assert told.nonlinear
        assert "depends on amplitude" in told.sentence()
        assert told.large / told.small == pytest.approx(2.0, rel=0.01)
        # Without noise the same flights differ by what is nonlinear alone, of three frequencies.
        flights = flown(seed, 0.5, noise=1e-7)
        small, large = (
            frequency_response(flights[at], omega=OMEGA).G for at in (slice(2), slice(2, 4))
        )
        away = 2 * np.abs((large - small) / (large + small))
        padded = np.pad(away**2, ((1, 1), (0, 0), (0, 0)), mode="edge")
        away = np.sqrt((padded[:-2] + padded[1:-1] + padded[2:]) / 3)
        shares.append(np.median(told.distortion[low], axis=0) / np.median(away[low], axis=0))
        assert np.median(told.noise[low] / away[low]) < 0.3
    np.testing.assert_allclose(np.median(shares, axis=0), 1.0, rtol=0.15)


@pytest.mark.slow
def test_a_gain_that_changes_by_less_than_any_point_shows_is_told():
    # Damping that grows by 0.12 |p|: alike over a band, by some seven of its standard errors.
    for seed in (1, 2, 3):
        told = distortion(flown([seed, 41], 0.12, (0.03, 0.06), noise=0.002), omega=OMEGA)
        assert np.nanmax(told.excess) < 3.5
        assert told.nonlinear
        none = distortion(flown([seed, 41], 0.0, (0.03, 0.06), noise=0.002), omega=OMEGA)
        assert not none.nonlinear
        assert "hides changes of a response's gain of less than" in none.sentence()


def test_a_gain_and_its_error_are_those_of_a_weighed_mean():
    # Independent points of one pair, of one relative error: the mean of their ratios.
    K, error, rng = 12, 0.05, np.random.default_rng(3)
    noise = error * (rng.standard_normal((2, K, 1, 1)) + 1j * rng.standard_normal((2, K, 1, 1)))
    omega, flat = np.geomspace(1, 8, K), np.ones((K, 1, 1))
    low, high = (
        FrequencyResponse(
            omega=omega, G=gain * flat + each, coherence=0.99 * flat, random_error=error * flat,
            inputs=("u",), outputs=("y",), input_std=np.ones(1), output_std=np.ones(1),
        )
        for gain, each in zip((1.0, 1.3), noise, strict=True)
    )  # fmt: skip
    _, _, together, least = _difference(low, high, np.ones((K, 1, 1), dtype=bool))
    mean, apart = (low.G + high.G) / 2, high.G - low.G
    std = error * np.sqrt(np.abs(low.G) ** 2 + np.abs(high.G) ** 2)
    size = np.sqrt(np.sum(np.abs(mean / std) ** 2))
    expected = np.abs(np.sum(mean.conj() * apart / std**2) / size) ** 2 / 2
    assert together[0, 0] == pytest.approx(expected, rel=0.3)  # rest of twelve may count more
    assert least[0, 0] == pytest.approx(np.sqrt(2 * TOGETHER) / size, rel=0.3)
    # Where noise is fed back what differs counts half, and a gain shows from √2 times as much on.
    fed = replace(low, flags={FED_BACK.format("u"): (0,)}), high
    _, plain, *_ = _difference(low, high, np.ones((K, 1, 1), dtype=bool))
    _, half, less, more = _difference(*fed, np.ones((K, 1, 1), dtype=bool))
    assert half == pytest.approx(plain / 2)
    assert less == pytest.approx(together / 2)
    assert more == pytest.approx(np.sqrt(2) * least)


def test_one_amplitude_is_refused_by_the_name_of_the_manoeuvre():
    with pytest.raises(
        ValueError, match=r"manoeuvre 'size 0.03' \(2 records .*1 times the smallest"
    ):
        distortion(flown(2, 0.0, (0.03, 0.03)), omega=OMEGA)
