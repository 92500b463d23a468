"""Nonlinear structures as they are declared, and as linear ones."""

# ruff: noqa: ARG005 - the formulas all take the structure, its states and its inputs

import casadi as ca
import numpy as np
import pytest
from truths.swing import TRUTH, SmallSwing, Swing, WrittenOut, swung

from casid import (
    ModelError,
    NonlinearModel,
    Record,
    Scalar,
    Trim,
    output_error,
    parameter,
    simulate,
)


def test_a_nonlinear_structure_is_its_linearisation_at_its_reference():
    for letter in "ABCD":
        expected = getattr(SmallSwing().system(), letter)
        np.testing.assert_array_equal(getattr(WrittenOut().system(), letter), expected)
    np.testing.assert_allclose(TRUTH.system().A, [[-0.8, -6.0], [1.0, 0.0]])


def test_a_flight_condition_has_no_names_but_of_channels():
    TRUTH.at(dict.fromkeys((*TRUTH.states, *TRUTH.inputs, *TRUTH.outputs), 0.0))
    with pytest.raises(ValueError, match=r"trim names 'Theta', which.*did you mean 'theta'"):
        TRUTH.at({"Theta": 0.3})
    with pytest.raises(ValueError, match=r"trim names 'wind', which is no channel.*known are q,"):
        TRUTH.at(Trim(values={"wind": 3.0}))


def test_a_record_is_no_flight_condition_but_its_trim_is():
    record = swung(1).detrend("mean")
    with pytest.raises(ValueError, match=r"a Record is no flight condition.*model.at\(Trim\("):
        TRUTH.at(record)
    A = TRUTH.at(Trim(values=record.trim)).system().A
    theta, lon = record.trim["theta"], record.trim["lon"]
    assert A[0, 1] == pytest.approx(-6.0 * np.cos(theta) - 8.0 * np.sin(theta) * lon)


def test_equations_are_those_written():
    f, h = Swing().equations()([0.2, 0.5], [0.3], [-0.5, 4.0, 5.0, 0.1])
    expected = -0.1 - 4 * np.sin(0.5) + 5 * np.cos(0.5) * 0.3
    np.testing.assert_allclose(f.full().ravel(), [expected, 0.2], rtol=1e-15)
    np.testing.assert_allclose(h.full().ravel(), [0.2, 0.5])


class Bad(NonlinearModel):
    states, inputs, outputs = ("v",), ("lon",), ("v",)

    a: Scalar = parameter(default=1.0, unit="1/s")

    def derivatives(self, x, u):
        return [self.formula(x, u)]


def broken(formula, **more):
    return type("Broken", (Bad,), {"formula": formula, "__module__": __name__, **more})()


def test_a_name_is_a_state_or_an_input():
    with pytest.raises(ModelError, match="'v' is a state and an input, which a flight condition"):
        broken(lambda m, x, u: -x.v, inputs=("v",))


@pytest.mark.parametrize(
    ("formula", "told"),
    [
        (lambda m, x, u: x.w, "derivatives.*no state 'w'; there are v"),
        (lambda m, x, u: m.b * x.v, "'b', which Broken does not declare"),
        (lambda m, x, u: m.a / x.v, "d/dt of 'v' is inf.*reference"),
        (lambda m, x, u: m.a * ca.sqrt(x.v - 1.0), "d/dt of 'v' is nan"),
        (lambda m, x, u: ca.floor(x.v), "uses floor, which jumps"),
        (lambda m, x, u: x.v * (u.lon > m.a), "uses <, which jumps"),
        (lambda m, x, u: "v", "expected a number or an expression"),
        (lambda m, x, u: max(x.v, u.lon), "decides by a parameter"),
    ],
)
def test_what_is_wrong_with_an_equation_is_told(formula, told):
    with pytest.raises(ModelError, match=told):
        broken(formula).equations()


def test_a_condition_in_which_an_equation_has_no_value_is_told_whole():
    sound_at_one = broken(lambda m, x, u: m.a * ca.sqrt(x.v), reference=lambda m: {"v": 1.0})
    with pytest.raises(ModelError, match=r"d/dt of 'v' is nan at v = -1, lon = 0\.5; check its"):
        sound_at_one.at({"v": -1.0, "lon": 0.5})


def test_too_few_expressions_are_told():
    wrong = type("Wrong", (Bad,), {"derivatives": lambda m, x, u: [], "__module__": __name__})()
    with pytest.raises(ModelError, match="derivatives: it has 0 expressions, expected 1: v"):
        wrong.equations()


def test_units_and_references_of_nothing_are_told():
    with pytest.raises(ModelError, match=r"units names 'w'"):
        broken(lambda m, x, u: x.v, units={"w": "m/s"}).equations()
    with pytest.raises(
        ModelError, match=r"reference: no state or input is called 'w'; known are v, lon"
    ):
        broken(lambda m, x, u: x.v, reference=lambda m: {"w": 1.0}).system()


def test_an_output_that_is_no_state_wants_measurements():
    other = type("Other", (Bad,), {"outputs": ("w",), "formula": lambda m, x, u: x.v})()
    with pytest.raises(ModelError, match="no method measurements, and output 'w'"):
        other.equations()


def test_a_parameter_named_like_a_part_of_the_base_is_refused():
    with pytest.raises(ModelError, match="must not have the name"):

        class Named(NonlinearModel):
            states, inputs, outputs = ("v",), ("lon",), ("v",)
            derivatives: Scalar = parameter(default=1.0, unit="-")


@pytest.mark.parametrize(
    ("method", "told"),
    [
        ("derivatives", "state 'v' has no dynamics: it depends on no state and no input"),
        ("measurements", "output 'v' is always the same: it depends on no state and no input"),
    ],
)
def test_what_depends_on_nothing_is_told_in_the_words_of_equations(method, told):
    parts = {
        "formula": lambda self, x, u: u.lon - self.a * x.v,
        method: lambda self, x, u: [self.a],
    }
    with pytest.raises(ModelError, match=told):
        type("Still", (Bad,), {"__module__": __name__, **parts})().system()


class Pressure(NonlinearModel):
    """Dynamic pressure is measured and thrust goes by a square, from a hover at rest."""

    states, inputs, outputs = ("u",), ("lon",), ("u", "qbar")

    Xu: Scalar = parameter(default=-0.3, lower=-3.0, upper=0.0, unit="1/m")
    thrust: Scalar = parameter(default=5.0, lower=0.0, upper=50.0, unit="m/s^2")

    def derivatives(self, x, u):
        return [self.Xu * x.u**2 + self.thrust * u.lon**2]

    def measurements(self, x, u):  # noqa: ARG002 - what every structure writes
        return [x.u, x.u**2 / 2]


def test_slopes_that_vanish_at_the_reference_are_no_lack_of_dynamics():
    t = 0.05 * np.arange(200)
    still = Record(t, np.sin(t)[:, None], np.zeros((200, 2)), ("lon",), ("u", "qbar"), "hover")
    record = simulate(Pressure(Xu=-0.4, thrust=4.0), still, {"u": 0.0})
    fit = output_error(
        Pressure(), record.with_noise({"u": 0.01, "qbar": 0.01}, np.random.default_rng(0))
    )
    assert fit.model.thrust == pytest.approx(4.0, abs=4 * fit["thrust"].std_error)
    assert not np.any(Pressure().system().A)
    assert Pressure().at({"u": 2.0}).system().C[1, 0] == 2.0
    assert not np.any(Pressure().at({"u": 0.0}).system().C[1])


@pytest.mark.parametrize("method", ["derivatives", "measurements"])
def test_a_symbol_of_nothing_is_told(method):
    def stray(self, x, u):  # noqa: ARG001
        return [ca.SX.sym("gust") * x.q, x.theta]

    with pytest.raises(ModelError, match=f"{method} uses the symbol 'gust', which has no value"):
        type("Stray", (Swing,), {method: stray, "__annotations__": {}})().system()


def test_a_symbol_of_nothing_in_a_matrix_is_told():
    class Stray(SmallSwing):
        def B(self):
            return [[ca.SX.sym("gust")], [0]]

    with pytest.raises(ModelError, match=r"Stray\.B uses the symbol 'gust'"):
        Stray().system()
