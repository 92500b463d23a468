"""Many starts of a convex problem end in its one minimum."""

import numpy as np
import pytest
from truths.mixture import Inline, Mixture, record

from casid import Execution, multistart

HERE = Execution(executor=Inline())


@pytest.mark.campaign
def test_all_starts_of_a_linear_problem_end_in_one_minimum():
    found = multistart(Mixture(), [record()], starts=4, spread=1.0)
    assert found.agreeing == 4
    assert len({start.a for start in found.starts}) == 4
    assert found.starts[0] == Mixture()
    assert len(found.to_csv().splitlines()) == 5
    again = multistart(Mixture(), [record()], starts=4, spread=1.0, execution=HERE)
    np.testing.assert_array_equal(again.costs, found.costs)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"starts": 0}, "^starts=0: expected 1 or more$"),
        ({"spread": -1.0}, "^spread=-1.0: expected 0 or more$"),
    ],
)
def test_no_start_and_no_spread_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        multistart(Mixture(), record(), **settings)
