"""Whether a solve ended as a solution, in words."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, noisy

from casid.free import free_parameters
from casid.nlp import Solution
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator
from casid.shooting.solutions import run_away, verdict
from casid.shooting.starting import starting_programme


def test_biases_that_run_away_with_initial_states_are_named():
    free = free_parameters(TRUTH)
    evaluator = Evaluator(free, lay_out([noisy(1), noisy(2)], 2.0))
    programme, point = starting_programme(evaluator, free, "diagonal", True)
    assert run_away(programme, programme.pack(point)) == ""
    size = np.sqrt(np.mean(np.concatenate([noisy(1).y, noisy(2).y]) ** 2, axis=0))
    for times, told in ((99.0, False), (101.0, True)):
        away = replace(point, bias=np.array([[0.0, 0.0, 0.0], [0.0, -times * size[1], 0.0]]))
        said = run_away(programme, programme.pack(away), lost=1)
        assert ("biases of p diverge" in said) == told
        assert ("(OutputError(initial=...).fit)" in said) == told  # `output_error` has no initial=


def test_an_integral_may_run_away_as_far_as_its_digits_last():
    free = free_parameters(TRUTH)
    programme, point = starting_programme(
        Evaluator(free, lay_out([noisy(1)], 2.0)), free, "diagonal", True
    )
    for times, told in ((1e4, False), (1e14, True)):
        away = replace(point, bias=np.array([[0.0, -times, 0.0]]))
        assert bool(run_away(programme, programme.pack(away))) == told


@pytest.mark.parametrize(
    ("success", "settled", "more", "said"),
    [
        (True, True, [], "solved"),
        (True, False, ["tie a"], "give R; tie a"),
        (False, False, ["tie a"], "limit; tie a"),
        (False, True, [], "limit"),
    ],
)
def test_a_solution_is_one_if_it_has_settled_and_nothing_speaks_against_it(
    success, settled, more, said
):
    none, status = np.zeros(0), "solved" if success else "limit"
    found = Solution(
        x=none, f=0.0, g=none, multipliers_x=none, multipliers_g=none, success=success,
        status=status, iterations=1, seconds=0.0,
    )  # fmt: skip
    assert verdict(found, settled, "give R", more) == (said == "solved", said)
