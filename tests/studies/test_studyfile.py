"""Reading a study: files, units, trim, noise, the model."""

import numpy as np
import pytest
from truths.roll_study import write_study

from casid import ModelError, read_csv, read_study
from casid.structure.modelfile import load_model
from casid.studies.study import read_records

# ---- reading -----------------------------------------------------------------------------------


def test_paths_are_relative_to_the_study_file(tmp_path, monkeypatch):
    write_study(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    study = read_study("../study.toml")
    assert study.model_file == tmp_path / "roll.py"
    assert study.output.resolve() == tmp_path / "out"
    assert [file.name for file in study.roles["identification"].files] == ["3211.csv", "sweep.csv"]


def test_a_channel_of_a_study_may_be_a_sum_of_columns(tmp_path):
    plain = read_records(read_study(write_study(tmp_path)))["identification"][0]
    columns = "[channels.columns]\nlat = { lat = 0.5, phi = 2.0 }\n[records.identification]"
    study = read_study(write_study(tmp_path, ("[records.identification]", columns)))
    mixed, lat = read_records(study)["identification"][0].totals()["lat"], plain.totals()["lat"]
    phi = read_csv(study.roles["identification"].files[0], inputs=["lat"], outputs=["phi"]).y[:, 0]
    np.testing.assert_allclose(mixed, 0.5 * lat + 0.02 * phi, atol=1e-12)  # lat is in percent
    with pytest.raises(ValueError, match=r"\[lat\]: phi = .x., expected int or float"):
        read_study(
            write_study(tmp_path, ("[records.identification]", columns.replace("2.0", '"x"')))
        )


def test_trim_values_guesses_and_bounds_of_the_study_reach_the_model(tmp_path):
    own = "[model.trim]\ng = 9.7\n[model.values]\nLp = -3\n[model.bounds]\nLp = [-5, -1]\n[channels"
    study = read_study(write_study(tmp_path, ("[channels", own)))
    assert (study.model.g, study.model.Lp) == (9.7, -3.0)
    assert study.bounds == {"Lp": (-5.0, -1.0)}


def test_bounds_the_wrong_way_round_are_told_as_that_beside_a_guess_between_them(tmp_path):
    own = "[model.values]\nLp = -3\n[model.bounds]\nLp = [-1, -5]\n[channels"
    with pytest.raises(ModelError, match=r"\[bounds\]: Lp: lower bound -1.0 > upper .*; swap or"):
        read_study(write_study(tmp_path, ("[channels", own)))


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


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[output_error]\npriors = { Mx = [-1.0, 0.1] }", r"\[output_error\] .*no parameter 'Mx'"),
        ("[match]\npriors = { Mx = [-1.0, 0.1] }", r"\[match\] .*no parameter 'Mx'"),
        ("[output_error]\ninterval = -1.0", r"\[output_error\] interval=-1"),
        ("[output_error]\nbiases = ['q']", r"\[output_error\] biases names 'q'"),
        (
            "[output_error]\ndomain = 'frequency'\nprocess_noise = true",
            r"\[output_error\] process_noise does not go with domain",
        ),
    ],
)
def test_settings_that_no_fit_would_take_are_refused_before_it(tmp_path, table, message):
    path = write_study(tmp_path)
    head, text = table.split("\n")[0], path.read_text()
    there = f"{head}\n" in text
    path.write_text(text.replace(head, table) if there else f"{text}\n{table}\n")
    with pytest.raises(ValueError, match=r"study\.toml: " + message):
        read_study(path)
