"""What a study hands to its report."""

import pytest
from truths.roll_study import write_study

from casid import read_study, run_study


@pytest.mark.slow
def test_a_validation_record_that_an_estimation_has_seen_is_told(tmp_path):
    study = read_study(write_study(tmp_path, ('["random.csv"]', '["sweep.csv"]')))
    text = run_study(study).report.read_text(encoding="utf-8")
    assert "Record sweep is for validation, but an estimation has seen it" in text
