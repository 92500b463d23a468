"""Last steps as estimators from the same manoeuvres."""

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign

from casid import Match, OutputError, Pbsid, SpectralAnalysis, frequency_response, output_error
from casid.bounds.steps import LastStep

RECORDS = campaign(1, 4)
OMEGA = np.geomspace(2.5, 9.0, 8)


def test_a_step_takes_its_own_manoeuvres_as_time_histories():
    names = ("record 0", "record 2")
    found = LastStep(estimator=OutputError(), histories=names, decimate=2).fit(TRUTH, RECORDS)
    direct = output_error(TRUTH, [RECORDS[0].decimate(2), RECORDS[2].decimate(2)])
    assert found.model == direct.model


def test_the_others_enter_as_a_response():
    step = LastStep(
        estimator=OutputError(), histories=("record 0",), responses=SpectralAnalysis(omega=OMEGA)
    )
    measured = frequency_response(RECORDS[1:], omega=OMEGA)
    direct = output_error(TRUTH, RECORDS[:1], responses=measured)
    assert step.fit(TRUTH, RECORDS).model == direct.model
    alone = step.fit(TRUTH, RECORDS[:1])  # nothing is left for a response
    assert alone.model == output_error(TRUTH, RECORDS[:1]).model


def test_a_match_is_to_a_black_box_of_what_is_there():
    step = LastStep(estimator=Match(norm="quadratic"), black_box=Pbsid(order=3, past=20, future=10))
    found = step.fit(TRUTH, RECORDS[:2])
    assert found["Lp"].value == pytest.approx(TRUTH.Lp, rel=0.2)
