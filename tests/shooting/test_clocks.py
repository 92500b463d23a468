"""Delays of inputs whose clock differs from the outputs'."""

import numpy as np
import pytest
from truths.structures import LateRoll

from casid import DataWarning, ModelError, Record
from casid.shooting.clocks import input_delays


def flown(late, seed):
    """Lp = -2.2, Llat = 12, tau = 0.04; the stick recorded late."""
    t, rng = np.arange(0, 15, 0.02), np.random.default_rng(seed)
    lat = 0.04 * np.sin(np.cumsum(0.02 * (0.5 + 0.5 * t)))
    y = LateRoll(Lp=-2.2, Llat=12.0, tau=0.04).system().simulate(t, lat[:, None])
    clean = Record(t, lat[:, None], y, ("lat",), ("p",), "sweep")
    return clean.shift({"lat": late}).with_noise({"p": 0.003}, rng)


@pytest.mark.parametrize("late", [-0.05, 0.0, 0.1])
def test_delay_and_clock_are_known_together(late):
    (found,) = input_delays(LateRoll(), flown(late, 3))
    assert found.delay == pytest.approx(0.04 - late, abs=0.002)
    assert abs(found.delay - (0.04 - late)) < 4 * found.std_error + 2e-4  # the spline's share
    assert ("the clocks differ" in found.remark) == (late == 0.1)


def test_delays_are_known_from_a_record_with_a_gap():
    whole = flown(0.1, 5)
    parted = whole.take((whole.t < 6.0) | (whole.t > 7.3))
    with pytest.warns(DataWarning, match="1 gap in time"):
        (found,) = input_delays(LateRoll(), parted)
    assert found.delay == pytest.approx(-0.06, abs=0.002)


def test_delays_that_are_no_parameters_are_told():
    with pytest.raises(ModelError, match="no input whose delay"):
        input_delays(LateRoll(), flown(0.0, 1), fixed=("tau",))
    with pytest.raises(ValueError, match="above 0"):
        input_delays(LateRoll(), flown(0.0, 1), margin=0.0)
