"""Sparse blocks and NumPy functions against dense ones."""

import casadi as ca
import numpy as np
import scipy.sparse

from casid import SolverOptions
from casid.assembly import NumPyFunction, Pattern, evaluated, grid, stack, upper_triangle
from casid.nlp import solve

RNG = np.random.default_rng(4)


def test_values_in_any_order_become_the_matrix_they_belong_to():
    places = RNG.permutation(5 * 7)[:20]
    row, col, values = places // 7, places % 7, RNG.standard_normal(20)
    dense = np.zeros((5, 7))
    dense[row, col] = values
    pattern = Pattern(row, col, 7, 5)
    ordered = pattern.order(values)
    np.testing.assert_array_equal(pattern.matrix(ordered).toarray(), dense)
    np.testing.assert_array_equal(ca.DM(pattern.sparsity, ordered).full(), dense)


def test_grids_place_stacked_blocks():
    rows, cols = np.array([[0, 2], [1, 4]]), np.array([[3, 1], [0, 2]])
    blocks = RNG.standard_normal((2, 2, 2))
    dense = np.zeros((5, 5))
    for k in range(2):
        dense[np.ix_(rows[k], cols[k])] += blocks[k]
    whole = scipy.sparse.coo_array((blocks.ravel(), grid(rows, cols)), (5, 5))
    np.testing.assert_array_equal(whole.toarray(), dense)
    halves = [grid(rows[k : k + 1], rows[k : k + 1], upper=True) for k in range(2)]
    half = scipy.sparse.coo_array((upper_triangle(blocks), stack(halves)), (5, 5)).toarray()
    expected = np.zeros((5, 5))
    for k in range(2):
        expected[np.ix_(rows[k], rows[k])] += np.triu(blocks[k])
    np.testing.assert_array_equal(half, expected)


def test_casadi_calls_numpy_and_leaves_out_what_it_does_not_want():
    dense, pair = ca.Sparsity.dense(2, 1), [ca.Sparsity.dense(2, 1), ca.Sparsity.dense(1, 1)]
    f = NumPyFunction("f", [dense, dense], pair, lambda x, y: [x * y, x @ y])
    product, dot = f([1, 2], [3, 4])
    np.testing.assert_array_equal(product.full().ravel(), [3, 8])
    assert float(dot) == 11
    x = ca.MX.sym("x", 2)
    only = ca.Function("only", [x], [f(x, ca.DM([1, 1]))[1]])
    assert float(only([5, 6])) == 11


class _Hyperbola:
    """x + 1/x, lost in a singular matrix where x < 0: Newton's step from 3 is -12."""

    def cost(self, x):
        if x[0] <= 0:
            np.linalg.solve(np.zeros((1, 1)), np.ones(1))
        return x[0] + 1 / x[0]

    def gradient(self, x):
        return 1 - 1 / x**2

    def constraints(self, _):
        return np.zeros(0)

    jacobian = constraints

    def hessian(self, x, f, _):
        return f * 2 / x**3


def test_where_a_matrix_is_singular_ipopt_steps_back_without_a_word(capfd):
    nothing, one = ca.Sparsity(0, 1), ca.Sparsity.dense(1)
    limits = np.array([3.0]), np.array([-20.0]), np.array([20.0])
    problem = evaluated(_Hyperbola(), limits, (np.zeros(0), np.zeros(0)), nothing, one)
    found = solve(problem, SolverOptions(), stage="hyperbola")
    assert found.success
    np.testing.assert_allclose(found.x, 1.0, atol=1e-6)
    assert capfd.readouterr() == ("", "")
