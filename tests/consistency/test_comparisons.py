"""Words about one channel, by numbers of which it is known what they mean."""

import numpy as np
import pytest
from truths.bodies import RATES, changed, flown, reversed_in

from casid.consistency.kinematics import kinematic_check


@pytest.mark.second
def test_a_sign_is_told_where_the_records_tell_no_scale():
    # Of one axis a record the yaw rate leaks little into bank and pitch: its sign is sure, its
    # scale is known to some per cent.
    outputs = (*RATES, "phi", "theta")
    check = kinematic_check(reversed_in(flown(100, outputs=outputs, single=True, count=2), "r"))
    (r,) = (each for each in check.channels if each.channel == "r")
    assert np.isnan(r.scale)
    assert check.remarks == r.remarks
    (said,) = r.remarks
    assert said == "r has the opposite sign of what phi and theta imply; no scale is given"
    assert not any("say nothing about r" in note for note in check.notes)


@pytest.mark.second
@pytest.mark.parametrize(("factor", "why"), [(1.3, "look at the scale factors"), (57.3, "degrees")])
def test_a_factor_is_told_with_its_error_and_what_it_betrays(factor, why):
    records = changed(flown(100, outputs=("p", "phi")), "p", lambda p: factor * p)
    (p,) = kinematic_check(records).channels
    assert 1 + p.scale == pytest.approx(factor, rel=0.1)  # r and q turn bank, too
    assert f"± {p.scale_error:.2g} times what phi implies: " in p.remarks[0]
    assert why in p.remarks[0]
