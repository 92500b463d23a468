"""The stages of matching: targets, section."""

import pytest
from truths.roll_study import write_study

from casid import read_study, run_study


@pytest.mark.slow
def test_the_page_shows_the_figure_and_the_worst_pair(finished):
    page = finished.report.read_text(encoding="utf-8")
    assert "Singular values of the weighted error over the band" in page
    assert "Worst pair there" in page
    assert finished.report.with_name("figures").joinpath("match_error.svg").exists()


@pytest.mark.slow
def test_the_structure_can_be_matched_to_the_measured_response_as_well(tmp_path):
    study = read_study(
        write_study(
            tmp_path,
            (
                "[records.validation]",
                "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n[records.validation]",
            ),
            (
                "[match]",
                "[frequency]\nomega = {from = 0.6, to = 5, points = 20}\n\n[derivid]\n\n"
                "[match]\ntargets = ['black box', 'frequency response']",
            ),
        )
    )
    outcome = run_study(study)
    found = outcome.identification
    assert found.frequency_response is not None
    assert "frequency domain" in outcome.validation.models
    # Roll control power, from records with 2 % noise: either way to a few percent.
    assert found.hinf["Llat"].value == pytest.approx(10.0, rel=0.1)
    assert found.output_error["Llat"].value == pytest.approx(10.0, rel=0.02)


def test_targets_are_checked_before_any_record_is_read(tmp_path):
    for targets, told in (
        ("['frequency response']", "expected 'black box' and perhaps 'frequency response'"),
        ("['black box', 'sweeps']", 'expected several "black box" or "frequency response"'),
        ("['black box', 'frequency response']", r"write \[records.frequency\]"),
    ):
        asked = write_study(tmp_path, ("[match]", f"[match]\ntargets = {targets}"))
        with pytest.raises(ValueError, match=told):
            read_study(asked)


def test_the_norm_is_the_stages_own(tmp_path):
    asked = write_study(tmp_path, ("[match]", "[match]\nnorm = 'hinf'"))
    with pytest.raises(ValueError, match="unknown key 'norm'"):
        read_study(asked)
