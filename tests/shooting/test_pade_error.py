"""Steps that the approximation of a sensor's delay rounds, against fine staircases."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from casid import DataWarning, Model, Record, Scalar, output_error, parameter
from casid.sensors import Sensor
from casid.shooting.pade_error import rounded

DT, FINE = 0.02, 200  # s, samples of truth in each


class Roll(Model):
    """Roll whose lateral force is measured late."""

    states, inputs, outputs, late_outputs = ("p",), ("lat",), ("p", "ay"), ("ay",)

    Lp: Scalar = parameter(default=-2.0, lower=-10.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=50.0, unit="1/s^2")
    Yp: Scalar = parameter(default=1.0, lower=-10.0, upper=10.0, unit="m/s")
    Ylat: Scalar = parameter(default=5.0, lower=-50.0, upper=50.0, unit="m/s^2")
    late: Scalar = parameter(default=0.107, lower=0.001, upper=0.3, unit="s")

    def A(self):
        return [[self.Lp]]

    def B(self):
        return [[self.Llat]]

    def C(self):
        return [[1], [self.Yp]]

    def D(self):
        return [[0], [self.Ylat]]

    def sensors(self):
        return {"ay": Sensor(delay=self.late)}


def sticks(steps):
    t = DT * np.arange(1500)
    if not steps:
        return t, 0.1 * np.sin(np.cumsum(DT * (0.5 + 0.3 * t)))
    edges, values = [1.0, 2.5, 3.5, 4.0, 4.5, 10.0, 11.0], [0.0, 1, -1, 1, -1, 0, 0.5, 0]
    return t, 0.1 * np.array(values)[np.searchsorted(edges, t, side="right")]


def flown(seed, hold, late, steps=True):
    """A record by fine steps; what is late is late by whole ones of these."""
    t, u = sticks(steps)
    fine = DT / FINE * np.arange(len(t) * FINE)
    between = np.repeat(u, FINE) if hold == "zoh" else np.interp(fine, t, u)
    middle = between if hold == "zoh" else (between + np.append(between[1:], between[-1])) / 2
    decay = np.exp(-2 * DT / FINE)
    p = scipy.signal.lfilter([0, 5 * (1 - decay)], [1, -decay], middle)
    ay = np.concatenate([np.zeros(round(late / DT * FINE)), p + 5 * between])
    noise = [0.01, 0.05] * np.random.default_rng(seed).standard_normal((len(t), 2))
    y = np.column_stack([p[::FINE], ay[: len(p) : FINE]]) + noise
    return Record(t, u[:, None], y, ("lat",), ("p", "ay"), f"{seed}", hold)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(("hold", "late"), [("foh", 0.107), ("zoh", 0.0533)])
def test_it_is_the_difference_of_a_pade_approximation_and_a_late_staircase(hold, late):
    record = flown(1, hold, late)
    fine = DT / FINE * np.arange(record.N * FINE)
    u = record.u[:, 0]
    between = np.repeat(u, FINE) if hold == "zoh" else np.interp(fine, record.t, u)
    # G. A. Baker, P. Graves-Morris, Padé Approximants: [2/3] of e^-x.
    pade = ([3 * late**2, -24 * late, 60], [late**3, 9 * late**2, 36 * late, 60])
    _, approximated, _ = scipy.signal.lsim(pade, between, fine, interp=False)
    approximated, exact = 5 * approximated, 5 * np.interp(fine - late, fine, between, left=0.0)
    off = (approximated - exact)[::FINE]
    found = rounded(Roll(late=late), "ay", record)
    assert np.abs(off).max() > 0.1
    np.testing.assert_allclose(found, off, atol=0.02)
    trimmed = replace(record, u=record.u + 0.4)  # at rest before it, as any record
    np.testing.assert_allclose(rounded(Roll(late=late), "ay", trimmed), found, atol=1e-9)
    lost = record.mask(np.arange(record.N)[:, None] % 2 * [True, True] > 0)
    assert np.isnan(rounded(Roll(late=late), "ay", lost)).sum() == record.N // 2


@pytest.mark.second
def test_steps_that_are_rounded_are_told_and_smooth_sticks_and_short_delays_are_not():
    with pytest.warns(
        DataWarning, match="ay responds to steps.*smooths these by up to 0.3.*Record.shift"
    ):
        output_error(Roll(), flown(2, "zoh", 0.107))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        output_error(Roll(), flown(3, "zoh", 0.107, steps=False))
        output_error(Roll(late=0.013), flown(4, "zoh", 0.013), fixed=("late",))
        assert not rounded(Roll(Ylat=0.0), "ay", flown(5, "foh", 0.107)).any()
