"""Model classes on their way to other processes."""

import pickle
import subprocess
import sys

import pytest
from truths.mixture import CASES, Mixture, record

from casid import ModelError, compare_bounds, load_model
from casid.jobs.transport import can_travel, refer, refuse_while_loading, resolve

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


def test_a_class_within_a_function_stays_and_its_study_runs_here():
    class Local(Mixture):
        """Nobody else can import this."""

    assert not can_travel(Local)
    found = compare_bounds(Local(), [record()], cases=CASES)
    assert not any(case.reason for case in found.cases)
    reference = refer(Local)
    unknown = type(reference)(name=reference.name, path="", text="")
    with pytest.raises(ModelError, match="no file of its own"):
        resolve(unknown)


def test_a_study_that_begins_while_its_model_is_read_is_refused(monkeypatch):
    monkeypatch.setattr("casid.jobs.transport._LOADING", ["Lag"])
    with pytest.raises(ModelError, match="the file of Lag runs a study when other processes read"):
        refuse_while_loading()
