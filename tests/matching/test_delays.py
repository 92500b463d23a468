"""Delays that are parameters, and those composed of several."""

from truths.structures import HoverRoll

from casid import Scalar, parameter
from casid.free import free_parameters
from casid.matching.delays import delay_parameters


class TwoParts(HoverRoll):
    """A delay of two parameters."""

    rotor: Scalar = parameter(default=0.03, lower=0.0, upper=0.3, unit="s")

    def delays(self):
        return {"lat": self.tau + 2 * self.rotor}


def test_bare_and_composed_delays_are_told_apart():
    assert delay_parameters(free_parameters(HoverRoll())) == ([4], [])
    assert delay_parameters(free_parameters(HoverRoll(), fixed={"Lv"})) == ([3], [])
    assert delay_parameters(free_parameters(TwoParts())) == ([], [0])
    assert delay_parameters(free_parameters(HoverRoll(), fixed={"tau"})) == ([], [])
