"""Programmes of repeated blocks: values and derivatives against CasADi's own of the whole."""

import casadi as ca
import numpy as np
import pytest

from casid.blocks import Block, assemble

RNG = np.random.default_rng(0)
DATA = RNG.standard_normal((2, 5))
# Five blocks share the first two of seven variables; each has one of its own.
INDEX = np.array([np.zeros(5), np.ones(5), np.arange(2, 7)], dtype=int)
X = RNG.standard_normal(7)


def block(w, d):
    f = (d[0] * w[0] - w[2]) ** 2 + ca.sin(w[1] * w[2])
    g = ca.vertcat(w[2] - d[1] * w[0] * w[1], w[0] ** 2)
    return f, g


def assembled():
    w, d = ca.SX.sym("w", 3), ca.SX.sym("d", 2)
    f, g = block(w, d)
    repeated = Block(w=w, d=d, f=f, g=g, index=INDEX, data=DATA, lower=-np.ones(2),
                     upper=np.array([1.0, 2.0]))  # fmt: skip
    return assemble([repeated], X, np.full(7, -9.0), np.full(7, 9.0))


@pytest.fixture(scope="module")
def plain():
    """The same programme written out."""
    x = ca.SX.sym("x", 7)
    parts = [block(x[INDEX[:, k].tolist()], DATA[:, k]) for k in range(5)]
    return x, sum(f for f, _ in parts), ca.vertcat(*(g for _, g in parts))


def test_values_and_first_derivatives_are_those_of_the_sum(plain):
    x, f, g = plain
    problem = assembled()
    value, slope = problem.functions["nlp_grad_f"](X, [])
    expected = ca.Function("e", [x], [f, ca.gradient(f, x), g, ca.jacobian(g, x)])(X)
    assert float(value) == pytest.approx(float(expected[0]), rel=1e-13)
    np.testing.assert_allclose(slope.full(), expected[1].full(), rtol=1e-12, atol=1e-12)
    constraints, jacobian = problem.functions["nlp_jac_g"](X, [])
    np.testing.assert_allclose(constraints.full(), expected[2].full(), rtol=1e-13)
    np.testing.assert_allclose(jacobian.full(), expected[3].full(), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(problem.lower_g, np.tile([-1.0, -1.0], 5))
    np.testing.assert_array_equal(problem.upper_g, np.tile([1.0, 2.0], 5))


def test_the_hessian_is_that_of_the_lagrangian_upper_triangle_only(plain):
    x, f, g = plain
    mu = RNG.standard_normal(10)
    found = assembled().hessian(X, [], 0.7, mu).full()
    H, _ = ca.hessian(0.7 * f + ca.dot(mu, g), x)
    expected = ca.Function("h", [x], [H])(X).full()
    np.testing.assert_allclose(found, np.triu(expected), rtol=1e-12, atol=1e-12)
