"""Signals of a flight and their noise, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from truths.flights import NOISE, RATES, flight

from casid.consistency.kinematics import kinematic_check
from casid.consistency.measured import (
    Flight,
    coarse_step,
    looked_at,
    noisier,
    read_later,
    signals,
    strays,
    white_noise,
)


def test_noise_is_the_standard_deviation_of_what_is_not_smooth():
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(200_000)
    # Third differences of white noise have the variance 1 + 9 + 9 + 1 = 20; 200 000 correlated
    # squares give the standard deviation to 0.3 %, and the sine is 1e-5 of it.
    x = np.sin(t) + 0.1 * rng.standard_normal(len(t))
    assert white_noise(x) == pytest.approx(0.1, rel=0.01)


def test_records_too_short_to_look_at_are_no_error():
    short = flight(0, None, NOISE).take(slice(15))
    assert kinematic_check(short).channels == ()


def test_noise_is_not_that_of_a_few_outliers():
    rng = np.random.default_rng(0)
    x = np.sin(0.02 * np.arange(5000)) + 0.01 * rng.standard_normal(5000)
    x[rng.integers(0, 5000, 5)] += 0.5
    assert white_noise(x) == pytest.approx(0.01, rel=0.05)
    repeated = np.repeat(rng.standard_normal(500), 10)  # most differences are zero
    assert white_noise(repeated) > 0.1


def test_total_values_come_back_and_speed_becomes_velocities():
    record = flight(0)
    trimmed = record.detrend("first")
    whole = signals(trimmed, {})
    np.testing.assert_allclose(whole.values["theta"], record.channel("theta"), atol=1e-12)
    more = signals(trimmed, {"theta": 0.3}).values["theta"]
    np.testing.assert_allclose(more, record.channel("theta") + 0.3, atol=1e-12)
    u, v, w = (record.channel(name) for name in "uvw")
    V = np.sqrt(u**2 + v**2 + w**2)
    air = np.column_stack([V, np.arctan2(w, u), np.arcsin(v / V), record.channel("p")])
    seen = type(record)(record.t, record.u, air, ("lat",), ("V", "alpha", "beta", "p"))
    for name, true in zip("uvw", (u, v, w), strict=True):
        np.testing.assert_allclose(signals(seen, {}).values[name], true, atol=1e-9)
    assert "phi" not in signals(record.mask(np.ones(record.y.shape, dtype=bool)), {}).values


@pytest.mark.parametrize("skew", [0.0, 0.04, -0.04, 0.0533, -0.0071, 0.57, -0.57, 0.62, -0.64, 3.0])
def test_a_channel_is_read_later_on_its_spline_and_never_beyond_its_flight(skew):
    t = 0.02 * np.arange(31)
    spline = CubicSpline(t, np.random.default_rng(2).standard_normal(31))
    at = np.clip(t + skew, 0.0, t[-1])
    found, slope = read_later(spline.c, skew, 0.02)
    np.testing.assert_allclose(found, spline(at), atol=1e-11)
    np.testing.assert_allclose(slope, spline(at, 1), atol=1e-9)


def test_long_records_are_looked_at_in_part_and_short_pieces_not_at_all():
    record = flight(0)
    assert [(k, each.N) for k, each in looked_at([record.take(slice(10)), record])] == [
        (1, record.N)
    ]


def test_a_slow_channel_is_known_at_its_own_samples_and_noisy_there():
    record = flight(0, None, NOISE, (*RATES, "phi"))
    own = np.arange(record.N) % 4 == 1
    rare = record.mask(np.array([False] * 3 + [True]) & ~own[:, None])
    found = signals(rare, {"theta0": 0.06})
    np.testing.assert_array_equal(found.rows["phi"], np.flatnonzero(own))
    np.testing.assert_allclose(found.own("phi"), record.channel("phi")[own], atol=1e-12)
    assert (found.step("phi"), found.step("p")) == (4.0, 1.0)
    assert found.level == {"theta": 0.06}
    drawn = found.scatter(np.random.default_rng(0))["phi"]
    assert np.std(drawn[own]) == pytest.approx(NOISE["phi"], rel=0.15)
    np.testing.assert_allclose(drawn[3:-4:4], (drawn[1:-6:4] + drawn[5:-2:4]) / 2, atol=1e-12)


def test_noise_drawn_again_does_not_depend_on_the_order_in_which_channels_are_asked_for():
    rng = np.random.default_rng(1)
    whole = Flight(0.02, 0, {name: rng.standard_normal(200) for name in ("q", "p", "theta", "r")})
    one, other = (
        whole.only(names).scatter(np.random.default_rng(0)) for names in (["r", "p"], ["p", "r"])
    )
    assert list(one) == list(other) == ["p", "r"]
    for name, drawn in one.items():
        np.testing.assert_array_equal(drawn, other[name])


@pytest.mark.parametrize(
    ("step", "noise", "coarse"),
    [(1.0, 0.0, True), (1.0, 0.2, True), (1.0, 0.6, False), (0.1, 0.0, False)],
)
def test_steps_are_coarse_that_noise_does_not_blur_and_that_movement_does_not_hide(
    step, noise, coarse
):
    # Steps of 1 round by 0.29, a tenth of what moves here; noise of half a step whitens that.
    t, rng = 0.02 * np.arange(2000), np.random.default_rng(1)
    x = 4 * np.sin(0.7 * t) + noise * rng.standard_normal(2000)
    flight = Flight(0.02, 0, {"phi": step * np.round(x / step)})
    assert coarse_step([flight], "phi") == (pytest.approx(step) if coarse else 0.0)


def held(record, every, names):
    """The record with channels of a source that is slower by a factor, each sample repeated."""
    y, last = record.y.copy(), np.arange(record.N) // every * every
    columns = [record.outputs.index(name) for name in names]
    y[:, columns] = y[last][:, columns]
    return replace(record, y=y)


@pytest.mark.second
@pytest.mark.parametrize(("every", "seed"), [(5, 6), (10, 3)])
def test_steps_of_a_held_channel_are_no_outliers_and_an_outlier_is_one_as_long_as_it_is_held(
    every, seed
):
    whole = flight(seed, None, NOISE).cut(0.0, 30.0)
    still = replace(whole, u=0 * whole.u)  # its stick says nothing about how it moves
    sound = held(still, every, ("phi", "theta", "psi"))
    assert not strays(sound).any()
    phi, p = (sound.outputs.index(name) for name in ("phi", "p"))
    start = 60 * every
    y = sound.y.copy()
    y[start : start + every, phi] += 0.5
    y[100, p] += 1.0
    y[start + 2, phi] = np.nan
    wanted = np.zeros(y.shape, dtype=bool)
    wanted[start : start + every, phi] = wanted[100, p] = True
    wanted[start + 2, phi] = False
    np.testing.assert_array_equal(strays(replace(sound, y=y)), wanted)


def test_noise_that_is_added_leaves_no_products_of_two_channels():
    names = (*"pqr", "phi", "theta", "psi", "ax", "ay", "az", *"uvw")
    whole = Flight(0.02, 0, {name: np.random.default_rng(3).normal(size=40) for name in names})
    drawn = [flight.values for (flight,) in noisier([whole], np.random.default_rng(0))]
    more = np.array([[one[name][0] - whole.values[name][0] for name in names] for one in drawn])
    np.testing.assert_allclose(more.mean(axis=0), 0.0, atol=1e-12)
    products = more.T @ more
    products[5, 6] = products[6, 5] = 0.0  # psi and ax, which no equation has both
    np.testing.assert_allclose(products, np.diag(np.diag(products)), atol=1e-10)
