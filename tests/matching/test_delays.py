"""Delays stay at zero or more, whatever a structure's bounds say."""

import pytest
from truths.structures import HoverRoll

from casid import ModelError, Scalar, parameter
from casid.matching.delays import delay_parameters, with_nonnegative_delays
from casid.model import free_parameters


class TwoParts(HoverRoll):
    """A delay of two parameters."""

    rotor: Scalar = parameter(default=0.03, lower=-0.1, upper=0.3, unit="s")

    def delays(self):
        return {"lat": self.tau + 2 * self.rotor}


def test_bare_and_composed_delays_are_told_apart():
    assert delay_parameters(free_parameters(HoverRoll())) == ([4], [])
    assert delay_parameters(free_parameters(HoverRoll(), fixed={"Lv"})) == ([3], [])
    assert delay_parameters(free_parameters(TwoParts())) == ([], [0])
    assert delay_parameters(free_parameters(HoverRoll(), fixed={"tau"})) == ([], [])


def test_lower_bounds_below_zero_are_raised_to_it():
    free = with_nonnegative_delays(free_parameters(HoverRoll(), bounds={"tau": (-0.2, 0.4)}))
    assert (free.lower[4], free.upper[4]) == (0.0, 0.4)
    late = with_nonnegative_delays(free_parameters(HoverRoll(), bounds={"tau": (0.1, 0.4)}))
    assert late.lower[4] == 0.1
    parts = free_parameters(TwoParts())
    assert with_nonnegative_delays(parts).lower.tolist() == parts.lower.tolist()


def test_a_delay_that_must_be_negative_is_refused():
    with pytest.raises(ModelError, match=r"tau is a delay with upper bound -0\.1 < 0"):
        with_nonnegative_delays(free_parameters(HoverRoll(), bounds={"tau": (-0.2, -0.1)}))
