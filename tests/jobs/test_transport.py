"""Model classes on their way to other processes."""

import pickle
import subprocess
import sys
import threading
from dataclasses import replace

import pytest
from truths.mixture import CASES, Mixture, record

from casid import ModelError, compare_bounds, load_model
from casid.jobs.transport import _restore, can_travel, refer, refuse_while_loading, resolve

MODEL = """
from casid import Model, Rows, Scalar, parameter

class Lag(Model):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=2.0, lower=0.1, upper=9.0, unit="1/s")

    def A(self) -> Rows:
        return [[-self.a]]

    def B(self) -> Rows:
        return [[1.0]]
"""


@pytest.mark.second
def test_a_class_travels_as_the_text_of_its_file(tmp_path):
    path = tmp_path / "lag.py"
    path.write_text(MODEL, encoding="utf-8")
    cls = load_model(f"{path}:Lag", "/")
    reference = refer(cls)
    assert can_travel(cls)
    assert resolve(reference) is cls  # here it is known
    path.unlink()  # a machine without the file
    code = (
        "import pickle, sys; from casid.jobs.transport import resolve; "
        "print(resolve(pickle.load(sys.stdin.buffer))().a)"
    )
    run = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(reference),
                         capture_output=True, check=True)  # fmt: skip
    assert run.stdout.strip() == b"2.0"


SCRIPT = """
import pickle, sys
from casid import Model, Rows, Scalar, parameter
from casid.jobs.transport import can_travel, refer

DRAG = 2.5

class Drag(Model):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    a: Scalar = parameter(default=2.0, lower=0.1, upper=9.0, unit="1/s")

    def A(self) -> Rows:
        return [[-DRAG * self.a]]

    def B(self) -> Rows:
        return [[1.0]]

assert can_travel(Drag)
pickle.dump(refer(Drag), sys.stdout.buffer)
"""
ELSEWHERE = """
import pickle, sys
from casid import match
from casid.jobs.transport import resolve

reference = pickle.load(sys.stdin.buffer)
cls = resolve(reference)
assert resolve(reference) is cls
fit = match(cls(), cls(a=3.0).system(), norm="quadratic")
print(fit.model.a, cls().system().A[0, 0], cls.infos()["a"].upper)
"""


@pytest.mark.slow
def test_a_class_of_the_script_that_runs_travels_with_what_it_uses():
    made = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, check=True)
    there = subprocess.run([sys.executable, "-c", ELSEWHERE],
                           input=made.stdout, capture_output=True, check=True)  # fmt: skip
    value, A, upper = map(float, there.stdout.split())
    assert (value, A, upper) == pytest.approx((3.0, -5.0, 9.0), rel=1e-6)


def local(gain):
    class Local(Mixture):
        """Declared in a function."""

        def scaled(self):
            return gain * 2.0

    return Local


@pytest.mark.second
def test_a_class_within_a_function_travels_and_is_told_from_another():
    cls = local(3.0)
    reference = refer(cls)
    assert can_travel(cls)
    assert not reference.path
    there = pickle.loads(pickle.dumps(reference))
    assert there.key == reference.key
    again = _restore(there)
    assert again().scaled() == 6.0
    assert pytest.approx(cls().system().A) == again().system().A

    class Local(Mixture):
        """Another of that name."""

        def scaled(self):
            return 7.0

    assert refer(Local).digest != reference.digest
    assert refer(local(3.5)).digest != reference.digest == refer(local(3.0)).digest
    found = compare_bounds(cls(), [record()], cases=CASES)
    assert [case.reason for case in found.cases if case.reason] == []


def test_a_class_that_holds_on_to_its_process_is_named():
    lock = threading.Lock()

    class Held(Mixture):
        """Nobody else can have its lock."""

        def scaled(self):
            return lock

    assert not can_travel(Held)
    unknown = replace(refer(Held), name="Other")
    with pytest.raises(ModelError, match="Other uses what no other process can have"):
        resolve(unknown)


def test_a_study_that_begins_while_its_model_is_read_is_refused(monkeypatch):
    monkeypatch.setattr("casid.jobs.transport._LOADING", ["Lag"])
    with pytest.raises(ModelError, match="the file of Lag runs a study when other processes read"):
        refuse_while_loading()
