"""The stage of the black box."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from truths.structures import SECOND, black_box
from truths.systems import campaign, unstable_plant

from casid import Pbsid, pbsid
from casid.stages.black_box import BLACK_BOX
from casid.stages.stage import Task


def test_the_stage_is_pbsid_with_its_settings():
    own = {"order": 5, "pole": 6.0, "past": 10, "feedthrough": ["z"]}
    records = tuple(campaign())
    task = Task(model=None, records=records)
    found = BLACK_BOX.run(Pbsid(**own), task)
    np.testing.assert_array_equal(found.system.A, pbsid(records, **own).system.A)
    assert found.system.poles()[0].real > 0
    assert unstable_plant().poles()[0].real > 0


def test_the_section_tells_order_records_and_doubts():
    sure = replace(black_box(SECOND), records=("3211", "sweep"))
    doubtful = replace(sure, doubtful=np.array([0.3 + 0j]))
    for box, doubts in ((sure, 0), (doubtful, 1)):
        (section,) = BLACK_BOX.show(box, SimpleNamespace())
        assert section.lead == "A black box of order 2 was identified from 2 records (3211, sweep)."
        assert [each.text for each in section.cautions] == list(box.doubts())
        assert len(section.cautions) == doubts
        assert len(list(section.draw())) == 1
