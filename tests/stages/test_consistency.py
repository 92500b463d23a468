"""The stage that checks kinematics."""

import logging
from types import SimpleNamespace

import numpy as np
from truths.closed_roll import NOISE, TRUTH, flown

from casid import kinematic_check
from casid.stages.consistency import KINEMATICS
from casid.stages.stage import Task


def test_check_channels_are_compared_too():
    whole = flown(bias=(0.0, 0.0, 0.0)).with_noise(NOISE, np.random.default_rng(1))
    own = whole.select(TRUTH.inputs, ("p",))
    both = whole.select(TRUTH.inputs, ("p", "phi"))
    alone = KINEMATICS.run(None, Task(model=TRUTH, records=(own,)))
    task = Task(model=TRUTH, records=(own,), checks={"identification": (both,)})
    assert alone.channels == ()
    assert [each.channel for each in KINEMATICS.run(None, task).channels] == ["p"]


def test_remarks_are_logged_and_become_cautions(caplog):
    good = flown(bias=(0.0, 0.0, 0.0)).with_noise(NOISE, np.random.default_rng(1))
    good = good.select(TRUTH.inputs, ("p", "phi"))
    for record, spoilt in ((good, False), (good.shift({"phi": 0.2}), True)):
        caplog.clear()
        with caplog.at_level(logging.WARNING, "casid"):
            found = KINEMATICS.run(None, Task(model=TRUTH, records=(record,)))
        assert found.remarks == kinematic_check(record).remarks
        assert bool(found.remarks) is spoilt
        assert [each.getMessage() for each in caplog.records] == [
            f"The records do not agree with kinematics: {remark}" for remark in found.remarks
        ]
        (section,) = KINEMATICS.show(found, SimpleNamespace())
        assert [each.text for each in section.cautions] == [
            f"Kinematics: {remark}." for remark in found.remarks
        ]
