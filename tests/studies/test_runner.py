"""A study from its file to its report."""

import csv
import subprocess
import sys
from dataclasses import fields

import pytest
from truths.closed_roll import TRUTH, noisy
from truths.roll_study import write_study

from casid import ConvergenceError, output_error, read_study, report, run_study
from casid.fit import ParameterEstimate
from casid.studies import runner
from casid.studies.runner import WRITTEN, write_parameters


@pytest.mark.second
def test_output_error_that_stops_early_leaves_its_best_iterate(tmp_path):
    limit = ("[match]", "[output_error]\nsolver = { max_iterations = 1 }\n\n[match]")
    study = read_study(write_study(tmp_path, limit))
    with pytest.raises(ConvergenceError, match="iteration limit"):
        run_study(study)
    assert (study.output / "stages" / "output_error_best.json").exists()
    assert {path.name for path in study.output.iterdir()} == {"stages", ".lock"}


@pytest.mark.slow
def test_what_ends_a_later_run_leaves_the_files_of_one_run(tmp_path, monkeypatch):
    path = write_study(tmp_path)
    study = read_study(path)
    run_study(study)
    kept = {name: (study.output / name).read_bytes() for name in WRITTEN[:3]}
    flight = tmp_path / "sweep.csv"
    flight.write_text("\n".join(flight.read_text().splitlines()[:-5]) + "\n")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(report, "write_report", full)
    with pytest.raises(OSError, match="No space"):
        run_study(read_study(path))
    assert {name: (study.output / name).read_bytes() for name in kept} == kept

    def refused(*_, **__):
        raise ValueError("no such thing")

    monkeypatch.setattr(runner, "run_stages", refused)
    with pytest.raises(ValueError, match="no such thing") as error:
        run_study(read_study(path), fresh=True)
    (note,) = error.value.__notes__
    assert "report.html, fit.json, parameters.csv" in note
    assert "are not of this run but of the last one that ended" in note


@pytest.mark.campaign
def test_a_study_loads_no_library_of_filters_and_distributions(tmp_path):
    # Either takes longer to import than most stages to run, in every process anew.
    code = "import sys, casid; casid.run_study(casid.read_study(sys.argv[1])); print(*sys.modules)"
    program = [sys.executable, "-W", "ignore", "-c", code, str(write_study(tmp_path))]
    run = subprocess.run(program, capture_output=True, text=True, check=True)
    found = set(run.stdout.split())
    assert "casid.report.html" in found
    assert not {"scipy.signal", "scipy.stats"} & found


@pytest.mark.slow
def test_an_optional_stage_that_fails_leaves_everything_else_and_raises_last(tmp_path):
    path = write_study(
        tmp_path,
        ("[records.validation]",
         "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n[records.validation]"),
        ("[match]", "[frequency]\nomega = {from = 0.6, to = 5, points = 20}\n\n"
                    "[derivid]\nsolver = { max_iterations = 1 }\n\n[match]"),
    )  # fmt: skip
    study = read_study(path)
    with pytest.raises(ConvergenceError, match="The report is written without it"):
        run_study(study)
    page = (study.output / "report.html").read_text(encoding="utf-8")
    assert "The frequency-domain fit is missing." in page
    assert (study.output / "fit.json").exists()


def test_the_table_of_parameters_reads_back_as_it_was(tmp_path):
    fit = output_error(TRUTH, noisy(1), fixed=("tau",))
    write_parameters(tmp_path / "parameters.csv", fit)
    with (tmp_path / "parameters.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [each.name for each in fields(ParameterEstimate)]
    for row, told in zip(fit.parameters, rows, strict=True):
        assert told["name"] == row.name
        for name in ("value", "std_error", "lower", "upper"):
            assert float(told[name]) == pytest.approx(getattr(row, name), rel=1e-9, nan_ok=True)
        assert told["fixed"] == str(row.fixed).lower()


@pytest.mark.slow
def test_notes_of_a_study_stand_among_its_cautions(tmp_path):
    path = write_study(tmp_path, ("[study]", "[study]\nnotes = ['Flown in rain.']"))
    for _ in range(2):  # the second as it was written
        outcome = run_study(read_study(path))
        assert "Flown in rain." in outcome.cautions
    assert "Flown in rain." in outcome.report.read_text(encoding="utf-8")
    path = write_study(tmp_path, ("[study]", "[study]\nnotes = 3"))
    with pytest.raises(ValueError, match="notes = 3, expected list or str"):
        read_study(path)
