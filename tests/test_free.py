"""Free parameters: which, in which bounds, at which scale; wrong choices told by name."""

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
import pytest
from truths.structures import HoverRoll, Lag, Roll

from casid import Constraint, Model, ModelError, Rows, Scalar, parameter
from casid.free import delay_parameters, free_parameters, violated


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


def test_a_fixed_parameter_may_be_on_a_bound_as_near_as_solvers_end_there():
    free = free_parameters(Roll(Lp=-4.0 + 1e-9), fixed=("Lp",), bounds={"Lp": (-9.0, -4.0)})
    assert "Lp" not in free.names


def test_scales_come_from_the_file_the_guess_or_the_bounds():
    scale = dict(zip(Roll.parameter_names(), free_parameters(Roll(Lv=0.0)).scale, strict=True))
    assert scale["Lp"] == 2.0  # the file's word
    assert scale["Llat"] == 20.0  # the guess
    assert scale["Lv"] == pytest.approx(0.1)  # a tenth of the width of its bounds
    assert all(value > 0 for value in scale.values())


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"fixed": ("Lq",)}, "Roll has no parameter 'Lq'; known are Yv, Lv"),
        ({"bounds": {"g": (0, 1)}}, "Roll has no parameter 'g'"),
        ({"bounds": {"Lp": (0.0, -1.0)}}, "Lp: lower bound 0.0 > upper bound -1.0"),
        ({"bounds": {"Lp": (np.inf, np.inf)}}, r"Lp: no number lies within \[inf, inf\]"),
        ({"bounds": {"Lp": (np.nan, 0.0)}}, r"Lp: bounds are \(nan"),
        ({"bounds": {"Lp": -1.0}}, r"Lp: bounds are -1.0, expected two numbers \(lower, upper\)"),
        ({"bounds": {"Lp": (None, 0.0)}}, r"Lp: bounds are \(None, 0.0\), expected two numbers"),
        ({"fixed": "Lp"}, r"expected a collection of names, \('Lp',\)"),
        ({"fixed": Roll.parameter_names()}, "every parameter is fixed"),
        (
            {"fixed": ("Lp",), "bounds": {"Lp": (-9.0, -4.0)}},
            r"Lp is fixed at -3, outside its bounds \[-9, -4\]: give it a value within them",
        ),
        ({"fixed": ("Lp",), "bounds": {"Lp": (-4.0, -4.0)}}, "Lp is fixed at -3, outside"),
        (
            {"priors": {"Lp": (-3.0, 1e-300)}},
            r"Lp: its prior has a standard deviation of 1e-300, .* \(fixed=\), .* of 3e-05 or more",
        ),
        ({"priors": {"Llat": (0.0, 1e-5)}}, "Llat: .* a solver can weigh; .* of 0.0002 or more"),
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


class Early(Roll):
    def delays(self) -> Mapping[str, Scalar]:
        return {"lat": -0.1}


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
        (Early(), {}, r"'lat' is -0\.1 s; a delay is 0 s or more, that of other clocks is for"),
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


def test_a_class_in_place_of_a_model_is_told():
    with pytest.raises(ModelError, match=r"Roll is a class, expected a model: call it, Roll\(\)"):
        free_parameters(Roll)


class TwoParts(HoverRoll):
    """A delay of two parameters."""

    rotor: Scalar = parameter(default=0.03, lower=0.0, upper=0.3, unit="s")

    def delays(self):
        return {"lat": self.tau + 2 * self.rotor}


def test_bare_and_composed_delays_are_told_apart():
    assert delay_parameters(free_parameters(HoverRoll())) == ([4], [])
    assert delay_parameters(free_parameters(HoverRoll(), fixed={"Lv"})) == ([3], [])
    assert delay_parameters(free_parameters(TwoParts())) == ([], [0])
    assert delay_parameters(free_parameters(HoverRoll(), fixed={"tau"})) == ([], [])


class Fast(Lag):
    """A lag whose gain is at least its speed."""

    a: Scalar = parameter(default=1.0, unit="1/s", scale=1.0)

    def A(self) -> Rows:
        return [[-self.a]]

    def constraints(self):
        return [Constraint("fast enough", self.k - self.a, lower=0.0, upper=np.inf)]


def test_constraints_hold_to_rounding_and_are_named_where_they_do_not():
    free = free_parameters(Fast())
    assert violated(free, np.array([1.0, 1.0])) is None
    assert violated(free, np.array([1.0, 1.0 - 1e-7])) is None
    said = "constraint 'fast enough' is -0.001, wanted between 0 and inf; loosen it, or a bound"
    assert violated(free, np.array([1.0, 0.999])).startswith(said)
