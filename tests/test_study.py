"""Reading a study, keeping its stages, going on where it stopped."""

import numpy as np
import pytest
from truths.roll_study import TRIM, write_study

from casid import ConvergenceError, DataWarning, Model, ModelError
from casid import chain as chain_module
from casid.jobs.store import Entry, Store
from casid.structure.modelfile import load_model
from casid.studies.runner import run_study
from casid.studies.study import read_records
from casid.studies.studyfile import read_study

# ---- reading -----------------------------------------------------------------------------------


def test_paths_are_relative_to_the_study_file(tmp_path, monkeypatch):
    write_study(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    study = read_study("../study.toml")
    assert study.model_file == tmp_path / "roll.py"
    assert study.output.resolve() == tmp_path / "out"
    assert [file.name for file in study.roles["identification"].files] == ["3211.csv", "sweep.csv"]


def test_sticks_in_percent_become_fractions_and_trim_is_removed(tmp_path):
    records = read_records(read_study(write_study(tmp_path)))
    steps = records["identification"][0]
    assert np.max(np.abs(steps.u)) == pytest.approx(0.05)  # of the truth, in fractions of travel
    assert steps.trim["lat"] == pytest.approx(TRIM["lat"])


def test_validation_takes_the_trim_of_the_identification_records(tmp_path):
    records = read_records(read_study(write_study(tmp_path)))
    means = np.mean([record.trim["phi"] for record in records["identification"]])
    assert records["validation"][0].trim["phi"] == means
    # At least 50 quiet samples a record with noise of 0.002: the mean is good to 0.0002.
    assert means == pytest.approx(TRIM["phi"], abs=0.001)


def test_noise_comes_from_the_seed_and_goes_to_the_roles_that_ask_for_it(tmp_path):
    quiet = ("noise = true", "noise = false")
    first = read_records(read_study(write_study(tmp_path)))
    again = read_records(read_study(write_study(tmp_path)))
    other = read_records(read_study(write_study(tmp_path, ("seed = 1", "seed = 2"))))
    clean = read_records(read_study(write_study(tmp_path, quiet)))
    y, y_again, y_other, y_clean = (
        run["identification"][0].y for run in (first, again, other, clean)
    )
    np.testing.assert_array_equal(y, y_again)
    assert not np.array_equal(y, y_other)
    # 750 samples: the standard deviation of 0.002 is estimated to 2.6 %, four sigma 10 %.
    np.testing.assert_allclose(np.std(y - y_clean, axis=0), 0.002, rtol=0.1)
    totals = [
        record.y + np.array([record.trim[name] for name in record.outputs])
        for record in (first["validation"][0], clean["validation"][0])
    ]
    np.testing.assert_allclose(*totals, atol=1e-12)


def test_a_record_in_two_roles_is_the_same_flight_in_both(tmp_path):
    both = "[records.refinement]\nfiles = ['3211.csv']\nnoise = true\n\n[records.validation]"
    study = read_study(write_study(tmp_path, ("[records.validation]", both)))
    records = read_records(study)
    np.testing.assert_array_equal(records["identification"][0].y, records["refinement"][0].y)


def test_trim_values_guesses_and_bounds_of_the_study_reach_the_model(tmp_path):
    own = "[model.trim]\ng = 9.7\n[model.values]\nLp = -3\n[model.bounds]\nLp = [-5, -1]\n[channels"
    study = read_study(write_study(tmp_path, ("[channels", own)))
    assert (study.model.g, study.model.Lp) == (9.7, -3.0)
    assert study.bounds == {"Lp": (-5.0, -1.0)}


def test_two_model_files_of_one_name_are_two_models(tmp_path):
    for folder, guess in (("one", "-1.5"), ("two", "-2.5")):
        (tmp_path / folder).mkdir()
        write_study(tmp_path / folder)
        text = (tmp_path / folder / "roll.py").read_text().replace("-1.5", guess)
        (tmp_path / folder / "roll.py").write_text(text)
    one, two = (load_model("roll.py:Roll", tmp_path / folder) for folder in ("one", "two"))
    assert (one().Lp, two().Lp) == (-1.5, -2.5)


def test_a_model_file_that_raises_is_named_with_its_line(tmp_path):
    (tmp_path / "bad.py").write_text("x = 1\ny = x / 0\n")
    with pytest.raises(ModelError, match=r"bad\.py, line 2 does not import: ZeroDivisionError"):
        load_model("bad.py:Bad", tmp_path)


# ---- keeping -----------------------------------------------------------------------------------


def test_a_stage_whose_file_was_lost_or_broken_is_not_taken(tmp_path):
    store = Store(tmp_path, Model)
    (tmp_path / "index.json").write_text('{"pbsid": {"key": "k", "seconds": 1, "warnings": []}}')
    assert store.get("pbsid", "k") is None
    (tmp_path / "pbsid.json").write_text('{"casid": "stage", "result": {"value": "os:system"')
    assert store.get("pbsid", "k") is None
    (tmp_path / "pbsid.json").write_text(
        '{"casid": "stage", "result": {"value": "os:system", "fields": {"command": "true"}}}'
    )
    assert store.get("pbsid", "k") is None
    assert Entry("k", 1.0).warnings == ()


# ---- running -----------------------------------------------------------------------------------


def _kept(outcome):
    return [timing.stage for timing in outcome.timings if timing.kept]


@pytest.mark.slow
def test_a_changed_option_computes_its_stage_and_those_after_it_again(tmp_path):
    run_study(read_study(write_study(tmp_path)))
    changed = run_study(read_study(write_study(tmp_path, ("points = 20", "points = 21"))))
    assert _kept(changed) == ["pbsid"]
    again = run_study(read_study(write_study(tmp_path, ("points = 20", "points = 21"))))
    assert _kept(again) == ["pbsid", "quadratic", "hinf", "output_error"]
    fresh = run_study(read_study(write_study(tmp_path)), fresh=True)
    assert _kept(fresh) == []


@pytest.mark.slow
def test_an_interrupted_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    study = read_study(write_study(tmp_path))

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(chain_module.OutputError, "fit", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_study(study)
    assert not (study.output / "fit.json").exists()
    assert _kept(run_study(study)) == ["pbsid", "quadratic", "hinf"]
    assert (study.output / "fit.json").exists()


@pytest.mark.slow
def test_what_a_stage_warns_of_is_in_the_report_of_a_later_run_too(tmp_path, monkeypatch):
    study = read_study(write_study(tmp_path))
    honest = chain_module.pbsid

    def worried(*arguments, **options):
        import warnings  # noqa: PLC0415 - a stage of another module

        warnings.warn("the controller is stiff near the pole", DataWarning, stacklevel=1)
        return honest(*arguments, **options)

    monkeypatch.setattr(chain_module, "pbsid", worried)
    for _ in range(2):
        report = run_study(study).report
        assert "the controller is stiff near the pole" in report.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_validation_record_that_an_estimation_has_seen_is_told(tmp_path):
    study = read_study(write_study(tmp_path, ('["random.csv"]', '["sweep.csv"]')))
    text = run_study(study).report.read_text(encoding="utf-8")
    assert "Record sweep is for validation, but an estimation has seen it" in text


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


def test_output_error_that_stops_early_leaves_its_best_iterate(tmp_path):
    limit = ("[match]", "[output_error]\nsolver = { max_iterations = 1 }\n\n[match]")
    study = read_study(write_study(tmp_path, limit))
    with pytest.raises(ConvergenceError, match="iteration limit"):
        run_study(study)
    assert (study.output / "stages" / "output_error_best.json").exists()
    assert {path.name for path in study.output.iterdir()} == {"stages", ".lock"}
