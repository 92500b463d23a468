"""Filters of noisy integrals, against a signal processing library and Riccati's equation."""

import numpy as np
import pytest
import scipy.linalg
import scipy.signal

from casid.consistency.innovations import _filtered, _low_pass, integral, steady_gain


def test_running_integrals_are_exact_for_straight_lines_and_of_fourth_order_inside():
    t = np.linspace(0.0, 2.0, 41)
    line = integral(np.column_stack([np.ones(41), 3 - 2 * t]), 0.05)
    np.testing.assert_allclose(line, np.column_stack([t, 3 * t - t**2]), atol=1e-13)
    errors = []
    for count in (41, 81):
        t = np.linspace(0.0, 2.0, count)
        found = integral(np.sin(3 * t)[:, None], t[1])[:, 0]
        inside = found - found[1] - (np.cos(3 * t[1]) - np.cos(3 * t)) / 3
        errors.append(np.abs(inside[1:-1]).max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.2)


def test_filters_are_those_of_a_signal_processing_library():
    rows = np.random.default_rng(0).standard_normal((3, 200))
    for dt in (0.01, 0.04):
        b, a = _low_pass(dt)
        np.testing.assert_allclose((b, a), scipy.signal.butter(2, 4.0, fs=1 / dt), atol=1e-14)
        b, a = np.convolve(b, [1.0, -1.0]), np.convolve(a, [1.0, -0.9])
        expected = scipy.signal.lfilter(b, a, rows)
        np.testing.assert_allclose(_filtered(b, a, rows), expected, atol=1e-13)
        np.testing.assert_allclose(_filtered(b, a, rows[:, :2]), expected[:, :2], atol=1e-13)


@pytest.mark.parametrize("ratio", [1e-4, 0.3, 20.0])
def test_the_least_gain_is_that_of_a_filter_of_a_random_walk(ratio):
    one = np.ones((1, 1))
    (P,) = scipy.linalg.solve_discrete_are(one, one, ratio * one, one).ravel()
    assert steady_gain(ratio) == pytest.approx(P / (P + 1), rel=1e-9)
