"""Model structures: one declaration for numbers and symbols, and slips told by name."""

import math
from collections import deque
from dataclasses import FrozenInstanceError, replace
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from truths.structures import Roll, structure

from casid import ModelError, Rows, matrix


def test_the_same_methods_run_on_numbers_and_on_symbols():
    model = Roll(Lp=-4.0, g=9.81)
    rows = np.array(model.A(), dtype=float)
    A, B, C, D, tau, c = (m.full() for m in model.matrices()(model.vector()))
    np.testing.assert_array_equal(A, rows)
    np.testing.assert_array_equal(A, [[-0.1, 0, 9.81], [-0.05, -4, 0], [0, 1, 0]])
    np.testing.assert_array_equal(B, [[0, 0.5], [20, 0], [0, 0]])
    np.testing.assert_array_equal(C, [[0, 1, 0], [0, 0, 1]])  # outputs that are states
    np.testing.assert_array_equal(D, np.zeros((2, 2)))
    np.testing.assert_array_equal(tau, [[0.05], [0]])
    np.testing.assert_array_equal(c, [[-5.0]])


def test_literal_zeros_are_structural():
    sparsity = Roll().matrices().sparsity_out("A")
    assert sparsity.nnz() == 5
    assert matrix([[0, ca.SX.sym("a")], [0.0, 1]]).nnz() == 2


def test_an_instance_is_a_parameter_set_with_a_system():
    system = Roll(tau=0.08).system()
    assert (system.states, system.inputs, system.outputs) == (
        Roll.states,
        Roll.inputs,
        Roll.outputs,
    )
    np.testing.assert_array_equal(system.delay, [0.08, 0.0])
    assert system.dt is None


def test_vectors_keep_the_order_of_declaration_and_the_trim():
    model = Roll(g=1.6)
    assert model.parameter_names() == ("Yv", "Lv", "Lp", "Llat", "tau")
    again = model.with_vector(np.array([-0.2, 0.1, -5.0, 7.0, 0.01]))
    assert again == Roll(Yv=-0.2, Lv=0.1, Lp=-5.0, Llat=7.0, tau=0.01, g=1.6)
    np.testing.assert_array_equal(again.vector(), [-0.2, 0.1, -5.0, 7.0, 0.01])
    with pytest.raises(ModelError, match="2 values for 5 parameters"):
        model.with_vector(np.zeros(2))


def test_models_are_frozen_and_varied_by_replace():
    model = Roll()
    with pytest.raises(FrozenInstanceError):
        model.Lp = -1.0
    assert replace(model, Lp=-1.0).Lp == -1.0
    with pytest.raises(TypeError, match="Lq"):
        Roll(Lq=1.0)


def test_the_methods_of_a_structure_run_once_for_all_its_values():
    runs = deque()  # of a list, which is data, methods would be built anew

    class Counted(Roll):
        scale: float = 1.0

        def B(self) -> Rows:
            runs.append(self.scale)
            return [[0, 0.5], [self.Llat * self.scale, 0], [0, 0]]

    for Lp in (-3.0, -2.0, -1.0):
        assert Counted(Lp=Lp).system().A[1, 1] == Lp
    assert Counted(scale=2.0).system().B[1, 0] == 40.0  # another trim, other matrices
    assert Counted().system().B[1, 0] == 20.0
    assert list(runs) == [1.0, 2.0]


@pytest.mark.parametrize(
    "value",
    [None, "3", -3 + 1j, np.complex128(-3), np.array([-3.0]), np.array([-3.0, -2.0])],
    ids=repr,
)
def test_a_value_that_is_no_number_is_told_with_its_parameter(value):
    with pytest.raises(ModelError, match=r"Roll.Lp is .*, expected a real number"):
        Roll(Lp=value).system()


def test_a_value_may_be_any_real_number():
    values = (-3, np.float32(-3), np.array(-3.0), Fraction(-3))
    assert {Roll(Lp=value).vector()[2] for value in values} == {-3.0}


def test_a_guess_that_gives_nan_is_told_with_the_entry():
    model = structure(A=lambda self: [[1 / self.a]])(a=0.0)
    with pytest.raises(ModelError, match=r"Lag.A\[0\]\[0\] is inf at these parameter values"):
        model.system()
    model = structure(A=lambda self: [[math.sin(self.a)]])()
    with pytest.raises(ModelError, match=r"is nan .*casadi.sin, not math.sin"):
        model.system()


def test_functions_of_numpy_are_expressions_without_a_word_and_leave_its_mode_as_chosen(recwarn):
    model = structure(A=lambda self: [[-np.exp(np.abs(np.sin(self.a)))]])
    assert model(a=0.5).system().A[0, 0] == pytest.approx(-math.exp(math.sin(0.5)), rel=1e-15)
    assert not recwarn.list
    chosen = ca.GlobalOptions.getNumpyMode()
    ca.GlobalOptions.setNumpyMode(1)
    try:
        structure(A=lambda self: [[-np.cosh(self.a)]])().system()
        assert ca.GlobalOptions.getNumpyMode() == 1
    finally:
        ca.GlobalOptions.setNumpyMode(chosen)
