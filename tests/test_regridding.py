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
