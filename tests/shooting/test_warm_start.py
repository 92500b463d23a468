"""The solution expected beside another."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from truths.closed_roll import TRUTH, flown, with_holes

from casid import Constraint, SolverOptions
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.programme import Scales
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import starting_programme
from casid.shooting.warm_start import CHEAP, ROOM, Iterate, followed, in_box, predicted


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
    at = predicted(programme, Iterate.of(programme, start), 1, SolverOptions())
    guess, bounds, prices = at.x, at.bounds, at.constraints
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


def test_a_quadratic_that_is_convex_beside_bounds_that_hold_is_minimised_from_their_prices():
    # It falls without end along the first axis, whose bound holds: known only from its price.
    F = np.array([[-1.0, 0.0, -3.0], [0.0, 2.0, -2.0], [-3.0, -2.0, 0.0]])
    lower, upper = np.array([-1.0, -np.inf]), np.array([0.5, np.inf])
    assert in_box(F, lower, upper) is None
    found = in_box(F, lower, upper, np.array([1.0, -1.0]))  # none holds where no bound is
    np.testing.assert_allclose(found.x, [0.5, 1.0])
    np.testing.assert_allclose(found.multipliers_x, [3.5, 0.0])


def beside(truth, bounds):
    """A programme under bounds and what is predicted of it beside the truth; R is known."""
    free = free_parameters(truth, fixed={"Lped", "tau"}, bounds=bounds)
    records, R = [flown(truth, seed=1).between(0, 6)], np.diag([0.05, 0.005, 0.005]) ** 2
    programme, point = starting_programme(Evaluator(free, lay_out(records, 3.0)), free, R, True)
    at = Iterate.of(programme, programme.pack(point))
    return programme, predicted(programme, at, 3, SolverOptions())


@pytest.mark.parametrize("truth", [TRUTH, Tied()])
def test_quadratic_models_lead_to_the_tolerance_with_bounds_that_hold_and_others(truth):
    told = []
    options = SolverOptions(tolerance=1e-11, progress=told.append)
    programme, at = beside(truth, {"Lp": (-1.9, 0.0), "Lv": (-5.0, 5.0)})
    found = followed(programme, at, options, "here")
    assert found.success
    assert found.status == "solved by quadratic models"
    assert [each.iteration for each in told] == list(range(found.iterations + 1))
    names, lam = programme.free.names, programme.unpack(found.x).lam
    unit = max(1.9, programme.scales.lam[names.index("Lp")])
    assert lam[names.index("Lp")] == pytest.approx(-1.9 - ROOM * unit, rel=1e-14)  # as IPOPT's
    assert found.multipliers_x[names.index("Lp")] < -1e-6  # presses on the lower bound
    assert found.multipliers_x[names.index("Lv")] == pytest.approx(0.0, abs=1e-12)
    slopes = programme.gradient(found.x) + found.multipliers_x
    slopes += programme.constraint_matrix(found.x).T @ found.multipliers_g
    np.testing.assert_allclose(slopes, 0, atol=1e-11)


def test_quadratic_models_are_given_up_where_they_do_not_lead_to_the_solution():
    programme, at = beside(TRUTH, {"Lp": (-1.9, 0.0)})
    options = SolverOptions(tolerance=1e-11)
    away = at.x.copy()
    away[programme.free.names.index("Lv")] *= -20  # diverges within an interval
    assert followed(programme, replace(at, x=away), options, "away") is None
    few, late = replace(options, max_iterations=1), replace(options, max_seconds=1e-9)
    assert followed(programme, at, few, "few") is None
    assert followed(programme, at, late, "late") is None


def test_the_error_of_the_optimality_conditions_knows_what_each_of_them_misses():
    programme, at = beside(TRUTH, {"Lp": (-1.9, 0.0)})
    found = followed(programme, at, SolverOptions(tolerance=1e-11), "here")
    good = Iterate(found.x, found.multipliers_x, found.multipliers_g)
    programme = programme.roomier(ROOM)
    assert good.error(programme) <= 1e-11
    a = programme.free.names.index("Lp")
    unit = np.eye(len(found.x))[a]
    loose = programme.variant(free=replace(programme.free, lower=programme.free.lower - 0.1))
    assert replace(good, bounds=0 * good.bounds).error(programme) == pytest.approx(
        -found.multipliers_x[a], rel=1e-6
    )
    far = 0.1 / programme.scales.lam[a] * -found.multipliers_x[a] / CHEAP  # a price, no bound
    assert good.error(loose) == pytest.approx(far, rel=1e-6)
    assert replace(good, x=found.x - 0.5 * unit).error(programme) >= 0.5  # beyond the bound
    assert replace(good, constraints=good.constraints + 1e-3).error(programme) >= 1e-3


def test_a_solution_carried_to_other_units_is_one_there():
    programme, at = beside(TRUTH, {"Lp": (-1.9, 0.0)})
    found = followed(programme, at, SolverOptions(tolerance=1e-11), "here")
    good = Iterate(found.x, found.multipliers_x, found.multipliers_g)
    rng, old = np.random.default_rng(0), programme.scales
    units = (each * rng.uniform(0.3, 3.0, each.shape) for each in (old.lam, old.bias, old.state))
    other = programme.roomier(ROOM).variant(scales=Scales(*units))
    assert good.carried(programme, other).error(other) <= 1e-10
    assert good.error(other) > 1e-3  # its numbers are others


def test_costates_leave_the_nodes_no_slope_but_those_that_begin_a_record():
    free = free_parameters(TRUTH, fixed={"Lped", "tau"})
    records, R = [flown(TRUTH, seed=k).between(0, 5) for k in (1, 2)], np.diag([0.1, 0.01, 0.01])
    programme, point = starting_programme(Evaluator(free, lay_out(records, 1.0)), free, R, True)
    x = programme.pack(point)
    at = Iterate.of(programme, x)
    slopes = programme.gradient(x) + programme.constraint_matrix(x).T @ at.constraints
    nodes = slopes[programme.first_node :].reshape(programme.J, -1)
    np.testing.assert_allclose(nodes[programme.links + 1], 0, atol=1e-12)
    first = np.setdiff1d(np.arange(programme.J), programme.links + 1)
    assert len(first) == 2
    assert (np.abs(nodes[first]).max(axis=1) > 1e-3).all()
    assert not at.bounds.any()


def test_what_is_left_to_gain_is_what_the_next_step_lowers_the_cost_by():
    options = SolverOptions(tolerance=1e-11)
    programme, at = beside(TRUTH, {"Lp": (-1.9, 0.0)})
    found = followed(programme, at, options, "here")
    good = Iterate(found.x, found.multipliers_x, found.multipliers_g)
    assert good.left(programme) == np.inf  # no model tells
    programme = programme.roomier(ROOM)
    near = good.moved(programme, options)
    assert near.left(programme) < 1e-12
    for name in ("Lv", "Yv"):  # a step, all that follows it as well
        step = np.zeros(programme.evaluator.nf + 1)
        step[programme.free.names.index(name)] = 1e-3
        change = np.append(step[:-1], near.model[1] @ step)
        x = found.x + change[: len(found.x)]
        prices = near.constraints + change[len(change) - len(near.constraints) :] / programme.n
        values = programme.values(x)  # the gaps are closed to first order
        fallen = programme.n * (values.cost + found.multipliers_g @ values.g - found.f)
        moved = replace(near, x=x, constraints=prices)
        assert moved.left(programme) == pytest.approx(fallen, rel=0.01)
