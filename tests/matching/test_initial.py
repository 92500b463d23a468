"""Starting points against structures whose states the response gives away."""

import numpy as np
from truths.structures import TRUTH

from casid import Model, parameter
from casid.free import free_parameters
from casid.matching.descent import Condensed
from casid.matching.initial import StartingPoint, distinct_minima, least_squares, starts
from casid.matching.targets import comparison_of


def test_least_squares_gives_the_truth_where_states_and_delay_are_known():
    class Seen(Model):
        states, inputs, outputs = ("v", "p", "phi"), ("lat",), ("ay", "p", "phi")
        Yv: float = parameter(default=-0.15, lower=-1.0, upper=0.0, unit="1/s")
        Lv: float = parameter(default=-0.05, lower=-0.5, upper=0.5, unit="rad/(m s)")
        Lp: float = parameter(default=-3.0, lower=-10.0, upper=0.0, unit="1/s")
        Llat: float = parameter(default=8.0, lower=0.0, upper=50.0, unit="rad/s^2")

        def A(self):
            return [[self.Yv, 0, 9.81], [self.Lv, self.Lp, 0], [0, 1, 0]]

        def B(self):
            return [[0], [self.Llat], [0]]

        def C(self):
            return [[self.Yv, 0, 0], [0, 1, 0], [0, 0, 1]]

    truth = Seen(Yv=-0.2, Lv=-0.08, Lp=-2.5, Llat=11.0)
    free = free_parameters(Seen())
    comparison = comparison_of(Seen(), [truth.system()], omega=np.geomspace(0.3, 12.0, 20))
    values = least_squares(Condensed.of(free, comparison))
    np.testing.assert_allclose(values, truth.vector(), rtol=1e-6)


def test_one_minimum_found_twice_counts_once():
    costs = {"a": 2.0, "b": 1.0, "c": 1.0 + 1e-6, "d": 1.01}
    found = [
        StartingPoint(name=name, values=np.zeros(1), cost=cost) for name, cost in costs.items()
    ]
    assert [start.name for start in distinct_minima(found)] == ["b", "d", "a"]


def test_the_guess_is_among_the_starts_as_it_is():
    # The truth is unstable right of the imaginary axis; from it no way can lead down.
    problem = Condensed.of(free_parameters(TRUTH), comparison_of(TRUTH, [TRUTH.system()]))
    best = starts(problem, large=False)[0]
    np.testing.assert_allclose(best.values, TRUTH.vector(), rtol=1e-6)
    assert best.cost < 1e-12
