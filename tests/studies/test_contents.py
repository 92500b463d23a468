"""What a study hands to its report."""

from hashlib import sha256
from types import SimpleNamespace

import pytest
from truths.roll_study import write_study

from casid import read_study, run_study
from casid.consistency.reused_flights import Repeats
from casid.stages.stage import StageResults
from casid.studies.contents import _settings, _units, content


@pytest.mark.slow
def test_a_validation_record_that_an_estimation_has_seen_is_told(copy):
    study = read_study(write_study(copy, ('["random.csv"]', '["sweep.csv"]')))
    text = run_study(study).report.read_text(encoding="utf-8")
    assert "Record sweep is for validation, but an estimation has seen it" in text


@pytest.mark.slow
def test_a_copy_under_another_name_is_no_unseen_record_and_no_second_flight(tmp_path):
    path = write_study(tmp_path)
    (tmp_path / "copy.csv").write_bytes((tmp_path / "sweep.csv").read_bytes())
    text = path.read_text(encoding="utf-8").replace('["random.csv"]', '["copy.csv"]')
    path.write_text(text.replace('"sweep.csv"]', '"sweep.csv", "again.csv"]'), encoding="utf-8")
    (tmp_path / "again.csv").write_bytes((tmp_path / "3211.csv").read_bytes())
    page = run_study(read_study(path)).report.read_text(encoding="utf-8")
    assert "Record copy is for validation, but an estimation has seen it (as sweep)" in page
    assert "Records 3211 and again are the same flight: it counts twice" in page
    assert "judged on records that estimations had seen (copy)" in page
    assert "no estimation had seen" not in page


def test_a_structure_s_own_units_count_and_those_stated_of_columns_more():
    model = SimpleNamespace(units={"V": "m/s", "alpha": "rad", "power": "W"})
    stated = SimpleNamespace(units={"alpha": "deg", "power": "kn"})
    found = _units(SimpleNamespace(model=model, channels=stated))
    assert (found["V"], found["alpha"], found["power"]) == ("m/s", "rad", "m/s")
    assert found["p"] == "rad/s"
    assert "valve" not in found


@pytest.mark.second
def test_the_page_has_digests_of_all_that_a_structure_imports_and_reads(tmp_path, monkeypatch):
    path = write_study(tmp_path)
    model = (tmp_path / "roll.py").read_text(encoding="utf-8").replace("self.g]", "gravity()]")
    (tmp_path / "roll.py").write_text(f"from forces import gravity\n{model}", encoding="utf-8")
    (tmp_path / "forces.py").write_text(
        "from pathlib import Path\n"
        "def gravity(): return float(Path(__file__).with_name('g.txt').read_text())\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)

    def told(number):
        (tmp_path / "g.txt").write_text(number, encoding="utf-8")
        nothing = StageResults(results={}, models={}, failures={})
        found = content(read_study(path), {}, Repeats(), nothing, (), ())
        return found.model_files, found.settings["equations"]

    files, equations = told("9.80665")
    assert files == {
        name: sha256((tmp_path / name).read_bytes()).hexdigest()
        for name in ("roll.py", "forces.py")
    }
    assert told("9.80665") == (files, equations)
    assert told("9.81")[0] == files
    assert told("9.81")[1] != equations


def test_settings_name_every_table_and_what_differs_from_the_usual(tmp_path):
    table = '[sufficiency]\n\n[qualification.tolerances]\np = "2 deg/s"\nphi = "1 deg"\n\n[match]'
    said = _settings(read_study(write_study(tmp_path, ("[match]", table))))
    assert said["sufficiency"] == "as usual"
    assert said["qualification.tolerances"] == "p: 2 deg/s, phi: 1 deg"
    assert "qualification.source" not in said
    assert not any(value in {"", "[]"} for value in said.values())


def test_settings_name_what_makes_channels_of_columns_and_what_a_model_begins_with(tmp_path):
    columns = '[channels]\ntime = "t"\n[channels.columns]\nlat = { lat = 0.5, phi = 0.1 }\n'
    model = 'file = "roll.py:Roll"\nvalues = { Lp = -2.5 }\n'
    changes = ("[channels.units]", columns + "[channels.units]"), ('file = "roll.py:Roll"\n', model)
    files = 'files = ["3211.csv", "sweep.csv"]\n'
    changes += ((files, files + 'trim = { "3211*" = { v = 2.0 } }\n'),)
    design = "[design]\nduration = 12.0\n\n[match]"
    said = _settings(read_study(write_study(tmp_path, *changes, ("[match]", design))))
    assert said["channels.columns"] == "lat: lat: 0.5, phi: 0.1"
    assert said["channels.units"] == "lat: %"
    assert said["model.Lp"] == "-2.5"
    assert said["design.duration"] == "12.0"
    assert said["records.identification.trim.3211*"] == "v: 2.0"
    assert not {"channels.time", "channels.dt", "model.Llat"} & said.keys()


def test_files_of_a_second_logger_are_told_with_their_digests(tmp_path):
    path = write_study(tmp_path)
    second = '[channels.join]\nfile = "{name}_nav.csv"\nchannels = ["phi"]\n'
    text = path.read_text().replace("[records.id", f"{second}[records.id", 1)
    path.write_text(f'{text}\n[records.refinement]\nfiles = ["3211.csv"]\n')
    for name in ("3211", "sweep", "random"):
        (tmp_path / f"{name}_nav.csv").write_text(f"t,phi\n0,{len(name)}\n")
    said = _settings(read_study(path))["channels.join.files"]
    assert said.startswith("SHA-256 ")
    for name in ("3211", "sweep", "random"):
        held = (tmp_path / f"{name}_nav.csv").read_bytes()
        assert said.count(f"{name}_nav.csv {sha256(held).hexdigest()}") == 1
    assert "channels.join.files" not in _settings(read_study(write_study(tmp_path)))
