"""Regression and realisation of gathered columns against NumPy's least squares."""

import numpy as np
import pytest
import scipy.linalg
from truths.systems import innovation_record, sampled_plant

from casid.subspace.predictor import (
    Stack,
    accumulate,
    predicted_future,
    predictor_coefficients,
    realise,
    ridge,
    stable_gain,
)

RNG = np.random.default_rng(9)
PAST = 6


def stacked(u, y, past=PAST):
    """Columns (z(0), ..., z(past)) of samples, one a row."""
    z = np.hstack([u, y])
    rows = np.hstack([z[k : len(z) - past + k] for k in range(past + 1)])
    R, count = accumulate([rows], constant=False)
    return rows, Stack(R, u.shape[1], y.shape[1], past, count)


@pytest.mark.parametrize("constant", [False, True])
def test_blocks_add_up_to_the_gram_matrix_of_all_columns(constant):
    rows = RNG.standard_normal((500, 7)) + 3.0
    R, count = accumulate(np.split(rows, [3, 100, 320]), constant=constant)
    whole = rows - rows.mean(axis=0) if constant else rows
    np.testing.assert_allclose(R.T @ R, whole.T @ whole, rtol=1e-10, atol=1e-10)
    assert count == 500
    assert np.allclose(R, np.triu(R))
    assert accumulate([], constant=constant)[1] == 0


def test_ridge_is_least_squares_of_the_extended_system():
    X, Y = RNG.standard_normal((40, 5)), RNG.standard_normal((40, 2))
    weight = 0.1 * np.linalg.norm(X, 2)
    extended = np.vstack([X, weight * np.eye(5)]), np.vstack([Y, np.zeros((5, 2))])
    np.testing.assert_allclose(ridge(X, Y, 0.1), np.linalg.lstsq(*extended, rcond=None)[0])


def test_coefficients_are_those_of_the_samples_with_or_without_a_direct_term():
    _, _, record, _ = innovation_record()
    rows, stack = stacked(record.u, record.y)
    Z, u, y = rows[:, : 3 * PAST], rows[:, 3 * PAST : 3 * PAST + 1], rows[:, 3 * PAST + 1 :]
    for free in (True, False):
        mask = np.full((2, 1), free)
        Xi, D = predictor_coefficients(stack, mask, 0.0, at_one=False)
        theta = np.linalg.lstsq(np.hstack([Z, u]) if free else Z, y, rcond=None)[0]
        np.testing.assert_allclose(Xi, theta[: 3 * PAST].T, atol=1e-9)
        np.testing.assert_allclose(D, theta[3 * PAST :].T if free else 0.0, atol=1e-9)


def test_a_direct_term_without_response_at_one_leaves_none_there():
    _, _, record, _ = innovation_record()
    _, stack = stacked(record.u, record.y)
    mask = np.array([[True], [False]])
    free, _ = predictor_coefficients(stack, np.ones((2, 1), dtype=bool), 0.0, at_one=True)
    Xi, D = predictor_coefficients(stack, mask, 0.0, at_one=True)
    M = np.eye(2) - free.reshape(2, PAST, 3)[:, :, 1:].sum(axis=1)  # held in the second pass
    at_one = np.linalg.solve(M, D + Xi.reshape(2, PAST, 3)[:, :, :1].sum(axis=1))
    assert at_one[1] == pytest.approx(0.0, abs=1e-10)
    assert abs(at_one[0]) > 1e-3


def test_noise_free_samples_give_the_system_itself():
    truth, rng = sampled_plant(), np.random.default_rng(4)
    u = rng.standard_normal((400, 1))
    y = truth.simulate(np.arange(400.0), u, hold="zoh")
    _, stack = stacked(u, y)
    none = np.zeros((2, 1), dtype=bool)
    Xi, _ = predictor_coefficients(stack, none, 0.0, at_one=False)
    future = predicted_future(stack, Xi, PAST)
    assert future.singular_values[3] < 1e-6 * future.singular_values[0]
    found = realise(stack, future, order=3, feedthrough=none)
    for k in range(5):  # Markov parameters, whatever the coordinates
        power = np.linalg.matrix_power
        np.testing.assert_allclose(
            found.C @ power(found.A, k) @ found.B, truth.C @ power(truth.A, k) @ truth.B, atol=1e-6
        )
    np.testing.assert_allclose(found.residual_covariance, 0, atol=1e-9)


def test_an_unstable_predictor_is_replaced_by_the_stationary_filter():
    A, C = np.array([[1.2, 0.1], [0.0, 0.7]]), np.array([[1.0, 0.0]])
    w, e = RNG.standard_normal((300, 2)), RNG.standard_normal((300, 1))
    K = stable_gain(A, C, np.zeros((2, 1)), w, e)
    P = np.eye(2)
    for _ in range(500):  # the filter's own recursion
        S = C @ P @ C.T + e.T @ e
        gain = (A @ P @ C.T + w.T @ e) @ np.linalg.inv(S)
        P = A @ P @ A.T + w.T @ w - gain @ S @ gain.T
    np.testing.assert_allclose(K, gain, rtol=1e-8)
    assert np.abs(scipy.linalg.eigvals(A - K @ C)).max() < 1
    np.testing.assert_array_equal(stable_gain(A, C, K + 0.01, w, e), K + 0.01)
