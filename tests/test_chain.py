"""The chain from Python: what is given decides what is done."""

import pytest
from truths.roll_study import write_study

from casid import Chain, Progress, identify, read_records, read_study


@pytest.mark.slow
def test_identify_does_what_the_study_does_and_judges_unseen_records(tmp_path):
    study = read_study(write_study(tmp_path))
    records, told = read_records(study), []
    found = identify(
        study.model,
        records["identification"],
        unseen=records["validation"],
        settings=study.settings,
        progress=told.append,
    )
    ended = [str(each) for each in told if not isinstance(each, Progress)]
    assert len(ended) == len(found.results)
    assert ended[3].startswith("H-infinity match: ")
    assert str(found.hinf.iterations) in ended[3]
    assert any(each.iteration > 3 for each in told if isinstance(each, Progress))
    assert list(found.results) == [
        "kinematics", "pbsid", "quadratic", "hinf", "output_error", "sufficiency", "validation",
    ]  # fmt: skip
    assert found.frequency_response is None
    assert set(found.validation.models) == {"black box", "H∞ match", "output error"}
    # Roll damping and control power from records with 2 % noise: to a few percent.
    assert found.output_error.model.Lp == pytest.approx(-2.2, rel=0.05)
    chain = Chain(settings=study.settings, black_box=found.black_box)
    again = chain.fit(study.model, records["identification"])
    assert again.cost == pytest.approx(found.output_error.cost, rel=1e-9)
