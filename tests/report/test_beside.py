"""Work in a process beside this one."""

import os
import time

import pytest

from casid.report.beside import beside


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
