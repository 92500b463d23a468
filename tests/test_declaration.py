"""What is wrong with a model file is told with the name of the culprit."""

import casadi as ca
import pytest
from truths.structures import structure

from casid import Constraint, Model, ModelError, Rows, parameter


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"states": ["x"]}, r"Lag.states is \['x'\], expected a tuple of names"),
        ({"inputs": ("u")}, r"Lag.inputs is 'u', expected .* or \(\"a\",\) for one"),
        ({"outputs": ()}, r"Lag.outputs is \(\)"),
        ({"states": ("x", "x")}, "Lag.states names 'x' twice"),
        ({"a": parameter(default=-1.0)}, 'Lag.a has no unit; write unit="1/s"'),
        ({"a": parameter(default=-1.0, unit=3)}, "Lag.a has no unit"),
        ({"a": parameter(default=1.0, lower=2.0, upper=0.0, unit="-")}, "Lag.a: lower bound 2.0 >"),
        (
            {"a": parameter(default=1.0, upper=0.0, unit="-")},
            r"Lag.a: default 1 is outside its bounds \[-inf, 0\]",
        ),
        ({"a": parameter(default=1.0, unit="-", scale=0.0)}, "Lag.a: scale=0.0, expected a pos"),
        (
            {"a": parameter(default=None, unit="-")},
            "Lag.a: default is None, expected a real",
        ),
        ({"a": parameter(default=-1.0, lower=None, unit="-")}, "Lag.a: lower is None, expected"),
        (
            {"a": parameter(default=-1.0, upper=[0.0], unit="-")},
            r"Lag.a: upper is \[0.0\], expec",
        ),
        ({"a": parameter(default=-1 + 0j, unit="-")}, r"Lag.a: default is \(-1\+0j\), expected"),
        ({"a": parameter(default=-1.0, unit="-", scale="a")}, "Lag.a: scale is 'a', expected"),
        ({"__annotations__": {}}, "Lag.a has no type: write a: Scalar = parameter"),
        (
            {"D": parameter(default=0.0, unit="-"), "__annotations__": {"a": float, "D": float}},
            "Lag.D: a parameter must not have the name of a part of Model",
        ),
    ],
)
def test_a_faulty_declaration_is_told_with_its_name(parts, message):
    with pytest.raises(ModelError, match=message):
        structure(**parts)


@pytest.mark.parametrize(
    ("name", "value"), [("a", -3.0), ("a", property(lambda _: -3.0)), ("U0", 9.0)]
)
def test_another_value_of_a_base_without_a_type_is_refused_as_it_would_change_nothing(name, value):
    base = structure(U0=40.0, __annotations__={"a": float, "U0": float})
    with pytest.raises(ModelError, match=f"Faster.{name} has no type and would change nothing"):
        type("Faster", (base,), {name: value})
    typed = type("Faster", (base,), {"U0": 9.0, "__annotations__": {"U0": float}})
    assert typed().U0 == 9.0


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"A": lambda self: [[self.aa]]}, "Lag.A uses 'aa', .* not declare; did you mean 'a'"),
        ({"A": lambda self: [[self.zeta_7]]}, "uses 'zeta_7', which Lag does not declare$"),
        ({"A": lambda _: [[ca.nonsense]]}, "Lag.A raised AttributeError: .*nonsense"),
        ({"A": lambda _: [[1 / 0]]}, "Lag.A raised ZeroDivisionError"),
        ({"A": lambda _: [[1], [1, 2]]}, "Lag.A: row 1 has 2 entries, the others have 1"),
        ({"A": lambda _: [[1, 2], [1], [2, 3]]}, "Lag.A: row 1 has 1 entries, the others have 2"),
        ({"A": lambda _: [1]}, r"Lag.A: row 0 is 1, expected a list of entries"),
        ({"A": lambda self: self.a}, r"Lag.A: it is .*, expected a list of rows"),
        ({"A": lambda self: {(self.a,)}}, r"Lag.A: it is .*, expected a list of rows"),
        ({"A": lambda _: [{1.0}]}, r"Lag.A: row 0 is \{1.0\}, expected a list of entries"),
        ({"A": lambda _: []}, "Lag.A: a matrix needs at least one row"),
        ({"A": lambda self: [[self.D]]}, r"Lag.A: entry \[0\]\[0\] is .*; call it: add \(\)"),
        ({"A": lambda _: [["a"]]}, r"Lag.A: entry \[0\]\[0\] is 'a', expected a number"),
        ({"B": lambda _: [[1, 2]]}, r"Lag.B has shape \(1, 2\), expected \(1, 1\): 1 states"),
        ({"C": lambda _: [[1], [2]]}, r"Lag.C has shape \(2, 1\), expected \(1, 1\)"),
        ({"D": lambda _: [[1, 0]]}, r"Lag.D has shape \(1, 2\)"),
        ({"outputs": ("z",)}, "Lag.C: Lag has no method C, and output 'z' is no state"),
        ({"A": lambda _: [[0]], "B": lambda _: [[0]]}, "Lag: state 'x' has no dynamics: row 0"),
        ({"C": lambda _: [[0]]}, "Lag: output 'x' is always zero: row 0"),
        ({"delays": lambda self: {"lat": self.a}}, "Lag.delays: no input is called 'lat'"),
        ({"delays": lambda self: {"u": self.tau}}, "Lag.delays uses 'tau', which Lag does not"),
        ({"delays": lambda self: [self.a]}, r"Lag.delays: it is \[.*\], expected delays by input"),
        ({"delays": lambda _: {"u": "0.1"}}, "Lag.delays: that of 'u' is '0.1', expected a number"),
        ({"constraints": lambda self: [self.b]}, "Lag.constraints uses 'b'"),
        (
            {"constraints": lambda self: [self.a]},
            r"Lag.constraints: it holds SX\(lam\), expected Constraint\(name, value",
        ),
        (
            {"constraints": lambda self: [Constraint("c", self.a, 2.0, 1.0)]},
            "Lag.constraints: c: lower bound 2.0 > upper bound 1.0",
        ),
        (
            {"constraints": lambda self: [Constraint("c", self.a, None, 1.0)]},
            r"Lag.constraints: c: bounds are \(None, 1.0\), expected two numbers",
        ),
        (
            {"constraints": lambda _: [Constraint("c", "a")]},
            "Lag.constraints: the value of 'c' is 'a', expected a number",
        ),
        (
            {"A": lambda self: [[self.a if self.a < 0 else -1]]},
            "Lag.A decides by a parameter .* casadi.if_else",
        ),
        ({"B": lambda self: [[max(self.a, 1)]]}, "Lag.B decides by a parameter"),
    ],
)
def test_faulty_matrices_are_told_with_method_row_and_remedy(parts, message):
    model = structure(**parts)()
    with pytest.raises(ModelError, match=message):
        model.matrices()


def test_a_missing_method_is_told():
    class Bare(Model):
        states = ("x",)
        inputs = ("u",)
        outputs = ("x",)

    with pytest.raises(ModelError, match="Bare has no method A"):
        Bare().matrices()

    class Half(Model):
        states = ("x",)
        inputs = ("u",)
        outputs = ("x",)

        def A(self) -> Rows:
            return [[-1]]

    with pytest.raises(ModelError, match="Half has no method B"):
        Half().matrices()
