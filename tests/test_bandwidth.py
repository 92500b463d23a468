"""Bandwidth and phase delay of a fit: those of its equations, whatever the frequencies given."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from casid import Model, Record, Rows, Scalar, handling_band, output_error, parameter

NAMES = ("Lp", "tau")
PAIR = ("phi", "lat")


class Attitude(Model):
    """Bank angle from the stick: Llat e^(-τs) / (s (s - Lp))."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("phi",)

    Lp: Scalar = parameter(default=-2.0, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=4.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.06, lower=0.0, upper=0.3, unit="s")

    def A(self) -> Rows:
        return [[self.Lp, 0], [1, 0]]

    def B(self) -> Rows:
        return [[self.Llat], [0]]

    def delays(self) -> dict[str, Scalar]:
        return {"lat": self.tau}


@cache
def fitted():
    """Of a noisy flight with steps of the stick."""
    rng, t = np.random.default_rng(6), 0.05 * np.arange(800)
    u = 0.1 * np.repeat(rng.choice([-1.0, 0.0, 1.0], 40), 20)[:, None]
    u[-200:] -= u[:600].sum() / 200
    y = Attitude().system().simulate(t, u) + 0.002 * rng.standard_normal((800, 1))
    return output_error(Attitude(), Record(t, u, y, ("lat",), ("phi",), "steps"))


def lost(w, Lp, tau):
    """Phase [rad] that is lost at a frequency: -90° - atan(ω/|Lp|) - ωτ, whatever the gain."""
    return np.pi / 2 + np.arctan(w / -Lp) + w * tau


def where(function):
    """Where a function of the frequency is zero [rad/s]."""
    return brentq(function, 1e-3, 50.0, xtol=1e-13)


def by_hand(Lp, tau):
    """Where 135° are lost, and the phase delay."""
    at = where(lambda w: lost(w, Lp, tau) - np.pi)
    delay = (lost(2 * at, Lp, tau) - np.pi) / (2 * at)
    return np.array([where(lambda w: lost(w, Lp, tau) - 0.75 * np.pi), delay])


@pytest.mark.parametrize("count", [3, 12, 60, 2000])
def test_bandwidth_and_phase_delay_are_those_of_the_equations_between_any_frequencies(count):
    fit, omega = fitted(), np.geomspace(0.2, 60.0, count)
    C = fit.covariance[np.ix_(*[[fit.free_names.index(name) for name in NAMES]] * 2)]
    at, h = np.array([fit[name].value for name in NAMES]), 1e-5
    slopes = np.array([(by_hand(*(at + s)) - by_hand(*(at - s))) / (2 * h) for s in h * np.eye(2)])
    found = handling_band(fit, PAIR, omega, attitude_command=True)
    np.testing.assert_allclose([found.bandwidth, found.phase_delay], by_hand(*at), rtol=1e-9)
    std = np.sqrt(np.diag(slopes.T @ C @ slopes))
    np.testing.assert_allclose([found.bandwidth_std, found.phase_delay_std], std, rtol=1e-5)


class Sprung(Attitude):
    """The same with a stiffness: Llat e^(-τs) / (s² + 4 s + 8)."""

    def A(self) -> Rows:
        return [[-4.0, -8.0], [1, 0]]


@pytest.mark.parametrize("count", [12, 500])
def test_a_gain_that_falls_first_is_read_between_any_frequencies_alike(count):
    def gain(w):
        return 1 / np.hypot(8 - w**2, 4 * w)

    at = where(lambda w: np.arctan2(4 * w, 8 - w**2) + 0.3 * w - np.pi)
    expected = where(lambda w: gain(w) - 10**0.3 * gain(at))
    assert expected < where(lambda w: np.arctan2(4 * w, 8 - w**2) + 0.3 * w - 0.75 * np.pi)
    fit = replace(fitted(), model=Sprung(tau=0.3))
    found = handling_band(fit, PAIR, np.geomspace(0.2, 60.0, count))
    assert found.bandwidth == pytest.approx(expected, rel=1e-9)


def test_what_cannot_be_read_is_told():
    short = handling_band(fitted(), PAIR, np.geomspace(0.2, 8.0, 500))
    assert np.isnan(short.phase_delay)
    assert "lies beyond the grid: no phase delay" in short.headline()
    with pytest.raises(ValueError, match='"loop": expected "attitude" or "rate"'):
        handling_band(fitted(), PAIR, [0.5, 5.0], kind="loop")
    with pytest.raises(ValueError, match="expected finite frequencies above 0"):
        handling_band(fitted(), PAIR, [0.5, np.nan])


def test_a_deviation_that_nothing_tells_is_told():
    # A thousandth of such errors of Lp, to its bound of 0, and the phase is below -135° throughout.
    fit = fitted()
    wide = replace(fit, covariance=1e12 * fit.covariance)
    found = handling_band(wide, PAIR, np.geomspace(0.2, 60.0, 200), attitude_command=True)
    assert found.bandwidth == pytest.approx(by_hand(fit["Lp"].value, fit["tau"].value)[0])
    assert np.isnan(found.bandwidth_std)
    assert "models next to the estimate have no such reading in the" in found.headline()
