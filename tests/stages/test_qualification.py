"""The stage of tolerance bands: in a study, in its report, and what its table may hold."""

import pytest
from truths.roll_study import write_study

from casid import read_study, run_study

TABLE = '[qualification.tolerances]\np = "10 % or 3 deg/s"\nphi = "0.001 deg"\n\n[match]'


@pytest.mark.slow
def test_a_study_judges_its_model_in_the_bands(copy):
    outcome = run_study(read_study(write_study(copy, ("[match]", TABLE))))
    found = outcome.identification.results["qualification"]
    assert found.outputs == ("p", "phi")
    assert found.passed[:, 0].all()
    page = outcome.report.read_text("utf-8")
    assert "Sign-off" in page
    assert "± 10 % or 3 deg/s" in page
    assert "In every record: initial state and constant biases fitted; a constant" in page
    outcome.report.with_name("written.json").unlink()
    again = run_study(read_study(copy / "study.toml")).report.read_text("utf-8")
    assert again == page  # from what was kept, bit for bit
    for said in (
        "Out of the tolerance band: phi of",
        "Noise alone may leave the tolerance band: phi of",
    ):
        assert any(said in caution for caution in outcome.cautions)


def test_a_tolerance_of_no_output_is_refused_before_anything_runs(tmp_path):
    wrong = TABLE.replace("phi =", "phii =")
    with pytest.raises(ValueError, match=r"unknown output 'phii'; did you mean 'phi'\?"):
        read_study(write_study(tmp_path, ("[match]", wrong)))


def test_a_tolerance_that_is_not_understood_is_refused_with_its_place(tmp_path):
    wrong = TABLE.replace("0.001 deg", "small")
    with pytest.raises(ValueError, match=r"\[qualification\].*'small'.*expected"):
        read_study(write_study(tmp_path, ("[match]", wrong)))
