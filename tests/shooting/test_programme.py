"""Gradient and Jacobian against finite differences, simulation against the exact one."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, flown, jittered, with_holes, with_response

import casid.shooting.newton
from casid import Constraint, SolverOptions
from casid.model import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.nearby import predicted
from casid.shooting.newton import Newton, _Descent
from casid.shooting.programme import Programme
from casid.shooting.sensitivity import Evaluator, Point
from casid.shooting.starting import noise_of, starting_programme

GAIN = np.array([[0.1, 1.0, 0.5], [0.0, 2.0, 0.3], [0.02, 0.1, 1.0]])


class Tied(type(TRUTH)):
    """Roll with a tie and an inequality."""

    def constraints(self):
        return (
            Constraint("tie", self.Ylat - 0.2 * self.Llat),
            Constraint("slow", self.Lp * self.Lp, 0.0, 9.0),
        )


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("gain", [None, GAIN], ids=["output error", "filter error"])
@pytest.mark.parametrize("kind", ["given", "diagonal", "full"])
def test_gradient_and_jacobian_agree_with_central_differences(gain, kind, hold):
    records = [jittered(with_holes(flown(seed=1).between(0, 4))), flown(seed=2).between(0, 3)]
    records = [replace(record, hold=hold) for record in records]
    free = free_parameters(Tied(), fixed=("Lped",))
    evaluator = Evaluator(free, lay_out(records, 1.0), gain, gain is not None)
    programme, point = starting_programme(evaluator, free, np.diag([0.1, 0.01, 0.01]), True)
    if kind != "given":
        noise = noise_of(evaluator, None, kind)
        programme = Programme(evaluator, free, programme.scales, noise, True)
    rng = np.random.default_rng(3)
    x = programme.pack(point) + 0.01 * rng.standard_normal(programme.size)
    v, eps = rng.standard_normal(programme.size), 1e-6
    up, down = programme.values(x + eps * v), programme.values(x - eps * v)
    slope = (up.cost - down.cost) / (2 * eps)
    # Rounding 1e-16 of costs of order one over 1e-6, truncation eps² times third derivatives.
    np.testing.assert_allclose(programme.gradient(x) @ v, slope, rtol=1e-6, atol=1e-8)
    difference = (up.g - down.g) / (2 * eps)
    scale = np.abs(difference).max()
    np.testing.assert_allclose(
        programme.constraint_matrix(x) @ v, difference, rtol=1e-6, atol=1e-7 * scale
    )


def evaluated(model, record, x0, bias):
    """Outputs as the estimator simulates them."""
    free = free_parameters(model)
    evaluator = Evaluator(free, lay_out([replace(record, y=0 * record.y)], 1e9))
    point = Point(lam=free.guess[free.index], bias=np.array([bias]), nodes=np.array([x0]))
    return evaluator.simulate(point).residuals


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.25, 6.5])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("sampling", ["regular", "irregular", "with a gap"])
def test_the_estimator_simulates_what_the_model_does(sampling, hold, delay):
    # Irregular: more distinct intervals than are tabulated, maps and breaks are interpolated.
    model = replace(TRUTH, tau=delay * 0.02)
    record = replace(flown(seed=3), hold=hold)
    if sampling != "regular":
        record = jittered(record)
    if sampling == "with a gap":
        record = replace(record, t=record.t + 0.5 * (np.arange(record.N) > 300))
    x0, bias = [0.1, 0.2, 0.3], [1.0, 2.0, 3.0]
    expected = with_response(record, model, np.array(x0), bias).y
    y = evaluated(model, record, x0, bias)
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_intervals_cover_every_sample_once():
    records = [flown(seed=1), with_holes(flown(seed=2).between(0, 5)), flown(seed=3)]
    layout = lay_out(records, 0.7)
    covered = np.concatenate(
        [np.arange(a, a + n) for a, n in zip(layout.start, layout.count, strict=True)]
    )
    np.testing.assert_array_equal(np.sort(covered), np.arange(sum(r.N for r in records)))
    assert (np.diff(layout.count) <= 0).all()
    assert layout.last.sum() == len(records)
    assert layout.observations == sum(int(np.isfinite(r.y).sum()) for r in records)


@pytest.mark.parametrize("kind", ["given", "diagonal"])
def test_newtons_hessian_is_that_of_the_lagrangian(kind, monkeypatch):
    monkeypatch.setattr(casid.shooting.newton, "MEET", np.inf)
    records = [jittered(with_holes(flown(seed=1).between(0, 4))), flown(seed=2).between(0, 3)]
    free = free_parameters(TRUTH, fixed=("Lped",))
    evaluator = Evaluator(free, lay_out(records, 1.0))
    programme, point = starting_programme(evaluator, free, np.diag([0.1, 0.01, 0.01]), True)
    if kind == "diagonal":
        programme = programme.variant(noise=noise_of(evaluator, None, kind))
    rng = np.random.default_rng(3)
    x = programme.pack(point) + 0.1 * rng.standard_normal(programme.size)
    price = rng.standard_normal(len(programme.values(x).g))
    newton = Newton(programme)

    def dense(entries):
        row, col = newton.places()
        H = np.zeros((programme.size + newton.auxiliary,) * 2)
        H[row, col] = entries
        return H + np.triu(H, 1).T

    def slope(x):
        return programme.gradient(x) + programme.constraint_matrix(x).T @ price

    H = dense(newton.hessian(x, price))
    n = programme.size
    found = H[:n, :n] - H[:n, n:] @ H[n:, :n]
    V, eps = rng.standard_normal((programme.size, 2)), 1e-5
    exact = np.transpose([(slope(x + eps * v) - slope(x - eps * v)) / (2 * eps) for v in V.T])
    gauss = programme.hessian_matrix(x).toarray() / programme.n
    gauss += np.triu(gauss, 1).T
    missing = np.linalg.norm(exact - gauss @ V)
    # The trapezoidal rule errs by (|A| h)² / 12, at most 1 % of the curvature here.
    assert np.linalg.norm(exact - found @ V) < 0.01 * missing
    assert missing > 0.1 * np.linalg.norm(exact)


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


def test_newton_begins_within_the_confidence_region_and_ends_where_a_step_leaps():
    n = 1000  # observations: a unit of log-likelihood is 1e-3 of the cost
    places, costs = (
        [0.0, 1.0, 1.1, 1.15, 1.1501, 3.0, 3.0001],
        [9, 8, 7.5, 7.4999, 7.4999, 7.5, 7.5],
    )
    descent = _Descent(n, close=False)
    said = [descent.close(np.array([x]), f) for x, f in zip(places, costs, strict=True)]
    # The step of 0.05 gains a tenth of a unit; that of 1.85 is longer than ten of it.
    assert said == [False, False, False, True, True, False, False]
    assert _Descent(n, close=True).close(np.array([0.0]), 9.0)
