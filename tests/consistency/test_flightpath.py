"""Signals of a flight, their integrals and their noise, against closed forms."""

import numpy as np
import pytest
from truths.flights import NOISE, RATES, flight

from casid import Record
from casid.consistency.flightpath import _integral, noise, signals
from casid.consistency.kinematics import kinematic_check


def test_running_integrals_are_exact_for_straight_lines_and_of_fourth_order_inside():
    t = np.linspace(0.0, 2.0, 41)
    line = _integral(np.column_stack([np.ones(41), 3 - 2 * t]), 0.05)
    np.testing.assert_allclose(line, np.column_stack([t, 3 * t - t**2]), atol=1e-13)
    errors = []
    for count in (41, 81):
        t = np.linspace(0.0, 2.0, count)
        found = _integral(np.sin(3 * t)[:, None], t[1])[:, 0]
        inside = found - found[1] - (np.cos(3 * t[1]) - np.cos(3 * t)) / 3
        errors.append(np.abs(inside[1:-1]).max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.2)


def test_noise_is_the_standard_deviation_of_what_is_not_smooth():
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(200_000)
    # Third differences of white noise have the variance 1 + 9 + 9 + 1 = 20; 200 000 correlated
    # squares give the standard deviation to 0.3 %, and the sine is 1e-5 of it.
    x = np.sin(t) + 0.1 * rng.standard_normal(len(t))
    assert noise(x) == pytest.approx(0.1, rel=0.01)


def test_headings_pass_north_without_a_jump():
    whole = flight(0, None, NOISE, (*RATES, "phi", "theta", "psi"))
    psi = whole.channel("psi") - np.median(whole.channel("psi")) + np.pi
    y = np.column_stack([whole.y[:, :-1], (psi + np.pi) % (2 * np.pi) - np.pi])
    wrapped = Record(whole.t, whole.u, y, whole.inputs, whole.outputs, whole.name)
    assert np.abs(np.diff(wrapped.channel("psi"))).max() > 6
    found = signals(wrapped, {}).values["psi"]
    np.testing.assert_allclose(found - found[0], psi - psi[0], atol=1e-12)


def test_records_too_short_to_look_at_are_no_error():
    short = flight(0, None, NOISE).take(slice(15))
    assert kinematic_check(short).channels == ()
