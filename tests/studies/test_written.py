"""A study that has not changed is taken as it lies: nothing computed, drawn or written again."""

import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
from truths.roll_study import write_study

from casid import read_study, run_study
from casid.studies.keeping import Watch
from casid.studies.written import origin
from casid.values import digest


def _kept(outcome):
    """Whether everything was taken as it was."""
    return all(timing.kept for timing in outcome.timings if timing.stage != "records")


def _state(folder):
    return {file: file.stat().st_mtime_ns for file in sorted(folder.rglob("*.*"))}


@pytest.mark.parametrize("fresh", [True, False])
@pytest.mark.parametrize("gone", ["*.py", "sweep.csv", "study.toml"])
def test_a_file_that_is_gone_since_the_study_was_read_is_named(tmp_path, gone, fresh):
    study = read_study(write_study(tmp_path))
    lost = next(tmp_path.glob(gone))
    lost.unlink()
    with pytest.raises(ValueError, match=f"{lost.name}: cannot read it as .*; check the path"):
        run_study(study, fresh=fresh)


def test_a_study_is_the_same_however_its_path_is_spelled_and_wherever_it_lies(
    tmp_path, monkeypatch
):
    (tmp_path / "a" / "b").mkdir(parents=True)
    path = write_study(tmp_path / "a")
    there = origin(read_study(path))
    for folder, spelled in ((tmp_path, "a/study.toml"), (tmp_path / "a" / "b", "../study.toml")):
        monkeypatch.chdir(folder)
        assert origin(read_study(spelled)) == there
    (tmp_path / "link").symlink_to(tmp_path / "a" / "b", target_is_directory=True)
    assert origin(read_study(tmp_path / "link" / ".." / "study.toml")) == there
    shutil.copytree(tmp_path / "a", tmp_path / "moved")
    assert origin(read_study(tmp_path / "moved" / "study.toml")) == there
    flight = next(tmp_path.glob("a/*.csv"))
    flight.write_text(flight.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert origin(read_study(path)) != there


@pytest.mark.slow
def test_nothing_changed_nothing_written_and_the_same_said(finished):
    before = _state(finished.report.parent)
    again = run_study(read_study(finished.report.parents[1] / "study.toml"))
    assert not _kept(finished)
    assert _kept(again)
    assert _state(finished.report.parent) == before
    for said in ("verdicts", "cautions", "headlines", "report"):
        assert getattr(again, said) == getattr(finished, said)
    assert digest(again.identification.results) == digest(finished.identification.results)
    assert again.validation.records == finished.validation.records


@pytest.mark.slow
def test_whatever_changes_or_is_lost_is_made_again(copy, request):
    path = copy / "study.toml"
    study = read_study(path)
    page = run_study(study).report.read_bytes()
    figure = min((study.output / "figures").iterdir())
    for break_ in (
        lambda: study.output.joinpath("report.html").write_text("edited", encoding="utf-8"),
        figure.unlink,
        lambda: study.output.joinpath("written.json").write_text("{", encoding="utf-8"),
    ):
        break_()
        outcome = run_study(read_study(path))
        assert not _kept(outcome)
        assert outcome.report.read_bytes() == page
        assert figure.exists()
    request.getfixturevalue("undrawn")
    record = next(iter(study.roles["validation"].files))
    record.write_text(record.read_text("utf-8") + "\n", encoding="utf-8")
    assert not _kept(run_study(read_study(path)))
    assert not _kept(run_study(replace(study, png=True)))
    assert not _kept(run_study(replace(study, png=True), fresh=True))


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_record_that_changed_while_the_study_ran_is_read_again(copy):
    study = read_study(copy / "study.toml")
    record = next(iter(study.roles["validation"].files))
    text = record.read_text("utf-8")

    class Recorder(Watch):
        def begin(self, stage):
            if stage == "report":
                record.write_text(text + "\n", encoding="utf-8")

    assert not _kept(run_study(replace(study, title="Once more"), watch=Recorder()))
    assert not _kept(run_study(replace(study, title="Once more")))
    assert _kept(run_study(replace(study, title="Once more")))


@pytest.mark.slow
def test_a_study_that_is_done_imports_nothing_that_draws(finished):
    path = finished.report.parents[1] / "study.toml"
    told = "import sys; from casid import read_study, run_study\n"
    told += f"run_study(read_study({str(path)!r}))\n"
    told += "print([name for name in ('matplotlib', 'scipy.optimize') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", told], check=True, capture_output=True, text=True)
    assert done.stdout.split("\n")[0] == "[]"


@pytest.mark.slow
def test_figures_of_an_earlier_state_go_and_files_of_others_stay(copy):
    path = copy / "study.toml"
    study = read_study(path)
    figures = study.output / "figures"
    run_study(replace(study, png=True))
    (figures / "own.png").write_bytes(b"notes")
    earlier = {file.name for file in figures.iterdir()}
    assert "rms.png" in earlier
    (copy / "random.csv").rename(copy / "later.csv")
    path.write_text(path.read_text("utf-8").replace("random.csv", "later.csv"), encoding="utf-8")
    for title in ("One", "Two"):  # what others put there is theirs in the second run too
        run_study(replace(read_study(path), title=title))
        left = {file.name for file in figures.iterdir()}
        assert [name for name in left if name.endswith(".png")] == ["own.png"]
        assert not [name for name in left if "random" in name]
        assert [name for name in earlier if "random" in name and name.endswith(".svg")]
        assert [name for name in left if "later" in name]
