"""Jobs on executors: order, failures, what is kept, and what a kill leaves."""

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from truths.mixture import CASES, Inline, Mixture, record
from truths.sums import add, job, results, sharing

from casid import Execution, OutputError, SolverOptions, compare_bounds
from casid.jobs.campaigns import CampaignProgress, run_jobs
from casid.jobs.store import Store
from casid.threads import cores

TESTS = Path(__file__).parents[1]


def test_a_job_starts_from_the_nearest_that_succeeded():
    jobs = [job("a", 1), job("b", None, "a"), job("c", 10, "b", "a"), job("d", 100, "c", "a")]
    done = run_jobs(add, jobs)
    assert results(done) == {
        "a": (1, "", ""), "b": (None, "ValueError: nothing to add", "a"), "c": (11, "", "a"),
        "d": (111, "", "c"),
    }  # fmt: skip


def test_an_unfinished_job_shows_its_best_but_starts_no_other():
    done = run_jobs(add, [job("a", "best"), job("b", 1, "a")])
    assert results(done) == {"a": (7, "halfway", ""), "b": (1, "", "")}


def test_a_job_that_is_nothing_alone_is_left_out_where_its_start_failed(tmp_path):
    jobs = [job("a", None), job("b", 1, "a", alone=False), job("c", 1, "b", alone=False)]
    kept = Execution(folder=tmp_path / "study")
    seen: list[CampaignProgress] = []
    done = run_jobs(add, [*jobs, job("d", 2)], replace(kept, progress=seen.append))
    assert results(done) == {
        "a": (None, "ValueError: nothing to add", ""), "b": (None, "not tried, as a failed", ""),
        "c": (None, "not tried, as b failed", ""), "d": (2, "", ""),
    }  # fmt: skip
    assert seen[-1].done == seen[-1].total == 4
    again = run_jobs(add, [job("a", 1, key="mended"), *jobs[1:]], kept)
    assert results(again) == {"a": (1, "", ""), "b": (2, "", "a"), "c": (3, "", "b")}


@pytest.mark.second
@pytest.mark.skipif(cores() < 2, reason="needs two processors")
def test_a_job_on_which_all_others_wait_has_all_processors():
    done = run_jobs(sharing, [job("a", 1), *(job(name, 1, "a") for name in "bcdef")])
    assert [each.result for each in done.values()] == [2, 1, 1, 1, 1, 1]


def test_what_starts_from_a_long_job_is_done_first():
    seen: list[CampaignProgress] = []
    jobs = [job("a", 1), job("b", "long"), job("c", 1, "a"), job("d", 1, "b"), job("e", 1, "b")]
    run_jobs(add, jobs, Execution(progress=seen.append), here=True)
    assert [each.name for each in seen[2:]] == ["d", "e", "c"]


def test_finished_jobs_are_taken_from_the_folder_unless_their_key_differs(tmp_path):
    kept = Execution(folder=tmp_path / "study")
    first = run_jobs(add, [job("a", 1), job("b", None)], kept)
    again = run_jobs(add, [job("a", 5), job("b", 5)], kept)
    assert results(again) == results(first)
    assert again["a"].kept
    assert run_jobs(add, [job("a", 5, key="other")], kept)["a"].result == 5
    Store(kept.folder).path("b").write_text("{", encoding="utf-8")
    assert run_jobs(add, [job("b", 3)], kept)["b"].result == 3


def test_a_folder_that_cannot_keep_results_is_refused_before_any_is_made(tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", "a\0b"):
        seen: list[CampaignProgress] = []
        with pytest.raises(ValueError, match=r"^folder .*cannot write results there .*name one"):
            run_jobs(add, [job("a", 1)], Execution(folder=folder, progress=seen.append))
        assert seen == []


def test_progress_tells_how_long_the_rest_may_take():
    seen: list[CampaignProgress] = []
    run_jobs(add, [job("a", 1), job("b", None), job("c", 2)], Execution(progress=seen.append))
    assert [(each.done, each.total, each.failed) for each in seen] == [
        (1, 3, 0), (2, 3, 1), (3, 3, 1)]  # fmt: skip
    assert seen[0].remaining == pytest.approx(2 * seen[0].elapsed)
    assert "left" in str(seen[0])
    assert "1 failed" in str(seen[-1])
    assert "left" not in str(seen[-1])


# ---- studies -------------------------------------------------------------------------------------

SCRIPT = """
import sys, time
sys.path[:0] = [{root!r}, {tests!r}]
from casid import Execution, compare_bounds
from truths.mixture import CASES, Inline, Mixture, record
from truths.sums import add, job, results, sharing

if __name__ == "__main__":
    found = compare_bounds(Mixture(), [record()], cases=CASES,
                           execution=Execution(folder={folder!r}, {more}))
    found.to_csv({folder!r} + ".csv")
"""


def tables(path):
    return [path.with_name(path.name + end).read_bytes() for end in (".csv", "_cases.csv")]


def run_script(folder, more="executor=Inline()"):
    text = SCRIPT.format(root=str(TESTS.parent), tests=str(TESTS), folder=str(folder), more=more)
    return subprocess.Popen([sys.executable, "-c", text])


@pytest.mark.slow
def test_a_killed_study_resumes_to_the_result_of_an_uninterrupted_one(tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert run_script(whole).wait() == 0
    process = run_script(killed, "executor=Inline(), progress=lambda _: time.sleep(1)")
    while len(list(killed.glob("*.json"))) < 2 and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {path.name: path.stat().st_mtime_ns for path in killed.glob("*.json")}
    assert 2 <= len(kept) < len(CASES)
    assert not (tmp_path / "killed.csv").exists()
    for path in killed.glob("*.json"):  # whole files only
        json.loads(path.read_text(encoding="utf-8"))
    assert run_script(killed).wait() == 0
    assert tables(killed) == tables(whole)
    after = {path.name: path.stat().st_mtime_ns for path in killed.glob("*.json")}
    assert kept.items() <= after.items()  # these were not computed again


@pytest.mark.slow
def test_a_dask_cluster_runs_the_same_call(tmp_path):
    distributed = pytest.importorskip("distributed")
    here = compare_bounds(
        Mixture(), [record()], cases=CASES, execution=Execution(executor=Inline())
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask's own, about ports and closing loops
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None,
            local_directory=str(tmp_path),
        )  # fmt: skip
        with cluster, distributed.Client(cluster) as client:
            there = compare_bounds(
                Mixture(),
                record(),
                cases=CASES,
                execution=Execution(executor=client.get_executor()),
            )
    assert there.to_markdown() == here.to_markdown()


OF_THE_SCRIPT = """
import sys, warnings
sys.path[:0] = [{root!r}, {tests!r}]
from casid import Execution, compare_bounds
from truths.mixture import CASES, Inline, Mixture, record

GAIN = 2.0

class Own(Mixture):
    def scaled(self):
        return GAIN

if __name__ == "__main__":
    import distributed
    warnings.simplefilter("ignore")
    assert Own.__module__ == "__main__"
    here = compare_bounds(Own(), [record()], cases=CASES, execution=Execution(executor=Inline()))
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None,
                                       local_directory={folder!r})
    with cluster, distributed.Client(cluster) as client:
        there = compare_bounds(Own(), [record()], cases=CASES,
                               execution=Execution(executor=client.get_executor()))
    assert not any(case.reason for case in there.cases), there.to_markdown()
    assert there.to_markdown() == here.to_markdown()
    print("alike")
"""


@pytest.mark.campaign
def test_a_class_of_the_script_that_runs_travels_to_dask_workers(tmp_path):
    pytest.importorskip("distributed")
    script = tmp_path / "own.py"
    text = OF_THE_SCRIPT.format(root=str(TESTS.parent), tests=str(TESTS), folder=str(tmp_path))
    script.write_text(text, encoding="utf-8")
    done = subprocess.run([sys.executable, script], check=False, capture_output=True, text=True)
    assert done.stdout == "alike\n", done.stderr


# ---- interrupts ----------------------------------------------------------------------------------


@pytest.mark.second
def test_an_interrupted_case_is_no_result_and_the_next_run_goes_on(tmp_path):
    seen = []

    def interrupt(progress):
        seen.append(progress.iteration)
        if len(seen) == 4:
            os.kill(os.getpid(), signal.SIGINT)

    watched = OutputError(solver=SolverOptions(progress=interrupt))
    given = {"cases": {"free": {}, "tie": ["a = 2 b"]}, "execution": Execution(folder=tmp_path)}
    with pytest.raises(KeyboardInterrupt):
        compare_bounds(Mixture(), record(), estimator=watched, **given)
    kept = {path.name for path in tmp_path.glob("*.json")}
    assert kept < {"free.json", "tie.json"}
    found = compare_bounds(Mixture(), record(), **given)
    assert not any(case.reason for case in found.cases)
