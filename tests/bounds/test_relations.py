"""Linear relations read from text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid import ModelError
from casid.bounds.relations import parse_relation


@pytest.mark.parametrize(
    ("text", "names", "coefficients", "lower", "upper"),
    [
        ("Nlat = 0.05 Llat", ("Nlat", "Llat"), (1.0, -0.05), 0.0, 0.0),
        ("Lp + Mq <= -1", ("Lp", "Mq"), (1.0, 1.0), -np.inf, -1.0),
        ("-5 <= Lp + Mq <= -1", ("Lp", "Mq"), (1.0, 1.0), -5.0, -1.0),
        ("-1 >= Lp + Mq >= -5", ("Lp", "Mq"), (1.0, 1.0), -5.0, -1.0),
        ("2 Lp < -3", ("Lp",), (1.0,), -np.inf, -1.5),
        ("-Lp ≥ 3", ("Lp",), (1.0,), -np.inf, -3.0),
        ("Lp = Lp - Mq + 1", ("Mq",), (1.0,), 1.0, 1.0),
        ("2(Lp - 3 Mq)/4 = 1e-1", ("Lp", "Mq"), (0.5, -1.5), 0.1, 0.1),
        ("Mq > -Lp", ("Mq", "Lp"), (1.0, 1.0), 0.0, np.inf),
        ("0.05Llat = Nlat", ("Llat", "Nlat"), (0.05, -1.0), 0.0, 0.0),
        ("τ < 2 β", ("τ", "β"), (1.0, -2.0), -np.inf, 0.0),
    ],
)
def test_a_relation_is_read_as_mathematics_writes_it(text, names, coefficients, lower, upper):
    found = parse_relation(text)
    assert dict(zip(found.names, found.coefficients, strict=True)) == pytest.approx(
        dict(zip(names, coefficients, strict=True))
    )
    assert (found.lower, found.upper) == pytest.approx((lower, upper))
    assert found.tie == (lower == upper)


@given(
    a=st.floats(-9, 9).filter(lambda x: abs(x) > 1e-3), b=st.floats(-9, 9), c=st.floats(-9, 9),
    x=st.floats(-9, 9), y=st.floats(-9, 9),
)  # fmt: skip
def test_a_relation_holds_where_its_text_does(a, b, c, x, y):
    found = parse_relation(f"{a!r} x + {b!r} y <= {c!r}")
    inside = found.lower <= found.value({"x": x, "y": y}) <= found.upper
    margin = a * x + b * y - c
    assert abs(margin) < 1e-9 or inside == (margin < 0)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("Lp Mq = 1", "product of parameters"),
        ("1 / Lp = 2", "divisor must be a number"),
        ("Lp", "expected one of"),
        ("1 = 2", "no parameter"),
        ("Lp = ", "something is missing"),
        ("(Lp = 1", "parenthesis"),
        ("Lp < Mq > 3", "expected one of"),
        ("Lp <= Mq <= Nr", "numbers on the outer sides"),
        ("Lp = __import__('os')", "not understood"),
        ("Llat < 1 000", "000 stands right behind 1"),
        ("Lp = 1.2.3", ".3 stands right behind 1.2"),
        ("Lp = 1e3.5", ".5 stands right behind 1e3"),
        ("Lp 2 < 3", "2 stands right behind Lp"),
        ("Lp < 0x1F", "'0x1F' is not understood"),
        ("Lp = True", "'True' is out of place"),
        ("Lp = 1e400 Nr", "too large"),
        ("0 < Lp + Nr < -5", "nothing is above 0 and below -5"),
        (f"{' + '.join(['Lp'] * 1100)} = 0", "it is too long"),
    ],
)
def test_what_is_no_linear_relation_is_refused_with_the_reason(text, why):
    with pytest.raises(ModelError, match=why):
        parse_relation(text)
