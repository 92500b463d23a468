"""Delays of inputs whose clock differs from the outputs'."""

import numpy as np
import pytest
from truths.structures import LateRoll

from casid import Constraint, DataWarning, FrequencyResponse, ModelError, OutputError, Record
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


ONE = np.ones((3, 1, 1))
FLOWN = FrequencyResponse(
    omega=np.array([0.5, 1.0, 2.0]),
    G=ONE + 0j,
    coherence=ONE,
    random_error=0.1 * ONE,
    inputs=("lat",),
    outputs=("p",),
    input_std=np.ones(1),
    output_std=np.ones(1),
)


class KnownDelay(LateRoll):
    """A stick whose own delay is known, and that its gain is below 20."""

    def constraints(self):
        known = Constraint("tau = 0.04", self.tau, 0.04, 0.04)
        return Constraint("Llat < 20", self.Llat, -np.inf, 20.0), known


def test_what_is_known_of_the_aircraft_does_not_hide_its_clock():
    # A delay of 0.04 s that everyone is sure of, and a stick that was recorded 0.1 s late.
    sure = OutputError(priors={"tau": (0.04, 1e-4)})
    for model, estimator in ((LateRoll(), sure), (KnownDelay(), OutputError())):
        (found,) = input_delays(model, flown(0.1, 3), estimator=estimator)
        assert found.delay == pytest.approx(-0.06, abs=0.002)
        assert found.std_error < 0.002
    with pytest.raises(ValueError, match="responses"):
        input_delays(LateRoll(), flown(0.1, 3), estimator=OutputError(responses=(FLOWN,)))


def test_other_priors_count():
    # The gain is 12; a prior that is sure of 15 takes a lag for part of the delay.
    (plain,) = input_delays(LateRoll(), flown(0.0, 3))
    with pytest.warns(DataWarning, match="contradict the prior Llat"):
        (biased,) = input_delays(
            LateRoll(), flown(0.0, 3), estimator=OutputError(priors={"Llat": (15.0, 1e-3)})
        )
    assert abs(biased.delay - plain.delay) > 10 * plain.std_error


@pytest.mark.parametrize(("late", "margin"), [(0.1, 0.02), (-0.4, 0.2)])
def test_a_delay_at_the_end_of_the_search_is_told_as_that(late, margin):
    (found,) = input_delays(LateRoll(), flown(late, 3), margin=margin)
    assert np.isnan(found.std_error)
    assert found.delay == (-margin if late > 0 else LateRoll.infos()["tau"].upper)
    assert "may lie beyond" in found.remark
    assert "nan" not in found.remark
