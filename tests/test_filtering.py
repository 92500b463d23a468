"""States estimated from the past: weighted least squares with every disturbance as an unknown."""

import numpy as np
import pytest
import scipy

from casid import Record, StateSpace, filtering, validate

N, DT = 60, 0.05
SYSTEM = StateSpace([[0.8, 2.0], [-2.0, 0.3]], [[0.0], [1.0]], [[1.0, 0.0], [0.5, 1.0]],
                    np.zeros((2, 1)), inputs=("u",), outputs=("a", "b"))  # fmt: skip


def flight(rng, even=True, n=N):
    t = DT * np.arange(n) if even else np.cumsum(rng.choice([1, 2], n)) * DT
    u = rng.standard_normal((n, 1))
    y = rng.standard_normal((n, 2))
    y[rng.random(y.shape) < 0.2] = np.nan
    return t, SYSTEM.steps(t, u, "zoh"), y


def least_squares(steps, y, t, q, r, last):
    """State at the last sample and biases, of all x, w and b at once."""
    unit = np.diff(t) / np.median(np.diff(t))
    nx, ny = 2, 2
    columns = nx * (last + 1) + ny  # all states, then biases
    rows, right = [], []
    for k in range(last + 1):
        for i in np.flatnonzero(np.isfinite(y[k])):
            row = np.zeros(columns)
            row[nx * k : nx * k + nx], row[nx * (last + 1) + i] = SYSTEM.C[i], 1.0
            rows.append(row / np.sqrt(r[i]))
            right.append(y[k, i] / np.sqrt(r[i]))
    for k in range(last):
        for i in range(nx):
            row = np.zeros(columns)
            row[nx * k : nx * k + nx] = -steps.maps[steps.which[k]][i]
            row[nx * (k + 1) + i] = 1.0
            rows.append(row / np.sqrt(q[i] * unit[k]))
            right.append(steps.forcing[k, i] / np.sqrt(q[i] * unit[k]))
    inverse = np.linalg.pinv(np.array(rows))
    found = inverse @ np.array(right)
    return found[nx * last : nx * last + nx], found[nx * (last + 1) :]


@pytest.mark.parametrize("even", [True, False])
def test_a_state_is_that_of_least_squares_over_all_disturbances(even, monkeypatch):
    monkeypatch.setattr(filtering, "LEVELS", np.array([3.0]))
    t, steps, y = flight(np.random.default_rng(1), even)
    q, r = filtering.noises(steps, SYSTEM.C, y, np.ones(2))
    at = (20, 45, N - 1)
    for last, found in zip(
        at, filtering.filter_states(steps, SYSTEM.C, y, t, np.ones(2), at), strict=True
    ):
        x, bias = least_squares(steps, y, t, 3.0 * q, r, last)
        np.testing.assert_allclose(found.x, x, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.bias, bias, rtol=1e-6, atol=1e-8)


def test_a_filter_that_has_settled_goes_on_where_the_sampling_changes(monkeypatch):
    monkeypatch.setattr(filtering, "LEVELS", np.array([1e4]))
    rng, n, later = np.random.default_rng(2), 50, 40
    t = DT * np.append(np.arange(later), later + 3 * np.arange(n - later))
    steps, y = SYSTEM.steps(t, rng.standard_normal((n, 1)), "zoh"), rng.standard_normal((n, 2))
    q, r = filtering.noises(steps, SYSTEM.C, y, np.ones(2))
    (found,) = filtering.filter_states(steps, SYSTEM.C, y, t, np.ones(2), (n - 1,))
    x, bias = least_squares(steps, y, t, 1e4 * q, r, n - 1)
    np.testing.assert_allclose(found.x, x, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.bias, bias, rtol=1e-6, atol=1e-8)


def test_a_state_knows_nothing_of_what_comes_later():
    t, steps, y = flight(np.random.default_rng(3))
    later = y.copy()
    later[31:] = 100.0
    one, other = (
        next(iter(filtering.filter_states(steps, SYSTEM.C, each, t, np.ones(2), (30,))))
        for each in (y, later)
    )
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.r, other.r)


def disturbed(rng, n=3000, size=0.3):
    """A record of a stable system that white noise drives, with its rates of measurement."""
    A = np.array([[-1.0, 2.0], [-2.0, -1.0]])
    system = StateSpace(A, SYSTEM.B, np.eye(2), np.zeros((2, 1)), inputs=("u",), outputs=("a", "b"))
    t, u = DT * np.arange(n), rng.standard_normal((n, 1))
    steps = system.steps(t, u, "zoh")
    x, y = np.zeros(2), np.empty((n, 2))
    for k in range(n):
        y[k] = x + 0.05 * rng.standard_normal(2) + (0.4, -0.2)
        if k < n - 1:
            x = steps.maps[0] @ x + steps.forcing[k] + size * rng.standard_normal(2)
    return system, Record(t, u, y, ("u",), ("a", "b"), "disturbed", hold="zoh")


def best_possible(system, size, steps):
    """Root mean square of predictions up to so many steps ahead by the true Kalman filter."""
    Ad = system.steps(np.array([0.0, DT]), np.zeros((2, 1)), "zoh").maps[0]
    Q, R = size**2 * np.eye(2), 0.05**2 * np.eye(2)
    P = scipy.linalg.solve_discrete_are(Ad.T, np.eye(2), Q, R)
    P = P - P @ np.linalg.solve(P + R, P)  # once the sample is seen
    variances = []
    for _ in range(steps):
        P = Ad @ P @ Ad.T + Q
        variances.append(np.diag(P + R))
    return np.sqrt(np.mean(variances, axis=0))


@pytest.mark.second
def test_predictions_err_as_those_of_the_true_filter():
    system, record = disturbed(np.random.default_rng(4))
    for horizon in (0.1, 0.5):
        found = validate({"truth": system}, [record], horizon=horizon)
        # 300 to 1500 predictions whose errors hang together over their length: 3 to 6 %.
        least = best_possible(system, 0.3, round(horizon / DT))
        np.testing.assert_allclose(found.rms["truth"][0], least, rtol=0.12)
        np.testing.assert_allclose(found.biases["truth"], [[0.4, -0.2]], atol=0.15)


def test_a_wrong_model_errs_by_more():
    system, record = disturbed(np.random.default_rng(5), size=0.002)
    wrong = StateSpace(system.A, -system.B, system.C, system.D, inputs=("u",), outputs=("a", "b"))
    found = validate({"truth": system, "wrong": wrong}, [record], horizon=0.5)
    assert found.rms["wrong"][0, 0] > 1.3 * found.rms["truth"][0, 0]


@pytest.mark.second
def test_the_latest_samples_count_most_where_an_aircraft_is_disturbed():
    rng = np.random.default_rng(6)
    system, record = disturbed(rng)
    found = validate({"truth": system}, [record], horizon=0.1)
    best = 0.3 * np.sqrt(1.5)  # of one step and of two, the state before them being known
    np.testing.assert_allclose(found.rms["truth"][0], np.hypot(best, 0.05), rtol=0.12)
