"""Where jobs run: processes that die, executors that fail, interrupts."""

import json
import logging
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits
from truths.mixture import Inline
from truths.sums import HERE, add, job, results, surroundings

from casid import Execution
from casid.jobs.campaigns import run_jobs
from casid.jobs.child_process import FORKS

TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("executor", [Inline, ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_gives_the_same_results(executor):
    jobs = [job("a", 1), job("b", None, "a"), job("c", 10, "b", "a"), job("d", 3, "a")]
    with executor() as pool:
        done = run_jobs(add, jobs, Execution(executor=pool))
    assert results(done) == results(run_jobs(add, jobs))


@pytest.mark.slow
def test_a_job_that_kills_its_process_is_a_row_and_the_others_go_on():
    jobs = [job(str(k), k) for k in range(5)] + [job("bad", "die"), job("after", 1, "bad")]
    done = run_jobs(add, jobs)
    assert done["bad"].reason == "the process it ran in died"
    assert [done[str(k)].result for k in range(5)] == list(range(5))
    assert done["after"].result == 1


@pytest.mark.skipif(not FORKS, reason="processes are new ones")
def test_processes_have_what_is_loaded_here_and_neither_logs_handlers_nor_threads(
    monkeypatch, caplog
):
    caplog.set_level(logging.INFO, logger="casid")
    monkeypatch.setitem(HERE, "told", "before")
    before = signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        with threadpool_limits(2, "blas"):
            done = run_jobs(surroundings, [job(str(k), k) for k in range(5)])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert [each.result for each in done.values()] == 5 * [["before", False, True, 1]]
    assert logging.getLogger("casid").isEnabledFor(logging.INFO)


class Broken(Executor):
    """Loses every job."""

    def submit(self, fn, /, *args, **kwargs):  # noqa: ARG002
        future = Future()
        future.set_exception(RuntimeError("network down"))
        return future


def test_an_executor_that_fails_leaves_reasons_and_nothing_in_the_folder(tmp_path):
    done = run_jobs(add, [job("a", 1)], Execution(folder=tmp_path, executor=Broken()))
    assert done["a"].reason == "RuntimeError: network down"
    assert not list(tmp_path.iterdir())


INTERRUPTED = """
import sys
sys.path[:0] = [{root!r}, {tests!r}]
from casid import Execution, compare_bounds
from truths.mixture import Mixture, record
from truths.sums import add, job, results

if __name__ == "__main__":
    cases = {{str(k): {{"a": [0.01 * k, 2.0]}} for k in range(60)}}
    compare_bounds(Mixture(), record(), cases=cases, execution=Execution(folder={folder!r}))
"""


def left(group):
    """Whether a process of a group lives."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_an_interrupt_ends_all_processes_with_one_traceback_and_keeps_what_is_finished(tmp_path):
    text = INTERRUPTED.format(root=str(TESTS.parent), tests=str(TESTS), folder=str(tmp_path))
    process = subprocess.Popen(
        [sys.executable, "-c", text], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 100
    while not list(tmp_path.glob("*.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process
    said = process.communicate(timeout=60)[1]
    assert process.returncode not in {0, None}
    assert said.count("Traceback") == 1
    assert said.rstrip().endswith("KeyboardInterrupt")
    kept = list(tmp_path.glob("*.json"))
    assert 1 <= len(kept) < 60
    assert all(json.loads(path.read_text(encoding="utf-8"))["reason"] == "" for path in kept)
    deadline = time.monotonic() + 30
    while left(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not left(process.pid)


@pytest.mark.slow
def test_no_process_outlives_a_study_that_was_killed(tmp_path):
    text = INTERRUPTED.format(root=str(TESTS.parent), tests=str(TESTS), folder=str(tmp_path))
    command = [sys.executable, "-c", text]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    patience = time.monotonic() + 100
    while not list(tmp_path.glob("*.json")) and time.monotonic() < patience:
        time.sleep(0.02)
    process.kill()
    try:
        process.communicate(timeout=60)  # ends when no process of the study can write any more
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    assert process.returncode == -signal.SIGKILL
    assert len(list(tmp_path.glob("*.json"))) < 60


class Interrupted(Inline):
    """A process of the user's executor takes the interrupt."""

    def submit(self, fn, /, *args, **kwargs):  # noqa: ARG002
        future = Future()
        future.set_exception(KeyboardInterrupt())
        return future


def test_an_interrupt_in_an_executor_of_the_users_is_one(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_jobs(add, [job("a", 1)], Execution(folder=tmp_path, executor=Interrupted()))
    assert not list(tmp_path.iterdir())
