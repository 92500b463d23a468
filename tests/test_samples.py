"""Channels at other instants against the signals they were sampled from."""

from contextlib import nullcontext

import numpy as np
import pytest
import scipy

from casid import Record
from casid.errors import DataWarning
from casid.samples import (
    _begun,
    at_instants,
    bursts,
    off_rest,
    resting,
    runs,
    tidied,
    unwrapped,
    usual_interval,
)

T = 0.02 * np.arange(500)


def test_a_spline_follows_a_smooth_signal_and_steps_and_lines_do_what_they_say():
    at = np.array([1.0, 1.005, 1.013])
    x = np.sin(3 * T)
    # A cubic spline errs by 5/384 h⁴ times the fourth derivative, 1.7e-7.
    np.testing.assert_allclose(at_instants(T, x, at, "smooth"), np.sin(3 * at), atol=3e-7)
    np.testing.assert_allclose(at_instants(T, 2 * T, at, "foh"), 2 * at, atol=1e-12)
    np.testing.assert_array_equal(at_instants(T, 50 * T, at, "zoh"), [50, 50, 50])
    assert at_instants(T, T, T[[-1]], "zoh") == T[-1]


def test_a_spline_rests_where_the_channel_does_and_is_as_it_was_elsewhere():
    x = 0.3 + np.where((T > 4) & (T < 6), np.sin(np.pi * (T - 4)), 0.0)
    at = T[:-1] + 0.007
    free = scipy.interpolate.make_interp_spline(T, x, k=3)(at)
    found = at_instants(T, x, at, "smooth")
    still = (at < 3.6) | (at > 6.4)  # a trace is 0.27 times as large a sample on
    assert (found[still] == 0.3).all()
    assert (free[still] != 0.3).any()
    np.testing.assert_allclose(found, free, rtol=0, atol=1.3e-9)
    np.testing.assert_array_equal(found[(at > 4) & (at < 6)], free[(at > 4) & (at < 6)])


def test_what_was_not_measured_is_not_made_up_but_a_rare_channel_is_no_gap():
    x = np.sin(T)
    x[np.arange(500) % 4 > 0] = np.nan  # a quarter of the rate
    assert np.isfinite(at_instants(T, x, T[:497], "smooth")).all()
    x[200:240] = np.nan
    found = at_instants(T, x, T, "smooth")
    assert np.isnan(found[197:240]).all()
    np.testing.assert_allclose(found[[196, 240]], np.sin(T[[196, 240]]), atol=1e-12)
    assert np.isnan(at_instants(T, np.sin(T), np.array([-0.1, 10.1]), "foh")).all()
    assert np.isnan(at_instants(T, np.full(500, np.nan), T, "smooth")).all()


def test_the_usual_interval_is_the_median_unless_sampling_is_irregular():
    assert usual_interval(np.delete(T, [50, 51, 52])) == pytest.approx(0.02)
    t = np.cumsum(np.where(np.arange(100) % 5, 0.01, 0.03))
    assert usual_interval(t) == pytest.approx(0.03)


def test_runs_are_told_at_both_ends_and_of_one_sample():
    assert runs(np.array([1, 0, 1, 1, 0, 0, 1], dtype=bool)).tolist() == [[0, 1], [2, 4], [6, 7]]
    assert runs(np.zeros(3, dtype=bool)).shape == runs(np.zeros(0, dtype=bool)).shape == (0, 2)


def test_noisy_inputs_leave_their_rest_each_by_itself():
    u = 0.01 * np.random.default_rng(0).standard_normal((300, 2))
    u[90:, 0] += 1.0
    u[60:150, 1] += 2.0
    away = off_rest(u)
    np.testing.assert_array_equal(away[:, 0], np.arange(300) >= 90)
    np.testing.assert_array_equal(away[:, 1], (np.arange(300) >= 60) & (np.arange(300) < 150))
    assert resting(u) == 60
    assert resting(u[:, :1]) == 90
    assert resting(u[:50]) == 50


@pytest.mark.parametrize(("first", "begun"), [(80, 200), (105, 105)])
def test_a_channel_that_wanders_all_along_begins_where_it_is_found_away(first, begun):
    x = np.tile([1.0, -1.0], 150)
    x[first:] = 6.0
    x[120:] = 20.0
    x[200:] = 500.0
    assert _begun(x, 200) == begun


@pytest.mark.parametrize("turn", [2 * np.pi, 360.0])
def test_an_angle_kept_within_a_turn_goes_on_also_where_it_passes_the_edge_to_and_fro(turn):
    rng = np.random.default_rng(0)
    for true in (np.linspace(0.4, 2.7, 500), 0.5 + 0.02 * np.sin(T) + 0.002 * rng.normal(size=500)):
        x = turn * np.where(rng.random(500) < 0.1, np.nan, true)
        found = unwrapped((x + turn / 2) % turn - turn / 2)
        off = (found - x)[np.isfinite(x)] / turn
        np.testing.assert_allclose(off, np.round(off[0]), atol=1e-12)


def test_noise_outliers_and_steps_are_no_angles():
    rng = np.random.default_rng(1)
    outlier = 0.05 * rng.standard_normal(500)
    outlier[200] = 6.0
    noise = rng.standard_normal(500)
    steps = np.where(np.sin(T) > 0, 5.5, 0.0) + 0.01 * rng.standard_normal(500)
    for x in (outlier, noise * 6.2 / np.ptp(noise), steps, np.sin(T), np.full(500, np.nan)):
        assert unwrapped(x) is None


def test_a_channel_that_drops_out_to_zero_beside_a_turn_is_no_angle():
    rng = np.random.default_rng(2)
    speed = np.clip(5.98 + 0.1 * rng.standard_normal(500), 5.7, 6.25)
    speed[200:240], speed[[199, 240]] = 0.0, 6.15
    assert unwrapped(speed + np.where(speed == 0, 0.01 * rng.uniform(size=500), 0)) is not None
    assert unwrapped(speed) is None
    heading = np.round(np.linspace(350.0, 370.0, 500) + np.sin(40 * T)) % 360.0  # whole degrees
    assert np.ptp(unwrapped(heading)) < 30
    turned = 2.9 + 0.02 * np.arange(500)
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    for name, goes_on in (("course", True), ("w", False)):  # a name may say what it is
        with nullcontext() if not goes_on else pytest.warns(DataWarning, match="course jumps"):
            y = tidied("turn", T, T[:, None], turned[:, None], (name,))[2]
        assert np.array_equal(y[:, 0], turned) is not goes_on


def test_runs_are_what_follows_closely_and_single_ones_are_none():
    t = 0.02 * np.array([3, 40, 41, 42, 44, 47, 90, 91, 92])
    assert bursts(t, 0.02) == [(pytest.approx(0.8), pytest.approx(0.94), 5)]
    assert bursts((), 0.02) == []


@pytest.mark.parametrize("begins", [0.0, 1780358400.0])
@pytest.mark.parametrize("times", [np.repeat([1, 2], [200, 100]), 2, 3])
def test_rows_written_twice_are_the_record_without_them(begins, times):
    t = begins + 0.01 * np.arange(300)
    x = np.sin(3 * (t - begins))[:, None]
    rows = np.repeat(np.arange(300), times)
    told = rf"{len(rows) - 300} of {len(rows)} samples follow the one before"
    with pytest.warns(DataWarning, match=told):
        found = Record(t[rows], x[rows], x[rows], ("lat",), ("p",), "twice")
    np.testing.assert_array_equal(found.t, t)
    np.testing.assert_array_equal(found.y, x)


def test_rows_of_several_sensors_at_one_instant_are_one_sample():
    t = np.repeat(0.01 * np.arange(100), 3)
    y = np.full((300, 3), np.nan)
    for i in range(3):
        y[i::3, i] = np.arange(100) + i
    with pytest.warns(DataWarning, match="200 of 300 samples"):
        found = Record(t, np.zeros((300, 0)), y, (), ("p", "q", "r"))
    np.testing.assert_array_equal(found.y, np.arange(100)[:, None] + [0, 1, 2])


def test_of_a_few_samples_at_one_instant_the_first_is_kept_and_of_many_time_is_doubted():
    t, x = 0.01 * np.arange(200), np.sin(0.1 * np.arange(200))[:, None]
    few = t.copy()
    few[50::50] = t[49::50][:3]
    with pytest.warns(
        DataWarning, match=r"3 of 200 samples .*rows 50, 100, 150, the first at 0.49 s"
    ):
        found = Record(few, x, x, ("lat",), ("p",))
    np.testing.assert_array_equal(found.y, np.delete(x, [50, 100, 150], axis=0))
    with pytest.raises(
        ValueError, match=r"sample 1 \(1780358400.5 s, then 1780358400.5 s\).*100 s"
    ):
        Record(1780358400.5 + np.floor(t / 0.02) * 0.02, x, x, ("lat",), ("p",))
    with pytest.raises(ValueError, match="time does not increase at sample 1"):
        Record(np.zeros(2), np.zeros((2, 1)), np.zeros((2, 1)), ("lat",), ("p",))
