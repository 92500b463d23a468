"""How many steps the integration needs."""

import pytest

from casid.shooting.integration import SHIFT, factor_wanted
from casid.shooting.nonlinear import Integration

MANY = 10**9  # samples: only what is needed, not what is cheap


@pytest.mark.parametrize("shift", [0.021, 0.1, 0.32, 0.4, 5.0])
def test_more_steps_bring_an_error_of_fourth_order_below_what_is_allowed(shift):
    factor = factor_wanted(Integration(steps=1, shift=shift, moved="Lp"), MANY)
    assert factor > 1
    assert shift / factor**4 <= SHIFT
    assert factor == 2 or shift / (factor / 2) ** 4 > SHIFT


def test_steps_that_are_short_enough_stay():
    assert factor_wanted(Integration(steps=1, shift=0.9 * SHIFT, moved="Lp"), MANY) == 1
    assert factor_wanted(Integration(steps=1, shift=0.9 * SHIFT, moved="Lp"), 100) > 1  # cheap
