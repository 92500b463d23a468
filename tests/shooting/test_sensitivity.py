"""Simulation of all intervals and its derivatives."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from truths.closed_roll import TRUTH, flown, jittered, with_holes, with_response

from casid.free import free_parameters
from casid.shooting.innovation import starting_noises
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator, Point, Sweep, whiteners
from casid.shooting.unknowns import GainUnknowns

GAIN = np.array([[0.1, 1.0, 0.5], [0.0, 2.0, 0.3], [0.02, 0.1, 1.0]])


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


@pytest.mark.parametrize("gain", [None, GAIN], ids=["output error", "filter error"])
def test_gram_matrices_are_those_of_differences_of_the_residuals(gain):
    record, R = with_holes(flown(seed=1).between(0, 4)), np.diag([0.1, 0.01, 0.02]) ** 2
    free = free_parameters(TRUTH)
    layout = lay_out([record], 2.0)
    more = None if gain is None else GainUnknowns(gain, free=False)
    evaluator = Evaluator(free, layout, more)
    n, nodes = len(free.index), np.random.default_rng(3).standard_normal((2, 3))
    point = Point(lam=free.guess[free.index], bias=np.array([[0.1, 0.2, 0.3]]), nodes=nodes)
    whiten = np.sqrt(np.diag(np.linalg.inv(R)))

    def residuals(moves, j):
        """Whitened residuals of the j-th interval at a point moved by λ, its node, biases."""
        nodes = point.nodes.copy()
        nodes[layout.node[j]] += moves[n : n + 3]
        at = Point(lam=point.lam + moves[:n], bias=point.bias + moves[n + 3 :], nodes=nodes)
        first = layout.start[j]
        rows = evaluator.simulate(at).residuals[first : first + layout.count[j]]
        return (rows * whiten).ravel()

    sweep = Sweep(evaluator, point, evaluator.simulate(point), whiteners(R, layout))
    (batch,) = sweep.batches()
    for k, j in enumerate(batch.index):
        h = 1e-6
        slopes = [
            (residuals(h * unit, j) - residuals(-h * unit, j)) / (2 * h) for unit in np.eye(n + 6)
        ]
        J = np.column_stack([*slopes, residuals(np.zeros(n + 6), j)])
        expected = J.T @ J
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(batch.gram[k] / size, expected / size, atol=1e-7)


def test_a_held_gain_does_over_a_step_what_a_kalman_filter_does_at_its_end():
    records, free = [flown(seed=1).between(0, 3)], free_parameters(TRUTH)
    evaluator = Evaluator(free, lay_out(records, 3.0), starting_noises(TRUTH, records, "diagonal"))
    lam = np.concatenate([free.guess, evaluator.more.start])
    K, A, h = evaluator.held_gain(lam), TRUTH.system().A, records[0].dt
    gains = evaluator.gains(lam)
    moved = scipy.integrate.quad_vec(lambda s: scipy.linalg.expm(A * s) @ K, 0, h)[0]
    np.testing.assert_allclose(moved, gains.K[gains.which[-1]], rtol=1e-9, atol=1e-12)
