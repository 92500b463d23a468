"""Faults: killed, no room left, no permission, a clock that jumps, two runs at once, IPOPT failing.

Whatever happens: results of before stay whole and readable, and the same command goes on.
"""

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from truths.roll_study import write_study

import casid.nlp
from casid import Fit
from casid.cli import main
from casid.folder import claimed
from casid.structure.modelfile import load_model

STAGES = ("pbsid", "quadratic", "hinf", "output_error")
BASELINE = """
[records.frequency]
files = ["sweep.csv"]
noise = true

[frequency]
omega = { from = 0.6, to = 5, points = 20 }

[derivid]
"""
IDENTIFY = "from casid.cli import main; main()"
COMPARE = """
import sys
from casid import Execution, OutputError, compare_bounds
from casid.studies.study import read_records
from casid.studies.studyfile import read_study

study = read_study(sys.argv[2])
cases = {"free": {}, "signs": {"Lv": "< 0"}, "narrow": {"Lp": (-2.5, -1.0)}}
result = compare_bounds(
    study.model, read_records(study)["identification"], cases=cases,
    estimator=OutputError(interval=2.0), execution=Execution(folder=study.output / "bounds"),
)
result.to_csv(study.output / "bounds.csv")
"""
PROGRAMS = {"identify": IDENTIFY, "bounds": IDENTIFY, "compare_bounds": COMPARE}
CASES = """
[bounds]
estimator = "output_error"

[bounds.cases]
free = {}
signs = {Lv = "< 0"}
"""


def identify(study, *options):
    return CliRunner().invoke(main, ["identify", str(study), *options])


def start(program, study, command="identify", **environment):
    quiet = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", program, command, str(study)], stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, env=os.environ | quiet | environment, start_new_session=True,
    )  # fmt: skip


def check_whole(folder):
    """Every file of results is whole; returns their names."""
    found = [path for path in (folder / "out").rglob("*")
             if path.is_file() and not path.name.startswith(".")]  # fmt: skip
    for path in found:
        data = path.read_bytes()
        if path.suffix == ".json":
            json.loads(data)
        ends = {".html": b"</html>", ".svg": b"</svg>", ".png": b"IEND\xaeB`\x82"}
        assert data.rstrip(b"\n").endswith(ends.get(path.suffix, b"")), path
    if (folder / "out/fit.json").exists():
        Fit.load(folder / "out/fit.json", model=load_model("roll.py:Roll", folder))
    return {path.relative_to(folder / "out").as_posix() for path in found}


def results(folder):
    """What a study found, without the time it took."""
    table = (folder / "out/parameters.csv").read_text(encoding="utf-8")
    fit = json.loads((folder / "out/fit.json").read_text(encoding="utf-8"))
    return table, fit["cost"], fit["covariance"]


# ---- killed ------------------------------------------------------------------------------------


def kill_again_and_again(program, study, times, rng, command="identify"):
    """Kill a program at random moments; every start goes on where the one before was killed."""
    begin = time.monotonic()
    assert start(program, study, command).wait(300) == 0
    longest = time.monotonic() - begin
    before = check_whole(study.parent)
    landed = 0
    while landed < times:
        process = start(program, study, command)
        try:
            process.wait(rng.uniform(0, longest))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            landed += 1
        else:  # it was faster: change something it depends on, and it begins again
            text = study.read_text(encoding="utf-8")
            title = f"seed = {1 if 'seed = 2' in text else 2}"
            study.write_text(text.replace("seed = 1", title).replace("seed = 2", title), "utf-8")
        assert before <= check_whole(study.parent)


@pytest.mark.campaign
def test_a_killed_study_loses_nothing_and_goes_on(copy):
    expected = results(copy)
    kill_again_and_again(IDENTIFY, copy / "study.toml", 3, random.Random(1))
    (copy / "study.toml").write_text(
        (copy / "study.toml").read_text(encoding="utf-8").replace("seed = 2", "seed = 1"), "utf-8"
    )
    assert identify(copy / "study.toml").exit_code == 0
    assert results(copy) == expected
    assert identify(copy / "study.toml", "--fresh").exit_code == 0  # the next run that writes
    assert not list((copy / "out").rglob(".*.partial"))


@pytest.mark.campaign
@pytest.mark.parametrize("command", PROGRAMS)
def test_a_command_killed_fifty_times_loses_nothing_and_goes_on(command, copy):
    study, program = copy / "study.toml", PROGRAMS[command]
    study.write_text(study.read_text(encoding="utf-8") + CASES, encoding="utf-8")
    asked = "bounds" if command == "bounds" else "identify"
    kill_again_and_again(program, study, 50, random.Random(2), asked)
    assert start(program, study, asked).wait(300) == 0
    check_whole(copy)


# ---- no room, no permission --------------------------------------------------------------------


@contextmanager
def largest_file(size):
    """No file may grow beyond a size [bytes], as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.parametrize("size", [0, 30_000, 300_000])
def test_a_full_disk_leaves_earlier_results_and_the_same_command_goes_on(size, copy):
    before, names = results(copy), check_whole(copy)
    shown = [copy / "out" / name for name in names if not name.startswith("stages")]
    held = {path: path.read_bytes() for path in shown}
    text = (copy / "study.toml").read_text(encoding="utf-8")
    (copy / "study.toml").write_text(text.replace("points = 20", "points = 12"), "utf-8")
    with largest_file(size):
        result = identify(copy / "study.toml")
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert "Cannot read or write: " in said
    assert "File too large" in said
    assert "earlier results are kept; make room" in said
    assert check_whole(copy) >= names
    assert not list((copy / "out").rglob(".*.partial"))
    assert {path: path.read_bytes() for path in shown} == held  # page, figures, fit and table
    assert results(copy) == before
    if size == 0:  # not even a stage's result fits
        assert identify(copy / "study.toml").exit_code == 0


@pytest.mark.parametrize(
    "command",
    [
        "convert 3211.csv a.csv",
        "convert 3211.csv a.mat",
        "convert 3211.csv a.mat --mat-version 7.3",
        "convert 3211.csv a.parquet",
        "new-model b",
    ],
)
def test_on_a_full_disk_a_command_leaves_files_as_they_were(command, tmp_path, monkeypatch):
    write_study(tmp_path)
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "a.mat", "a.parquet"):
        Path(name).write_text("of before", encoding="utf-8")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with largest_file(1000):
        result = CliRunner().invoke(main, command.split())
    assert result.exit_code == 2, result.output
    assert "File too large" in result.stderr
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert CliRunner().invoke(main, command.split()).exit_code == 0


@contextmanager
def unprivileged():
    """Root ignores permissions: be nobody for a while."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@pytest.mark.parametrize("which", ["the folder of results", "the folder around it"])
@pytest.mark.second
def test_a_read_only_folder_is_named_with_the_remedy(which, finished):
    assert finished.report.exists()  # libraries are read while root may read them
    with tempfile.TemporaryDirectory() as name:  # pytest's own is closed to others
        folder = Path(name)
        study = write_study(folder)
        if which == "the folder of results":
            (folder / "out").mkdir()
            (folder / "out").chmod(0o555)
        folder.chmod(0o555)
        with unprivileged():
            result = identify(study)
        folder.chmod(0o755)
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert "cannot write results there (Permission denied)" in said
    assert "name a folder that can be written to, in the study or by --output" in said


def test_a_file_in_a_read_only_folder_is_named_as_the_user_did():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_study(folder)
        target = folder / "a.mat"
        assert (
            CliRunner().invoke(main, ["convert", str(folder / "3211.csv"), str(target)]).exit_code
            == 0
        )
        target.unlink()  # libraries are read now, while root may read them
        folder.chmod(0o555)
        with unprivileged():
            result = CliRunner().invoke(main, ["convert", str(folder / "3211.csv"), str(target)])
        folder.chmod(0o755)
        assert result.exit_code == 2, result.output
        assert f"Permission denied: '{target}'" in result.stderr
        assert not target.exists()


@pytest.mark.slow
def test_results_that_became_read_only_stay_and_are_named(copy):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(shutil.copytree(copy, Path(name) / "study"))
        for path in (folder, folder.parent):
            path.chmod(0o755)
        (folder / "out/.lock").chmod(0o666)
        before = results(folder)
        study = folder / "study.toml"
        with unprivileged():
            assert identify(study).exit_code == 0  # nothing is to be written
        study.write_text(study.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
        with unprivileged():
            result = identify(study)
        assert result.exit_code == 2, result.output
        assert "Permission denied" in result.stderr
        assert str(folder / "out") in result.stderr
        assert results(folder) == before


# ---- two runs, and the clock -------------------------------------------------------------------


def test_a_folder_that_another_run_holds_is_refused(tmp_path):
    study = write_study(tmp_path)
    with claimed(tmp_path / "out"):
        result = identify(study)
        said = " ".join(result.stderr.split())
        assert result.exit_code == 2
        assert f"another run is writing there (process {os.getpid()})" in said
        assert "wait for its end, or name another folder by --output" in said
        assert [path.name for path in (tmp_path / "out").iterdir()] == [".lock"]


def test_a_design_in_a_folder_that_another_run_holds_is_refused(tmp_path):
    study = write_study(tmp_path)
    with claimed(tmp_path / "out"):
        result = CliRunner().invoke(main, ["design", str(study)])
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert said.endswith(f"another run is writing there (process {os.getpid()}); wait for its end")
    assert not (tmp_path / "out/design").exists()


def test_what_a_killed_run_left_behind_is_cleared(tmp_path):
    (tmp_path / "stages").mkdir()
    for left in (tmp_path / ".fit.json.abc.partial", tmp_path / "stages/.hinf.json.abc.partial"):
        left.write_text("{", encoding="utf-8")
    (tmp_path / "mine.partial").write_text("the user's", encoding="utf-8")
    with claimed(tmp_path):
        pass
    left = {path.name for path in tmp_path.rglob("*")}
    assert left == {"stages", "mine.partial", ".lock"}


@pytest.mark.campaign
def test_of_two_runs_at_once_one_ends_and_one_is_refused(copy):
    study = copy / "study.toml"
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace("points = 20", "points = 12"), encoding="utf-8")
    runs = [start(IDENTIFY, study) for _ in range(2)]
    assert sorted(run.wait(120) for run in runs) == [0, 2]
    assert "report.html" in check_whole(copy)


CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>

int clock_gettime(clockid_t which, struct timespec *now)
{
    static long calls;
    int (*real)(clockid_t, struct timespec *) = dlsym(RTLD_NEXT, "clock_gettime");
    int status = real(which, now);
    if (which == CLOCK_REALTIME && ++calls > atol(getenv("JUMP_AFTER")))
        now->tv_sec += atol(getenv("JUMP_BY"));
    return status;
}
"""


@pytest.mark.campaign
@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler to build the clock with")
@pytest.mark.parametrize("days", [400, -400])
def test_a_clock_that_jumps_changes_no_result(days, copy, tmp_path):
    (tmp_path / "clock.c").write_text(CLOCK, encoding="utf-8")
    clock = tmp_path / "clock.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-o", clock, tmp_path / "clock.c", "-ldl"], check=True
    )
    expected = results(copy)
    for kept in (copy / "out/stages").glob("*.json"):  # all to be computed again
        kept.unlink()
    jump = {"LD_PRELOAD": str(clock), "JUMP_AFTER": "20", "JUMP_BY": str(days * 86400)}
    assert start(IDENTIFY, copy / "study.toml", **jump).wait(120) == 0
    assert results(copy) == expected
    second = identify(copy / "study.toml")  # files of the future or the past are taken as well
    assert second.exit_code == 0
    assert next(x for x in second.output.splitlines() if x[:6] == "report").endswith("kept")


# ---- IPOPT -------------------------------------------------------------------------------------


def failing(monkeypatch, beginning):
    """IPOPT stops early in every solve whose name begins so, and no steps go on from there."""
    real = casid.nlp.solve

    def solve(problem, options, *, stage, warm=None):
        found = real(problem, options, stage=stage, warm=warm)
        stopped = "no feasible step found; start nearer"
        fails = stage.startswith(beginning)
        return replace(found, success=False, status=stopped) if fails else found

    for module in ("matching.programme", "shooting.search"):
        monkeypatch.setattr(f"casid.{module}.solve", solve)
    monkeypatch.setattr("casid.shooting.search.completed", lambda _, __, found, *___: found)


SOLVES = {"quadratic": "match quadratic", "hinf": "match hinf", "output_error": "output error",
          "derivid": "derivid"}  # fmt: skip


def rewind(folder, stage):
    """Forget a stage and all after it; returns those before."""
    order = STAGES
    if stage == "derivid":
        order = ("pbsid", "frequency", *STAGES[1:], "derivid")
        study = folder / "study.toml"
        study.write_text(study.read_text(encoding="utf-8") + BASELINE, encoding="utf-8")
    before = order[: order.index(stage)]
    for kept in (folder / "out/stages").glob("*.json"):
        if kept.stem not in before:
            kept.unlink()
    (folder / "out/fit.json").unlink()
    return before


@pytest.mark.slow
@pytest.mark.parametrize("stage", SOLVES)
def test_when_ipopt_fails_the_chain_says_so_and_offers_its_best_iterate(stage, copy, request):
    before = rewind(copy, stage)
    with pytest.MonkeyPatch.context() as patch:
        failing(patch, SOLVES[stage])
        result = identify(copy / "study.toml")
    said = " ".join(result.stderr.split())
    assert result.exit_code == 3, result.output
    assert "No convergence" in said
    assert "no feasible step found; start nearer" in said
    assert f"{stage}_best.json (Fit.load reads it" in said
    structure = load_model("roll.py:Roll", copy)
    best = Fit.load(copy / f"out/stages/{stage}_best.json", model=structure)
    assert best.success is False
    assert structure.infos()["Lp"].lower <= best["Lp"].value <= structure.infos()["Lp"].upper
    kept = {path.stem for path in (copy / "out/stages").glob("*.json")}
    assert kept == {*before, f"{stage}_best"}
    # Nothing rests on the baseline: the model and the report are there without it.
    page = (copy / "out/report.html").read_text(encoding="utf-8")
    assert (copy / "out/fit.json").exists() == (stage == "derivid")
    assert ("The frequency-domain fit is missing" in page) == (stage == "derivid")
    request.getfixturevalue("undrawn")
    again = identify(copy / "study.toml")
    assert again.exit_code == 0
    assert again.output.count("kept") == len(before)
