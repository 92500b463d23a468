"""Cases as users write them, and points within them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from truths.mixture import Mixture, least_squares, record
from truths.structures import HoverRoll

from casid import ModelError, output_error
from casid.bounds.cases import as_user_class, constrained, feasible, read_cases


def case(spec, model=None, **more):
    return read_cases(model or Mixture(), {"case": spec}, **more)[0]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("< 0.2", (-9, 0.2)), (">= 0", (0, 9)), ("±20 %", (0.4, 0.6)), ("+-0.1", (0.4, 0.6)),
        ("2 ± 10 %", (1.8, 2.2)), ("-1 ± 0.5", (-1.5, -0.5)), ("− 1 ± 0,5", None),
        ([-2, 0], (-2, 0)), ([-20, 20], (-20, 20)), ("free", (-np.inf, np.inf)),
    ],
)  # fmt: skip
def test_bounds_of_one_parameter(content, expected):
    if expected is None:
        with pytest.raises(ModelError, match="not understood"):
            case({"a": content})
        return
    assert case({"a": content}).bounds["a"] == pytest.approx(expected)
    assert case({"a": content}).bounds["b"] == (-9, 9)


@pytest.mark.parametrize(("content", "value"), [(2, 2.0), ("fixed", 0.5), ("= 1", 1.0),
                                                ([3, 3], 3.0), (0.0, 0.0)])  # fmt: skip
def test_a_fixed_value_is_a_tie_with_a_price(content, value):
    (relation,) = case({"a": content}).relations
    assert relation.names == ("a",)
    assert relation.lower == relation.upper == value


def test_a_free_delay_stays_at_zero_or_more():
    asked = case({"tau": "free", "Lv": "free"}, HoverRoll())
    assert asked.bounds["tau"] == (0.0, np.inf)
    assert asked.bounds["Lv"] == (-np.inf, np.inf)


def test_all_parameters_and_exceptions_to_that():
    found = case({"*": "±50 %", "b": "free"}, Mixture(d=0.0))
    assert found.bounds["a"] == (0.25, 0.75)
    assert found.bounds["b"] == (-np.inf, np.inf)
    assert found.bounds["d"] == (-9, 9)  # nothing is relative to zero
    assert case("±50 %").bounds["d"] == pytest.approx((0.05, 0.15))


def test_relations_stand_beside_bounds_or_alone():
    both = case({"a": "> 0", "constraints": ["a = 2 b", "b + d <= 1"]})
    assert [relation.text for relation in both.relations] == ["a = 2 b", "b + d <= 1"]
    assert case(["a = 2 b"]).relations == both.relations[:1]
    assert case({"a": "= 2 b"}).relations[0].names == ("a", "b")


@pytest.mark.parametrize(
    ("spec", "why"),
    [
        ({"z": 1}, "no parameter 'z'"), ({"a": "about 2"}, "not understood"),
        ({"a": "> 10"}, "contradicts"), ({"a": [1, 0]}, "lower bound 1.0 > upper bound 0.0"),
        ({"a": [1]}, "expected"), ({"a": True}, "not understood"), (["a = a"], "no parameter"),
        ({"d": "±20 %"}, "guess of zero"), ([3], "no relation"),
        ({"a": np.nan}, "a = nan is not understood"), ({"a": [0, np.nan]}, "expected two numbers"),
        ({"a": -3.5, "constraints": ["a < -5"]}, "contradicts its value -3.5"),
        (["a = -3", "a = -4"], "a = -4 contradicts its value -3"),
        (["a = 2 b", "b = 0.5 a"], "'b = 0.5 a' follows from 'a = 2 b'"),
        (["a = 2 b", "d = 1", "b = 0.5 a - 1"], "'b = 0.5 a - 1' contradicts 'a = 2 b'; leave"),
        ({"a": 2, "b": 1, "constraints": ["a = 2 b"]}, "follows from 'a = 2', 'b = 1'"),
        ({"a": [0, 1], "b": [0, 1], "constraints": ["a + b > 3", "a < 2 b"]},
         r"'a \+ b > 3' cannot hold with a in \[0, 1\], b in \[0, 1\]; loosen"),
        (["a - b < 0", "d < 1", "a - b > 0.1"], "'a - b < 0' and 'a - b > 0.1' cannot hold tog"),
        ({"a": 2, "b": [3, 4], "constraints": ["a > b"]},
         r"'a = 2' and 'a > b' cannot hold together with b in \[3, 4\]; loosen"),
    ],
)  # fmt: skip
def test_what_is_no_case_is_refused_by_name(spec, why):
    with pytest.raises(ModelError, match=why) as error:
        case(spec, Mixture(d=0.0))
    assert "'case'" in str(error.value)


def test_a_value_fixed_twice_is_one_tie():
    assert len(case({"a": 2, "constraints": ["a = 2", "a < 3", "a = 2 b"]}).relations) == 2


@pytest.mark.parametrize(
    ("spec", "fixed", "held"),
    [
        ({"Llat": 0.0}, (), ("Llat", "tau")), ({"Llat": 0.0}, ("tau",), ("Llat",)),
        ({"Llat": 0.0, "tau": 0.2}, (), ("Llat", "tau")), ({"Llat": 1.0}, (), ("Llat",)),
        ({"Lv": 0.0, "Yv": 0.0}, (), ("Lv", "Yv")),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:case 'case'")
def test_what_fixed_values_leave_without_effect_is_held(spec, fixed, held):
    found = case(spec, HoverRoll(Llat=1.0, tau=0.1), fixed=fixed)
    assert [relation.names for relation in found.relations] == [(name,) for name in held]


def test_what_is_held_for_want_of_an_effect_is_said():
    with pytest.warns(UserWarning, match=r"'case'.* tau has no effect and the records do not det"):
        (*_, tie) = case({"Llat": 0.0, "tau": [0.15, 0.3]}, HoverRoll(tau=0.1)).relations
    assert (tie.lower, tie.upper) == (0.15, 0.15)  # the guess, within its bounds


def test_a_parameter_fixed_everywhere_is_in_no_case():
    assert "a" not in case({}, fixed=["a"]).bounds
    with pytest.raises(ModelError, match="fixed in all cases"):
        case({"a": 1.0}, fixed=["a"])


def test_cases_know_which_contain_them():
    specs = {"free": {}, "half": {"a": "> 0"}, "tight": {"a": [0, 1]}, "point": {"a": 0.5},
             "tie": ["a = 2 b"], "both": {"a": "> 0", "constraints": ["a = 2 b"]}}  # fmt: skip
    found = {each.name: each for each in read_cases(Mixture(), specs)}
    inside = {(a, b) for a in found for b in found if a != b and found[a].within(found[b])}
    assert inside == {
        ("half", "free"), ("tight", "free"), ("point", "free"), ("tie", "free"), ("both", "free"),
        ("tight", "half"), ("point", "half"), ("point", "tight"), ("both", "half"), ("both", "tie"),
    }  # fmt: skip


@pytest.mark.second
@given(a=st.floats(-20, 20), b=st.floats(-20, 20), d=st.floats(-20, 20))
def test_the_nearest_point_lies_within_and_a_point_within_stays(a, b, d):
    asked = case({"d": "< 0.2", "constraints": ["a = 2 b", "a + b <= 1"]})
    moved = feasible(Mixture(a=a, b=b, d=d), asked)
    values = {name: getattr(moved, name) for name in Mixture.parameter_names()}
    for name, (lower, upper) in asked.bounds.items():
        assert lower <= values[name] <= upper
    for relation in asked.relations:  # to the stiffness of the residual that stands for it
        assert relation.lower - 1e-5 <= relation.value(values) <= relation.upper + 1e-5
    again = feasible(moved, asked)
    np.testing.assert_allclose(again.vector(), moved.vector(), atol=1e-5)


def test_beside_a_fit_the_nearest_point_is_the_constrained_optimum():
    X, y = least_squares()
    fit = output_error(Mixture(), [record()])
    asked = case(["a = 1.8 b"])
    moved = feasible(fit.model, asked, fit)
    E = np.array([[1, -1.8, 0, 0, 0, 0]])
    K = np.block([[X.T @ X, E.T], [E, np.zeros((1, 1))]])
    expected = np.linalg.solve(K, np.append(X.T @ y, 0.0))[:3]
    spread = [fit[name].std_error for name in Mixture.parameter_names()]
    # linear least squares: the information says it all
    np.testing.assert_allclose((moved.vector() - expected) / spread, 0, atol=1e-2)


def test_a_model_within_a_case_keeps_its_class_and_relations_their_units():
    asked = case(["1e6 a = 2e6 b + 3"])
    inside = constrained(Mixture(a=2.0, b=1.0), asked)
    assert isinstance(inside, Mixture)
    (constraint,) = inside.constraints()
    assert constraint.value == pytest.approx(0.0)
    assert constraint.lower == constraint.upper == 3.0
    assert type(as_user_class(inside, Mixture)) is Mixture
    assert constrained(Mixture(), case({})) == Mixture()
