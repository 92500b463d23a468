"""What code reads from around it: equations follow a notebook's numbers, cells run again or not."""

from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from casid.code_dependencies import surroundings

CELL = """
from casid import Model, NonlinearModel, Rows, Scalar, parameter
from types import SimpleNamespace
import math
import numpy as np

MASS = 1000.0
GAINS = [1.0, 2.0]
TABLE = np.array([0.0, 1.0])
OTHER = 7.0
config = SimpleNamespace(arm=3.0)

class Constants:
    g = 9.81

def halved(x):
    return x * FACTOR

FACTOR = 0.5

class Heave(Model):
    states, inputs, outputs = ("w",), ("col",), ("az",)
    scale = 4.0
    Zw: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.Zw * self.scale]]

    def B(self) -> Rows:
        return [[halved(GAINS[1] / MASS) + sum(x * config.arm for x in TABLE)]]

    def C(self) -> Rows:
        return [[Constants.g]]

    def D(self) -> Rows:
        return [[math.pi]]

class Falling(NonlinearModel):
    states, inputs, outputs = ("w",), ("col",), ("w",)
    Zw: Scalar = parameter(default=-0.5, lower=-5.0, upper=0.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.Zw * x.w + u.col / MASS]

    def measurements(self, x, u):
        return [x.w]
"""


@pytest.fixture
def cell() -> Any:
    module = ModuleType("notebook")
    exec(compile(CELL, "notebook", "exec"), vars(module))
    return module


CHANGES = {
    "a number": ("MASS", 500.0),
    "a list, in place": ("GAINS", None),
    "an array, in place": ("TABLE", None),
    "a number that a function beside it reads": ("FACTOR", 1.0),
    "a function": ("halved", lambda x: x),
    "an object's attribute": ("config", SimpleNamespace(arm=6.0)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_structure_is_built_anew_of_what_its_code_reads(cell: Any, name: str) -> None:
    before = cell.Heave().system().B[0, 0]
    key, value = CHANGES[name]
    if value is None:
        getattr(cell, key)[1] *= 2
    else:
        setattr(cell, key, value)
    truth = cell.halved(cell.GAINS[1] / cell.MASS) + sum(cell.TABLE) * cell.config.arm
    assert truth != before
    assert cell.Heave().system().B[0, 0] == pytest.approx(truth, rel=1e-14)


def test_attributes_of_classes_and_modules_count(cell: Any, monkeypatch: Any) -> None:
    before = cell.Heave().system()
    cell.Heave.scale, cell.Constants.g = 8.0, 9.7
    monkeypatch.setattr("math.pi", 3.0)
    after = cell.Heave().system()
    assert after.A[0, 0] == 2 * before.A[0, 0]
    assert (after.C[0, 0], after.D[0, 0]) == (9.7, 3.0)


def test_nonlinear_equations_and_their_linearisation_follow(cell: Any) -> None:
    model = cell.Falling()
    trim = {"w": 0.0, "col": 0.0}
    assert model.at(trim).system().B[0, 0] == pytest.approx(1e-3, rel=1e-14)
    cell.MASS = 500.0
    assert model.equations()(0, 1, -0.5)[0] == pytest.approx(2e-3, rel=1e-14)
    assert model.at(trim).system().B[0, 0] == pytest.approx(2e-3, rel=1e-14)


def test_nothing_is_built_twice_for_what_it_does_not_read(cell: Any) -> None:
    built, read = cell.Heave().matrices(), surroundings(cell.Heave)
    cell.OTHER, cell.Zw = 8.0, np.zeros(3)  # a column of a notebook that is called as an attribute
    assert surroundings(cell.Heave) == read
    assert cell.Heave().matrices() is built
    cell.config.broken = lambda: None  # no data: an object that equals itself
    assert surroundings(cell.Heave) == surroundings(cell.Heave) != read


def test_what_a_class_closes_over_counts() -> None:
    def made(gain: float) -> tuple[type, Any]:
        class Own:
            def A(self) -> float:
                return gain

        def louder() -> None:
            nonlocal gain
            gain = 2 * gain

        return Own, louder

    own, louder = made(1.0)
    before = surroundings(own)
    assert surroundings(own) == before
    louder()
    assert surroundings(own) != before
    assert np.isclose(own().A(), 2.0)


def test_what_has_no_value_yet_or_holds_itself_is_no_obstacle() -> None:
    loop: list[Any] = []
    loop.append(loop)

    class Own:
        def A(self) -> Any:
            return loop

        def later(self) -> float:
            return unset

    before = surroundings(Own)
    assert surroundings(Own) == before
    unset = 1.0
    assert surroundings(Own) != before
