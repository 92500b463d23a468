"""The stages up to output error as one estimator."""

import numpy as np
import pytest
from truths.closed_roll import TRUTH, noisy
from truths.systems import campaign

from casid import Chain, Matching, OutputError, Pbsid
from casid.stages.chain import CHAIN


def test_settings_of_the_chain_are_values_of_its_stages():
    settings = {"pbsid": Pbsid(order=3), "match": Matching(), "output_error": OutputError()}
    assert Chain(settings=settings).settings["pbsid"].order == 3
    assert [stage.name for stage in CHAIN] == [
        "pbsid", "frequency", "quadratic", "hinf", "output_error",
    ]  # fmt: skip


@pytest.mark.second
def test_many_fits_share_one_black_box():
    own = Pbsid(order=5, pole=6.0, past=10, feedthrough=["z"])
    records = campaign()
    ready = Chain(settings={"pbsid": own}, refinement=(noisy(1),)).prepared(TRUTH, records)
    np.testing.assert_array_equal(ready.black_box.system.A, own.fit(tuple(records)).system.A)
    assert len(ready.refinement) == 1
    assert ready.prepared(TRUTH, records) is ready
