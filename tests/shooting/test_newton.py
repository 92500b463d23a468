"""Whether iterates are close to the end of a solve."""

import numpy as np
import pytest
from truths.closed_roll import TRUTH, flown, jittered, with_holes
from truths.swing import Swing, swung

import casid.shooting.newton
from casid import NonlinearModel
from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.newton import Newton, _Descent
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import noise_of, starting_programme


@pytest.mark.parametrize("close", [False, True])
def test_the_same_iterate_gets_the_same_answer(close):
    # IPOPT may ask for the Hessian of one iterate twice: a step of zero is no sign of the end.
    descent = _Descent(1000, close)
    for x, cost in ((0.0, 9.0), (1.0, 5.0), (1.1, 4.0)):
        answers = [descent.close(np.array([x]), cost) for _ in range(3)]
        assert answers == [close] * 3


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

    H = dense(newton.entries(x, price))
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


def test_the_curvature_of_a_nonlinear_structure_is_not_exact():
    def exact(model, records):
        free = free_parameters(model)
        curved = isinstance(model, NonlinearModel)
        evaluator = (NonlinearEvaluator if curved else Evaluator)(free, lay_out(records, 2.0))
        programme, _ = starting_programme(evaluator, free, "diagonal", True)
        return Newton(programme)._descent._exact

    assert exact(TRUTH, [flown(seed=1).between(0, 4)])
    assert not exact(Swing(), [swung()])


def test_where_the_curvature_is_not_exact_steps_that_do_not_shrink_end_newtons():
    def said(exact, *places):
        descent = _Descent(1000, close=True, exact=exact)
        return [descent.close(np.array([x]), -x) for x in places]

    # Steps of 1, then .8 of the last, and again: too long, unless they shrink in between.
    creeping, shrinking = (0.0, 1.0, 1.8, 2.44, 2.5), (0.0, 1.0, 1.8, 2.1, 2.34, 2.36)
    assert said(False, *creeping) == [True, True, True, False, False]
    assert all(said(True, *creeping) + said(False, *shrinking))
