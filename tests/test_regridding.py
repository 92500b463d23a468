"""Channels at other instants: signals whose spectrum and samples are known."""

import numpy as np
import pytest

from casid import Record
from casid.regridding import regridded, resampled

T = 0.02 * np.arange(500)


def test_slower_sampling_keeps_what_it_can_hold_and_folds_nothing_back():
    # New Nyquist frequency 31 rad/s: 5 rad/s stays, 60 rad/s would come back as 2.8 rad/s.
    slow, fast = np.sin(5 * T), np.sin(60 * T)
    t, y = resampled(T, [(slow, "smooth"), (fast, "smooth")], 0.1)
    np.testing.assert_allclose(np.diff(t), 0.1)
    inside = slice(10, -10)
    np.testing.assert_allclose(y[inside, 0], np.sin(5 * t[inside]), atol=1e-3)
    assert np.abs(y[inside, 1]).max() < 0.01


@pytest.mark.parametrize("dt", [0.04, 0.05, 0.1])
def test_slower_sampling_makes_nothing_up_beside_lost_samples(dt):
    wave, lost = np.sin(5 * T), (T > 4.0) & (T < 5.0)
    t, y = resampled(T, [(np.where(lost, np.nan, wave), "smooth")], dt)
    there = ~np.isnan(y[:, 0])
    assert not there[(t > 4.0) & (t < 5.0)].any()
    assert there[(t < 4.0 - 2.1 * dt) | (t > 5.0 + 2.1 * dt)].all()
    there &= (t > 1.0) & (t < 9.0)
    # A tenth of the filter's weight, on a straight line that is a few per cent off nearby.
    np.testing.assert_allclose(y[there, 0], np.sin(5 * t[there]), atol=0.01)


@pytest.mark.parametrize("N", range(401, 406))
@pytest.mark.parametrize("jitter", [1e-6, 2e-4])
def test_stamps_that_jitter_cost_slower_sampling_no_instant(N, jitter):
    rng = np.random.default_rng(N)
    t = 0.005 * np.arange(N) + jitter * rng.uniform(-1, 1, N)
    wave = np.sin(5 * t)
    grid, y = resampled(t, [(wave, "foh"), (wave, "smooth"), (t, "smooth")], 0.01)
    assert t[-1] - grid[-1] < 0.01 + 1e-6
    assert np.isfinite(y).all()
    np.testing.assert_allclose(y[:, 2], grid, atol=1e-9)  # a line goes on to the last instant
    for column in y[:, :2].T:
        np.testing.assert_allclose(column[20:-20], np.sin(5 * grid[20:-20]), atol=2e-3)


@pytest.mark.parametrize("how", ["zoh", "foh", "smooth"])
@pytest.mark.parametrize("dt", [0.05, 0.06])
def test_what_rests_does_so_exactly_once_filtered(how, dt):
    moves = np.where((T > 4) & (T < 6), np.sin(np.pi * (T - 4)), 0.0)
    t, y = resampled(T, [(level + moves, how) for level in (0.0, 0.3, 1500.0)], dt)
    still = (t < 4 - 1.2) | (t > 6 + 1.2)  # the filter reaches 8 of the new intervals
    np.testing.assert_array_equal(y[still], np.tile([0.0, 0.3, 1500.0], (still.sum(), 1)))
    assert np.abs(y[~still, 0]).max() > 0.9


def test_a_slower_channel_is_measured_as_often_as_it_was():
    rng = np.random.default_rng(4)
    fast = 0.01 * np.arange(400)
    own = 0.123 + 0.04 * np.arange(80) + 1e-4 * rng.uniform(size=80)
    x = np.sin(own)
    x[30] = np.nan
    found = regridded(own, x, fast, "smooth", 0.01)
    seen = np.isfinite(found)
    assert seen.sum() == 79 - 1  # the spline has nothing beyond the first and last sample
    nearest = np.abs(fast[seen][:, None] - own).min(axis=1)
    assert nearest.max() < 0.0051
    np.testing.assert_allclose(found[seen], np.sin(fast[seen]), atol=1e-6)
    alike = regridded(own, np.sin(own), fast[::4], "smooth", 0.04)
    assert np.isfinite(alike[5:80]).all()  # nothing is lost


FAST = 0.01 * np.arange(2001)


def sampled_rarely(every, wave=FAST, lost=()):
    """Inputs and rates at 100 Hz, an attitude that is empty between its own samples."""
    phi = np.where(np.arange(len(FAST)) % every, np.nan, np.sin(wave))
    phi[list(lost)] = np.nan
    y = np.column_stack([np.cos(FAST), phi])
    return Record(FAST, np.sin(2 * FAST)[:, None], y, ("lat",), ("p", "phi"))


@pytest.mark.parametrize("every", [4, 5, 10])
@pytest.mark.parametrize("dt", [0.005, 0.012, 0.02, 0.03, 0.04])
def test_a_slower_channel_is_not_measured_more_often_once_resampled(every, dt):
    slow = sampled_rarely(every).resample(dt)
    own = FAST[::every]
    found = np.flatnonzero(np.isfinite(slow.channel("phi")))
    assert len(own) - 1 <= len(found) <= len(own)  # the last may lie beyond the last instant
    off = np.abs(slow.t[found][:, None] - own)
    assert off.min(axis=1).max() <= dt / 2 + 1e-9
    assert len(set(off.argmin(axis=1))) == len(found)  # each its own sample's
    np.testing.assert_allclose(slow.channel("phi")[found], np.sin(slow.t[found]), atol=2e-3)
    assert np.isfinite(slow.channel("p")).all()
    np.testing.assert_allclose(slow.channel("lat")[20:-20], np.sin(2 * slow.t[20:-20]), atol=5e-4)


def test_a_channel_sampled_slower_than_it_was_is_filtered_and_whole():
    # Every 0.1 s 9 Hz would come back as 1 Hz; of 0.5 Hz nothing is lost.
    fast, slow = (
        sampled_rarely(5, 2 * np.pi * f * FAST, range(800, 900)).resample(0.1) for f in (9.0, 0.5)
    )
    beside = (slow.t > 1) & (slow.t < 19) & ((slow.t < 7.5) | (slow.t > 9.5))
    assert np.abs(fast.channel("phi")[beside]).max() < 0.02
    np.testing.assert_allclose(
        slow.channel("phi")[beside], np.sin(np.pi * slow.t[beside]), atol=2e-3
    )
    assert np.isnan(slow.channel("phi")[(slow.t > 8.0) & (slow.t < 8.99)]).all()


def amplitude(t, x, f):
    """Of a sine of f [Hz] in samples of whole seconds, by its Fourier coefficient."""
    return 2 * np.abs(np.mean(x * np.exp(-2j * np.pi * f * t)))


@pytest.mark.parametrize("rate", [400, 80])
def test_what_shakes_a_faster_logger_is_not_folded_back_by_a_join(rate):
    # At 50 Hz 47 Hz would come back as 3 Hz, and 35 Hz as 15 Hz.
    f, folded = (47.0, 3.0) if rate == 400 else (35.0, 15.0)
    slow, fast = np.arange(0, 20, 0.02), np.arange(-0.5, 20.5, 1 / rate)
    shaken = 2.0 * np.sin(2 * np.pi * f * fast)
    az = shaken + np.sin(2 * np.pi * fast)
    first = Record(slow, np.sin(slow)[:, None], np.cos(slow)[:, None], ("lat",), ("p",))
    stick = np.cos(fast) + shaken
    second = Record(fast, stick[:, None], az[:, None], ("lon",), ("az",))
    both = first.join(second)
    np.testing.assert_array_equal(both.t, first.t)
    for name, kept in (("az", np.sin(2 * np.pi * slow)), ("lon", np.cos(slow))):
        x = both.channel(name)
        assert amplitude(slow, x, folded) < 0.05
        np.testing.assert_allclose(x, kept, atol=0.05)


def test_steps_of_a_faster_logger_and_an_equal_one_are_read_as_they_are():
    rng = np.random.default_rng(2)
    fast = np.arange(0, 20, 0.0025)
    steps = np.repeat(rng.standard_normal(200), 40)  # which begin on instants of the record
    slow = np.arange(0, 19.9, 0.02)
    first = Record(slow, np.zeros((len(slow), 0)), np.cos(slow)[:, None], (), ("p",), hold="zoh")
    second = Record(fast, steps[:, None], np.zeros((len(fast), 0)), ("lat",), (), hold="zoh")
    np.testing.assert_array_equal(first.join(second).u[:, 0], steps[: 8 * len(slow) : 8])
    rough = rng.standard_normal(len(slow))[:, None]
    equal = Record(slow, np.zeros((len(slow), 0)), rough, (), ("q",))
    np.testing.assert_allclose(first.join(equal).channel("q"), rough[:, 0], atol=1e-12)


def test_a_slow_channel_of_a_faster_logger_stays_as_rare_as_it_was():
    fast, slow = np.arange(0, 20, 0.0025), np.arange(0, 19.9, 0.02)
    x = np.where(np.arange(len(fast)) % 10, np.nan, np.sin(fast))  # 40 Hz
    first = Record(slow, np.sin(slow)[:, None], np.cos(slow)[:, None], ("lat",), ("p",))
    second = Record(fast, np.zeros((len(fast), 0)), x[:, None], (), ("phi",))
    phi = first.join(second).channel("phi")
    there = np.isfinite(phi)
    assert there.sum() == pytest.approx(0.8 * len(slow), abs=1)
    np.testing.assert_allclose(phi[there], np.sin(slow[there]), atol=2e-3)
