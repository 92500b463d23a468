"""Functions of CasADi at many points."""

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from truths.motor import TRUTH
from truths.swing import Swing, WrittenOut
from truths.thrust import Squared

from casid.free import free_parameters
from casid.shooting.flow import POINTS, Flow, Mapped, Slopes, cut


def test_points_are_evaluated_as_one_by_one_however_many():
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    mapped = Mapped(ca.Function("f", [x, p], [ca.vertcat(p * x[0] * x[1], x[0])]), [1])
    for n in (1, POINTS, POINTS + 44):
        at = np.random.default_rng(n).standard_normal((n, 2))
        (found,) = mapped(at, np.array([3.0]))
        np.testing.assert_allclose(found, np.column_stack([3 * at.prod(axis=1), at[:, 0]]))


def test_slopes_are_the_textbooks():
    x, u, lam = ca.SX.sym("x", 2), ca.SX.sym("u", 1), ca.SX.sym("lam", 2)
    slopes = Slopes(ca.vertcat(lam[0] * ca.sin(x[0]) + u, lam[1] * x[0] * x[1]), x, u, lam)
    at, stick = np.random.default_rng(0).standard_normal((5, 2)), np.ones((5, 1))
    value, by_x, by_u, by_lam = slopes(at, stick, np.array([2.0, 3.0]))
    a, b, zero = *at.T, np.zeros(5)
    np.testing.assert_allclose(value, np.transpose([2 * np.sin(a) + 1, 3 * a * b]))
    np.testing.assert_allclose(by_x[:, 0], np.transpose([2 * np.cos(a), zero]))
    np.testing.assert_allclose(by_x[:, 1], np.transpose([3 * b, 3 * a]))
    np.testing.assert_array_equal(by_u[:, :, 0], np.tile([1.0, 0.0], (5, 1)))
    dense = np.zeros((5, 2, 3))
    slopes.lam.add(dense, by_lam)
    np.testing.assert_allclose(dense[:, 0, :2], np.transpose([np.sin(a), zero]))
    np.testing.assert_allclose(dense[:, 1, :2], np.transpose([zero, a * b]))


def test_steps_are_those_of_the_equations():
    # Of order four: a quarter of the step, 1/4⁵ of the error.
    flow, lam = Flow(free_parameters(TRUTH)), np.array([TRUTH.Zw, TRUTH.Z, TRUTH.lag])

    def rates(t, x):
        return [TRUTH.Zw * x[0] + TRUTH.Z * (x[1] ** 2 - 1), (1 + 9 * t - x[1]) / TRUTH.lag]

    errors = []
    for h in (0.008, 0.002):
        stages = 1 + 9 * h * np.array([[0.0, 0.5, 1.0]])
        found = flow.step(np.array([[0.3, 0.9]]), stages, np.array([h]), lam)[0]
        true = solve_ivp(rates, (0, h), [0.3, 0.9], rtol=1e-12, atol=1e-13).y[:, -1]
        errors.append(np.abs(found - true))
    np.testing.assert_array_less(errors[1], errors[0] / 600)
    y = flow.output(np.array([[0.3, 0.9]]), np.ones((1, 1)), lam)
    np.testing.assert_array_equal(y, [[0.3]])


def test_breaks_cut_steps_where_inputs_do_more_than_add():
    assert cut(WrittenOut()) == ()
    assert cut(Swing()) == ("zoh",)  # cos(theta) lon
    assert cut(Squared()) == ("foh", "zoh")
