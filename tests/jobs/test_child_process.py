"""Work in a process beside this one."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from casid.folder import claimed
from casid.jobs.child_process import beside


def test_the_result_is_that_of_the_work_done_elsewhere():
    with beside(os.getpid) as result:
        assert (result() != os.getpid()) == (len(os.sched_getaffinity(0)) > 1)


def test_with_one_processor_the_work_is_done_here(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with beside(os.getpid) as result:
        assert result() == os.getpid()


def test_work_that_fails_raises_here_what_it_raised_there():
    def fail():
        raise ValueError("a figure without data")

    with beside(fail) as result, pytest.raises(ValueError, match="a figure without data"):
        result()


def test_nobody_waits_for_work_when_the_other_half_fails():
    def interrupted():
        with beside(lambda: time.sleep(600)):
            raise RuntimeError("the other half")

    with pytest.raises(RuntimeError, match="the other half"):
        interrupted()


KILLED = """
import os, pathlib, signal, sys, time
from casid.folder import claimed
from casid.jobs.child_process import beside

def work():
    print(os.getpid(), flush=True)
    time.sleep(600)

with claimed(sys.argv[1]), beside(work):
    while not pathlib.Path(sys.argv[1], "killed").exists():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def _runs(process):
    try:
        said = Path(f"/proc/{process}/stat").read_text(encoding="ascii")
    except OSError:
        return False
    return said.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(
    not sys.platform.startswith("linux") or len(os.sched_getaffinity(0)) < 2, reason="no fork"
)
def test_nothing_is_left_of_a_run_that_was_killed(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        other = int(run.stdout.readline())
        assert _runs(other)
        (tmp_path / "killed").touch()
        assert run.wait(timeout=60) == -9
        with claimed(tmp_path):  # at once: the lock was never the other's
            pass
        patience = time.monotonic() + 20
        while _runs(other) and time.monotonic() < patience:
            time.sleep(0.02)
        if left := _runs(other):
            os.kill(other, 9)
    assert not left
