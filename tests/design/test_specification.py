"""What may be asked of a design."""

import numpy as np
import pytest

from casid import DesignSettings, Limits


def test_limits_that_leave_nothing_are_refused():
    with pytest.raises(ValueError, match="limit of stick 'lat' is infinite"):
        Limits(sticks={"lat": np.inf})
    with pytest.raises(ValueError, match="leaves nothing to fly"):
        Limits(sticks={"lat": 0.0})
    with pytest.raises(ValueError, match="no stick may move"):
        Limits(sticks={})
    with pytest.raises(ValueError, match="rate of 'ped'"):
        Limits(sticks={"lat": 0.1}, rates={"ped": 1.0})


def test_samples_are_fifty_a_second_unless_it_is_said_otherwise():
    assert DesignSettings().interval == 0.02
    assert DesignSettings(dt=0.1).interval == 0.1
    with pytest.raises(ValueError, match=r"spread = 20: .* 1 at most"):
        DesignSettings(spread=20.0)
