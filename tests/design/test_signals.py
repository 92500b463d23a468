"""Shapes of inputs: what they are by definition."""

import numpy as np
import pytest

from casid.design import signals

t = 0.05 * np.arange(401)


def test_a_3211_has_three_two_one_one_units_and_edges_as_slow_as_asked():
    one = signals.multistep(t, 2.0, 1.0, 0.1)
    middle = np.interp(2.5 + np.arange(8), t, one)
    np.testing.assert_allclose(middle, [1, 1, 1, -1, -1, 1, -1, 0], atol=1e-12)
    assert np.abs(np.diff(one)).max() <= 2 * 0.05 / 0.1 + 1e-9


def test_axes_take_turns_and_rest_before():
    for r in (
        signals.turns_of_3211(t, np.array([1.0, 0.5]), 2.0, 0.7, np.array([0.1, 0.1])),
        signals.turns_of_sweeps(t, np.array([1.0, 0.5]), 2.0, (1.0, 8.0)),
    ):
        assert not np.any(r[t < 2.0])
        assert not np.any((r[:, 0] != 0) & (r[:, 1] != 0))
        peaks = np.abs(r).max(axis=0)
        assert peaks[0] > 0.95
        assert 0.47 < peaks[1] <= 0.5


def test_3211_fill_the_time_with_axes_and_signs_taking_turns():
    long = 0.05 * np.arange(1201)  # 60 s less 2 s of rest: seven of 8 units of 1 s and a rise
    r = signals.turns_of_3211(long, np.array([1.0, 0.5]), 2.0, 1.0, np.array([0.1, 0.1]))
    starts = 2.0 + 58.0 / 7 * np.arange(7)
    first = np.array([np.interp(starts + 1.5, long, column) for column in r.T])
    np.testing.assert_allclose(first[0], [1, 0, -1, 0, 1, 0, -1], atol=1e-12)
    np.testing.assert_allclose(first[1], [0, 0.5, 0, -0.5, 0, 0.5, 0], atol=1e-12)
    assert not np.any(r[-1])


def test_harmonics_fill_the_band_and_waves_are_orthogonal():
    omega = signals.harmonics((1.0, 5.0), 18.0)
    np.testing.assert_allclose(omega * 18.0 / (2 * np.pi), np.arange(3, 15))
    family = signals.wave_family(t, 2.0, omega)[t >= 2.0][:-1]
    gram = family.T @ family
    np.testing.assert_allclose(gram, len(family) / 2 * np.eye(len(gram)), atol=1e-9)


def test_a_3211_that_has_too_little_time_is_shortened_to_its_turn():
    short = 0.02 * np.arange(501)  # two turns of 4.5 s after 1 s of rest, for 8 units of 2 s
    rise = np.array([0.02, 0.02])
    r = signals.turns_of_3211(short, np.array([1.0, 1.0]), 1.0, 2.0, rise, often=False)
    for k, column in enumerate(r.T):
        begin, unit = 1.0 + 4.5 * k, 0.9 * 4.5 / 7
        middle = np.interp(begin + unit * (np.arange(7) + 0.5), short, column)
        np.testing.assert_allclose(middle, [1, 1, 1, -1, -1, 1, -1], atol=1e-12)
        assert not np.any(column[(short > begin + 0.94 * 4.5) & (short < begin + 4.5)])


def test_sweeps_run_through_their_band_evenly_in_logarithm_and_are_faded():
    fine, band = 0.001 * np.arange(40_001), (0.5, 12.0)
    (r,) = signals.turns_of_sweeps(fine, np.array([2.0]), 0.0, band).T
    inside = r[1:-2]
    crossings = fine[1:-3][inside[:-1] * inside[1:] < 0]
    omega = np.pi / np.diff(crossings)  # half a period from one crossing to the next
    at = (crossings[1:] + crossings[:-1]) / 2
    expected = band[0] * (band[1] / band[0]) ** (at / fine[-1])
    # Half a period at the slow end is a tenth of the sweep's constant of 12.6 s.
    np.testing.assert_allclose(omega, expected, rtol=0.03)
    limit = 2.0 * np.minimum(1.0, np.minimum(fine / (0.08 * 40), (40 - fine) / (0.05 * 40)))
    assert np.all(np.abs(r) <= limit + 0.01)  # the last sample belongs to no turn
    assert np.abs(r).max() > 1.99
    early = fine <= 0.4  # an eighth of the fade
    phase = np.trapezoid(band[0] * (band[1] / band[0]) ** (fine[early] / 40), fine[early])
    assert r[early][-1] == pytest.approx(2.0 * np.sin(phase) / 8, rel=1e-2)


def test_a_taper_leaves_trim_and_comes_back_to_it_smoothly():
    shape = signals.taper(t, 2.0, 1.5)
    assert not np.any(shape[t <= 2.0])
    assert shape[-1] == 0.0
    inner = (t >= 3.5) & (t <= t[-1] - 1.5)
    np.testing.assert_array_equal(shape[inner], 1.0)
    assert np.diff(shape).max() <= 1.5 / 1.5 * (t[1] - t[0]) + 1e-12
    assert np.interp(2.75, t, shape) == pytest.approx(0.5, abs=1e-2)
