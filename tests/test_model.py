"""Model structures: one declaration for numbers and symbols, and slips told by name."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import FrozenInstanceError, replace

import casadi as ca
import numpy as np
import pytest
from truths.structures import structure

from casid import Constraint, Model, ModelError, Rows, Scalar, matrix, parameter
from casid.model import free_parameters


class Roll(Model):
    states = ("v", "p", "phi")
    inputs = ("lat", "ped")
    outputs = ("p", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-1.0, upper=0.0, unit="1/s")
    Lv: Scalar = parameter(default=-0.05, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-3.0, lower=-9.0, upper=0.0, unit="1/s", scale=2.0)
    Llat: Scalar = parameter(default=20.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.2, unit="s")
    g: float = 9.8

    def A(self) -> Rows:
        return [[self.Yv, 0, self.g], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[0, 0.5], [self.Llat, 0], [0, 0]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"lat": self.tau}

    def constraints(self) -> Sequence[Constraint]:
        return [Constraint("damping", self.Lp + 10 * self.Yv, -20.0, 0.0)]


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


def test_fixed_parameters_are_numbers_and_free_ones_variables():
    free = free_parameters(Roll(Yv=-0.3), fixed=("Yv", "tau"), bounds={"Lv": (-0.1, 0.1)})
    assert free.names == ("Lv", "Lp", "Llat")
    np.testing.assert_array_equal(free.guess, [-0.05, -3.0, 20.0])
    np.testing.assert_array_equal(free.lower[:3], [-1.0, -0.1, -9.0])
    np.testing.assert_array_equal(free.full(np.array([0.01, -2.0, 5.0])), [-0.3, 0.01, -2, 5, 0.05])
    symbols = ca.SX.sym("f", 3)
    full = ca.Function("full", [symbols], [free.full(symbols)])
    np.testing.assert_array_equal(full([0.01, -2, 5]).full().ravel(), [-0.3, 0.01, -2, 5, 0.05])


def test_equal_bounds_fix_a_parameter_at_their_value():
    free = free_parameters(Roll(), bounds={"Lp": (-4.0, -4.0)})
    assert "Lp" not in free.names
    assert free.full(free.guess)[2] == -4.0


def test_a_guess_outside_narrowed_bounds_starts_on_them():
    free = free_parameters(Roll(), bounds={"Lp": (-9.0, -4.0)})
    assert free.guess[free.names.index("Lp")] == -4.0


def test_scales_come_from_the_file_the_guess_or_the_bounds():
    scale = dict(zip(Roll.parameter_names(), free_parameters(Roll(Lv=0.0)).scale, strict=True))
    assert scale["Lp"] == 2.0  # the file's word
    assert scale["Llat"] == 20.0  # the guess
    assert scale["Lv"] == pytest.approx(0.1)  # a tenth of the width of its bounds
    assert all(value > 0 for value in scale.values())


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"fixed": ("Lq",)}, "Roll has no parameter 'Lq'; it has Yv, Lv"),
        ({"bounds": {"g": (0, 1)}}, "Roll has no parameter 'g'"),
        ({"bounds": {"Lp": (0.0, -1.0)}}, "Lp: lower bound 0.0 > upper bound -1.0"),
        ({"bounds": {"Lp": (np.nan, 0.0)}}, "Lp: lower bound nan"),
        ({"bounds": {"Lp": -1.0}}, r"Lp: bounds are -1.0, expected two numbers \(lower, upper\)"),
        ({"bounds": {"Lp": (None, 0.0)}}, r"Lp: bounds are \(None, 0.0\), expected two numbers"),
        ({"fixed": "Lp"}, r"expected a collection of names, \('Lp',\)"),
        ({"fixed": Roll.parameter_names()}, "every parameter is fixed"),
    ],
)
def test_a_wrong_choice_of_free_parameters_is_told(choice, message):
    with pytest.raises(ModelError, match=message):
        free_parameters(Roll(), **choice)


class Delayed(Roll):
    late: Scalar = parameter(default=0.1, lower=0.0, upper=0.2, unit="s")

    def delays(self) -> Mapping[str, Scalar]:
        return {"lat": self.tau, "ped": 0.5 * self.late - self.tau + 0.15}


class Kept(Delayed):
    def constraints(self) -> Sequence[Constraint]:
        return [Constraint("pedals", 0.5 * self.late - self.tau, -0.15, np.inf)]


class Curved(Roll):
    def delays(self) -> Mapping[str, Scalar]:
        return {"lat": self.tau**2 + 0.01}


@pytest.mark.parametrize(
    ("model", "choice", "message"),
    [
        (Roll(), {"bounds": {"tau": (-np.inf, 0.2)}}, r"'lat' may be -inf s between .* of tau;"),
        (Roll(), {"bounds": {"tau": (-0.01, 0.2)}}, r"'lat' may be -0\.01 s .* bound it there"),
        (Roll(tau=-0.05), {"fixed": ["tau"]}, r"'lat' may be -0\.05 s"),
        (Roll(), {"bounds": {"tau": (-0.05, -0.05)}}, r"'lat' may be -0\.05 s"),
        (Delayed(), {}, r"'ped' may be -0\.05 s between the bounds of tau, late"),
        (Kept(), {"bounds": {"tau": (-0.1, 0.2)}}, r"'lat' may be -0\.1 s"),
        (Delayed(tau=0.2), {"fixed": ["tau"]}, r"'ped' may be -0\.05 s between the bounds of tau"),
    ],
)
def test_a_delay_that_may_be_negative_is_refused(model, choice, message):
    with pytest.raises(ModelError, match=message):
        free_parameters(model, **choice)


@pytest.mark.parametrize(
    ("model", "choice"),
    [(Roll(), {}), (Delayed(), {"bounds": {"tau": (0, 0.15)}}), (Kept(), {}), (Curved(), {}),
     (Delayed(tau=0.1), {"fixed": ["tau"]}), (Roll(tau=-1e-9), {"fixed": ["tau"]})],
)  # fmt: skip
def test_a_delay_that_stays_at_zero_or_more_is_not(model, choice):
    assert len(free_parameters(model, **choice).index)


def test_a_model_without_parameters_is_told():
    class Bare(Model):
        states, inputs, outputs = ("p",), ("lat",), ("p",)

        def A(self) -> Rows:
            return [[-1.0]]

        def B(self) -> Rows:
            return [[2.0]]

    assert Bare().system().A == [[-1.0]]
    with pytest.raises(ModelError, match="Bare has no parameters: there is nothing to estimate"):
        free_parameters(Bare())


def test_the_methods_of_a_structure_run_once_for_all_its_values():
    runs = []

    class Counted(Roll):
        scale: float = 1.0

        def B(self) -> Rows:
            runs.append(self.scale)
            return [[0, 0.5], [self.Llat * self.scale, 0], [0, 0]]

    for Lp in (-3.0, -2.0, -1.0):
        assert Counted(Lp=Lp).system().A[1, 1] == Lp
    assert Counted(scale=2.0).system().B[1, 0] == 40.0  # another trim, other matrices
    assert Counted().system().B[1, 0] == 20.0
    assert runs == [1.0, 2.0]


def test_a_class_in_place_of_a_model_is_told():
    with pytest.raises(ModelError, match=r"Roll is a class, expected a model: call it, Roll\(\)"):
        free_parameters(Roll)


def test_a_guess_that_gives_nan_is_told_with_the_entry():
    model = structure(A=lambda self: [[1 / self.a]])(a=0.0)
    with pytest.raises(ModelError, match=r"Lag.A\[0\]\[0\] is inf at these parameter values"):
        model.system()
    model = structure(A=lambda self: [[math.sin(self.a)]])()
    with pytest.raises(ModelError, match=r"is nan .*casadi.sin, not math.sin"):
        model.system()
