"""A structure laid open."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from truths.swing import Swing

from casid import Constraint, Model, Rows, Scalar, parameter
from casid.structure.overview import describe, equations_text, one_3211_each
from models.minimum_complexity import MinimumComplexity
from models.short_period import ShortPeriod
from models.six_dof import SixDof

EQUATIONS = """\
equations, total values
  dq/dt = (((Mq*q)-(M*sin(theta)))+((Mlon*cos(theta))*lon))
  dtheta/dt = q
  q measured = q
  theta measured = theta

reference condition, where the linearisation below holds
  q = 0 rad/s, d/dt 0
  theta = 0 rad, d/dt 0
  lon = 0"""


class Tied(Model):
    """Two lags, of which nothing shows the second, and nothing moves the third."""

    states = ("x", "hidden", "idle")
    inputs = ("u",)
    outputs = ("x",)
    a: Scalar = parameter(default=2.0, lower=0.0, upper=9.0, unit="1/s")
    b: Scalar = parameter(default=3.0, lower=-9.0, upper=9.0, unit="-")
    tau: Scalar = parameter(default=0.1, lower=0.0, upper=0.2, unit="s")
    trim: float = 1.5

    def A(self) -> Rows:
        return [[-self.a, 0, self.trim], [1, -4, 0], [0, 0, -7]]

    def B(self) -> Rows:
        return [[self.b + 2 * self.trim], [0], [0]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"u": self.tau}

    def constraints(self) -> list[Constraint]:
        return [Constraint("b - a", self.b - self.a, 0.0, 5.0)]


def test_entries_are_formulas_of_names_and_trim_and_structural_zeros():
    found = describe(Tied())
    assert found.entries["A"] == [["-a", ".", "1.5"], ["1", "-4", "."], [".", ".", "-7"]]
    assert found.entries["B"] == [["b+3"], ["."], ["."]]
    assert found.entries["C"] == [["1", ".", "."]]
    np.testing.assert_array_equal(found.system.A[0], [-2, 0, 1.5])


def test_a_matrix_shows_numbers_only_where_formulas_are_long():
    text = str(describe(MinimumComplexity()))
    matrix = text.split("\nA\n")[1].split("\n\n", maxsplit=1)[0]
    assert "..." in matrix
    assert "-9.79439" in matrix
    assert max(map(len, matrix.splitlines())) < 12 * 50
    assert "..." not in text.split("A at the guess\n")[1].split("\n\n", maxsplit=1)[0]


def test_text_holds_parameters_delays_constraints_and_identifiability():
    text = str(describe(Tied(), fixed=("b",)))
    assert "Tied: 3 states, 1 input, 1 output, 2 free parameters" in text
    lines = [line.split() for line in text.splitlines()]
    assert ["a", "2", "0", "9", "1/s", "free"] in lines
    assert ["b", "3", "-9", "9", "-", "fixed"] in lines
    assert "delays at the guess: u 0.1 s" in text
    assert "0 <= b - a = 1 <= 5" in text
    assert "identifiability from one 3-2-1-1 a control" in text
    assert "rank 2 of 2" in text


def test_modes_that_nothing_shows_or_moves_are_marked():
    x, hidden, idle = describe(Tied()).modes
    assert (x.pole, x.states[0]) == (-2, "x")
    assert x.observable
    assert x.controllable
    assert (hidden.pole, hidden.observable, hidden.controllable) == (-4, False, True)
    assert (idle.pole, idle.observable, idle.controllable) == (-7, True, False)
    text = str(describe(Tied()))
    assert "hidden  NOT OBSERVABLE" in text
    assert "NOT CONTROLLABLE" in text


def test_the_phugoid_and_dutch_roll_of_six_degrees_of_freedom_are_observable():
    found = describe(SixDof())
    assert all(mode.observable and mode.controllable for mode in found.modes)
    assert found.identifiability.identifiable


def test_a_guess_that_diverges_within_a_sample_hides_no_parameter():
    slow, fast = (describe(replace(Tied(), a=a)).identifiability for a in (0.0, -200.0))
    assert slow.identifiable
    assert fast.identifiable


def test_the_excitation_is_a_3_2_1_1_of_seven_units():
    (record,) = one_3211_each(ShortPeriod().system())
    values, counts = np.unique(record.u, return_counts=True)
    np.testing.assert_allclose(values, [-0.05, 0, 0.05])
    # 3 + 1 units up, 2 + 1 down, each of 0.7 s at 50 Hz; edges fall between samples.
    np.testing.assert_allclose(counts[[2, 0]], [140, 105], atol=2)


def test_equations_are_told_with_the_names_of_the_file():
    assert equations_text(Swing()) == EQUATIONS


def test_check_tells_equations_and_linearisation():
    text = str(describe(Swing()))
    assert EQUATIONS in text
    assert "A at the guess" in text
    told = "one 3-2-1-1 a control, of the linearisation at the reference condition alone"
    assert f"identifiability from {told}\n  rank 4 of 4" in text
