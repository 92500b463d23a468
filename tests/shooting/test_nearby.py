"""The solution expected beside another."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from truths.closed_roll import TRUTH, flown, with_holes

from casid import Constraint, SolverOptions
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.nearby import in_box, predicted
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import starting_programme


class Tied(type(TRUTH)):
    """Roll with a tie and an inequality."""

    def constraints(self):
        return (
            Constraint("tie", self.Ylat - 0.2 * self.Llat),
            Constraint("slow", self.Lp * self.Lp, 0.0, 9.0),
        )


def test_neighbours_are_predicted_exactly_where_outputs_are_linear_in_the_parameters():
    # With A fixed and known noise the cost is quadratic in what is left: one prediction from the
    # start is the solution, with its multipliers, gaps closed, a tie met and a bound reached.
    truth = replace(Tied(), tau=0.0)
    names = [n for n in truth.parameter_names() if n not in ("Ylat", "Llat", "Lped")]
    free = free_parameters(truth, fixed=names, bounds={"Llat": (5.0, 0.9 * truth.Llat)})
    records = [with_holes(flown(truth, seed=1).between(0, 6))]
    evaluator, R = Evaluator(free, lay_out(records, 1.0)), np.diag([0.1, 0.01, 0.01])
    programme, point = starting_programme(evaluator, free, R, True)
    start = programme.pack(point)
    start[: evaluator.nf] *= 1.5
    guess, (bounds, prices) = predicted(programme, start, 1, SolverOptions())
    slopes = programme.gradient(guess) + bounds + programme.constraint_matrix(guess).T @ prices
    # IPOPT stops where the error of the optimality conditions is below its tolerance of 1e-8; the
    # gaps close to rounding through six intervals.
    np.testing.assert_allclose(slopes, 0, atol=1e-7)
    *closed, slow = programme.values(guess).g
    np.testing.assert_allclose(closed, 0, atol=1e-9)
    assert 0 < slow < 9
    assert bounds[free.names.index("Llat")] > 1e-4
    assert np.abs(prices).max() > 1e-4


@pytest.mark.parametrize("seed", range(6))
def test_a_quadratic_is_least_in_a_box_where_bounded_least_squares_are(seed):
    rng = np.random.default_rng(seed)
    X, y = rng.standard_normal((40, 30)) * np.geomspace(1, 1e3, 30), rng.standard_normal(40)
    lower, upper = -rng.uniform(0, 1e-2, 30), np.append(rng.uniform(0, 1e-2, 29), np.inf)
    upper[0] = lower[0] = 0.3  # a parameter that is held
    F = np.hstack([X, -y[:, None]]).T @ np.hstack([X, -y[:, None]])
    found = in_box(F, lower, upper)
    loose = np.where(upper > lower, upper, lower + 1e-12)  # SciPy wants some room
    known = scipy.optimize.lsq_linear(X, y, (lower, loose), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(found.x, known, rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose(F[:-1] @ [*found.x, 1.0] + found.multipliers_x, 0, atol=1e-8)
    assert (found.x == lower).sum() > 3 < (found.x == upper).sum()


def test_a_quadratic_that_falls_without_end_is_left_to_ipopt():
    assert in_box(np.diag([1.0, -1.0, 0.0]), np.full(2, -1.0), np.full(2, 1.0)) is None
