"""Splines of data in equations."""

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from casid import ModelError, spline

KNOTS, VALUES = [0.0, 1.0, 2.5, 3.0, 7.0], [1.0, 3.0, 2.0, 5.0, 4.0]


def test_the_spline_is_scipys_natural_one():
    natural = CubicSpline(KNOTS, VALUES, bc_type="natural")
    x = np.linspace(0, 7, 71)
    ours = [spline(float(each), KNOTS, VALUES) for each in x]
    np.testing.assert_allclose(ours, natural(x), rtol=0, atol=1e-12)


def test_beyond_the_knots_it_is_a_straight_line():
    natural = CubicSpline(KNOTS, VALUES, bc_type="natural")
    for edge, ahead in ((0.0, -3.0), (7.0, 3.0)):
        straight = natural(edge) + ahead * natural(edge, 1)
        assert spline(edge + ahead, KNOTS, VALUES) == pytest.approx(float(straight), abs=1e-11)


def test_symbols_give_what_numbers_give_and_two_continuous_derivatives():
    x, v = ca.SX.sym("x"), ca.SX.sym("v", 5)
    s = spline(x, KNOTS, ca.vertsplit(v))
    second = ca.jacobian(ca.jacobian(s, x), x)
    f = ca.Function("f", [x, v], [s, ca.jacobian(s, x), second])
    natural = CubicSpline(KNOTS, VALUES, bc_type="natural")
    for at in (0.3, 1.0 - 1e-9, 1.0 + 1e-9, 2.9, 5.0):
        for order, value in enumerate(f(at, VALUES)):
            assert float(value) == pytest.approx(float(natural(at, order)), abs=1e-6)


@pytest.mark.parametrize(
    ("knots", "values"), [([0.0, 1.0, 1.0], [1, 2, 3]), ([0.0, 1.0], [1, 2, 3]), ([1.0], [1])]
)
def test_bad_knots_are_told(knots, values):
    with pytest.raises(ModelError, match="spline"):
        spline(0.5, knots, values)


@pytest.mark.second
def test_a_table_is_as_exact_as_its_knots_are_few():
    x = np.linspace(0, 10, 200)
    rng = np.random.default_rng(1)
    values = rng.standard_normal(200)
    natural = CubicSpline(x, values, bc_type="natural")
    at = rng.uniform(0, 10, 50)
    ours = [spline(float(each), x, values) for each in at]
    np.testing.assert_allclose(ours, natural(at), atol=1e-5)
    with pytest.raises(ModelError, match="201 knots, expected 200 at most"):
        spline(0.5, np.linspace(0, 10, 201), np.zeros(201))
