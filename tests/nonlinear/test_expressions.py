"""Expressions of nonlinear structures."""

import casadi as ca
import pytest

from casid.nonlinear.expressions import Channels, operations


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
