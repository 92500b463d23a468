"""Expressions of nonlinear structures."""

import casadi as ca
import numpy as np
import pytest
from truths.swing import Swing

from casid import ModelError
from casid.nonlinear.expressions import Channels, balances, jumping, linearised, operations


def test_channels_are_read_by_name_and_a_misspelt_one_is_told():
    x = Channels("state", ("p", "phi"), (1.0, 2.0))
    assert (x.p, x.phi) == (1.0, 2.0)
    with pytest.raises(AttributeError, match="no state 'q'; there are p, phi"):
        _ = x.q


@pytest.mark.parametrize(
    ("function", "names"),
    [
        (lambda x: ca.sin(x) * x**2, []),
        (ca.fabs, ["fabs"]),
        (lambda x: ca.floor(x) + ca.fmax(x, 0), ["floor", "fmax"]),
        (lambda x: ca.if_else(x > 0, x, 2 * x), ["if_else"]),
    ],
)
def test_operations_that_jump_or_bend_are_named(function, names):
    assert operations(function(ca.SX.sym("x"))) == sorted(names)


@pytest.mark.parametrize(
    ("written", "told"),
    [
        (lambda x, c: x * (x >= c), ["<="]),
        (lambda x, c: x + (x == c), ["=="]),
        (lambda x, c: x * ca.logic_and(x > 0, c > 1), ["<"]),
        (lambda x, c: ca.if_else(x > c, x > 0, 0), ["<"]),
        (ca.remainder, ["remainder"]),
        (lambda x, c: ca.if_else(ca.logic_or(x > c, x < 0), x, c * x), []),
        (lambda x, c: ca.if_else(ca.logic_not(x > c), x, 2) + ca.fmax(c, x) * ca.sign(x), []),
    ],
)
def test_comparisons_taken_as_numbers_jump_and_those_that_decide_need_not(written, told):
    x, c = ca.SX.sym("x"), ca.SX.sym("c")
    assert jumping(written(x, c)) == told


def test_rates_and_slopes_at_a_point_are_those_by_hand():
    model, theta, lon = Swing(Mq=-0.5, M=4.0, Mlon=5.0), 0.5, 0.3
    rates = balances(model, [0.2, theta], [lon])
    by_hand = -0.1 - 4 * np.sin(theta) + 5 * np.cos(theta) * lon
    np.testing.assert_allclose(ca.DM(rates).full().ravel(), [by_hand, 0.2], rtol=1e-14)
    A, B, C, D = linearised(model, [0.2, theta], [lon])
    assert [float(ca.DM(x)) for row in A for x in row] == pytest.approx(
        [-0.5, -4 * np.cos(theta) - 5 * np.sin(theta) * lon, 1.0, 0.0]
    )
    assert [float(ca.DM(x)) for row in B for x in row] == pytest.approx([5 * np.cos(theta), 0.0])
    np.testing.assert_array_equal([[float(ca.DM(x)) for x in row] for row in C], np.eye(2))
    assert D == [[0], [0]]  # nothing acts there, whatever the point


@pytest.mark.parametrize("written", [set, lambda rates: dict(enumerate(rates))])
def test_rates_without_an_order_are_refused(written):
    class Unordered(Swing):
        def derivatives(self, x, u):
            return written(Swing.derivatives(self, x, u))

    with pytest.raises(ModelError, match=r"Unordered.derivatives: it is .*, expected a list"):
        Unordered().equations()
