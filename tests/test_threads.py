"""Threads of linear algebra while casid computes, by what the libraries report."""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from threadpoolctl import threadpool_info, threadpool_limits
from truths.structures import Lag
from truths.sums import sharing
from truths.systems import LAG, white

from casid import (
    excitation,
    frequency_response,
    kinematic_check,
    match,
    output_error,
    pbsid,
    select_order,
    validate,
)
from casid.cli import main
from casid.commands.data import new_model_command
from casid.threads import alone, cores

RECORD = replace(white(LAG, np.random.default_rng(0), duration=60.0, noise=0.05), outputs=("x",))
OMEGA = np.array([1.5, 2.0, 3.0])
PBSID = {"order": 1, "past": 5, "future": 5, "pole": 2.0, "feedthrough": False}
CALLS = {
    "pbsid": lambda records: pbsid(records, **PBSID),
    "select_order": lambda records: select_order(records, orders=[1], pasts=[5], poles=[2.0]),
    "frequency_response": lambda records: frequency_response(records, omega=OMEGA),
    "output_error": lambda records: output_error(Lag(), records, interval=5.0),
    "match": lambda target: match(Lag(), target, norm="quadratic"),
    "kinematic_check": kinematic_check,
    "excitation": excitation,
    "validate": lambda records: validate({"truth": Lag()}, records),
}


def threads():
    """Threads of every library of linear algebra in this process."""
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


def reader():
    """Name of the module of casid that reads."""
    frame = sys._getframe(1)
    while not frame.f_globals["__name__"].startswith("casid"):
        frame = frame.f_back
    return frame.f_globals["__name__"]


class Watched(Sequence):
    """A sequence that notes how many threads there are whenever it is read to compute with it."""

    def __init__(self, *items):
        self.items, self.seen = items, set()

    def __len__(self):
        return len(self.items)

    def __getitem__(self, index):
        if reader() != "casid.checks":  # which looks at kinds only
            self.seen |= threads()
        return self.items[index]


@pytest.fixture(autouse=True)
def two_threads():
    """What the environment would have set."""
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("a library here has one thread only")
        yield


@pytest.mark.parametrize("name", CALLS)
def test_estimators_compute_with_one_thread_and_restore_the_rest(name):
    frequency = [frequency_response([RECORD], omega=OMEGA)]
    data = Watched(*frequency) if name == "match" else Watched(RECORD)
    CALLS[name](data)
    assert data.seen == {1}
    assert threads() == {2}


def test_an_error_restores_the_threads_too():
    with pytest.raises(ValueError, match="order"):
        pbsid([RECORD], **(PBSID | {"order": -1}))
    assert threads() == {2}


def test_commands_compute_with_one_thread(monkeypatch):
    seen = []
    monkeypatch.setattr(new_model_command, "callback", lambda **_: seen.append(threads()))
    assert CliRunner().invoke(main, ["new-model", "Own"]).exit_code == 0
    assert seen == [{1}]
    assert threads() == {2}


def _used(single):
    with alone(single):
        return sharing(None, None)


@pytest.mark.second
@pytest.mark.skipif(cores() < 2, reason="needs two processors")
def test_a_process_of_many_takes_all_cores_while_the_others_have_no_work():
    assert _used(False) == 2  # no process of many
    with ProcessPoolExecutor(1) as pool:
        assert [pool.submit(_used, single).result() for single in (False, True, False)] == [1, 2, 1]
