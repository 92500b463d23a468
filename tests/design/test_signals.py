"""Shapes of inputs: what they are by definition."""

import numpy as np

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
