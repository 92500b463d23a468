"""Regressors with noise: the slope of a line through points that err in both coordinates."""

import numpy as np
import pytest

from casid.consistency.errors_in_variables import Corrected, Eliminated, Normal


def line(seed, n=2000, noisy=0.5):
    """Normal equations of y = 2 z seen as x = z + noise, at slope 0, what noise adds, scores."""
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(n)
    x = z + noisy * rng.standard_normal(n)
    y = 2 * z + 0.1 * rng.standard_normal(n)
    e = (y - 2 * x)[:, None]  # at the true slope
    size = np.std(e)
    seen = Normal(np.array([[x @ x]]) / size**2, x @ e / size**2)
    pretended = Normal(np.array([[n * noisy**2]]), np.array([-2.0 * n * noisy**2])) * size**-2
    return Corrected(seen, pretended), x[:, None] * e / size**2


def test_the_corrected_slope_is_right_and_the_plain_one_a_fifth_too_small():
    steps = np.array([line(seed)[0].step()[0] for seed in range(40)])
    assert abs(steps.mean()) < 4 * steps.std() / np.sqrt(40)
    assert steps.std() < 0.1
    none = Normal(np.zeros((1, 1)), np.zeros(1))
    rng = np.random.default_rng(0)
    x = rng.standard_normal(2000)
    z = x + 0.5 * rng.standard_normal(2000)
    plain = Corrected(Normal(np.array([[z @ z]]), np.array([z @ (2 * x - 2 * z)])), none)
    assert plain.step()[0] == pytest.approx(-0.4, abs=0.06)  # 2/(1 + 0.25) - 2


def test_its_variance_covers_the_scatter():
    steps = np.array([line(seed)[0].step()[0] for seed in range(40)])
    corrected, scores = line(41)
    ((variance,),) = corrected.covariance(scores, np.ones(1))
    assert np.mean(steps**2) < variance < 1.0


def test_of_what_is_mostly_noise_nothing_but_the_prior_is_known():
    seen = Normal(np.diag([100.0, 100.0, 100.0]), np.ones(3))
    pretended = Normal(np.diag([0.0, 40.0, 90.0]), np.zeros(3))
    corrected = Corrected(seen, pretended)
    np.testing.assert_allclose(corrected.step(), [0.01, 1 / 60, 0.01])
    one, fair, other = np.diag(corrected.covariance(np.zeros((10, 3)), np.array([1.0, 2.0, 3.0])))
    assert one == pytest.approx(0.01)
    assert fair == pytest.approx(100 / 60**2)  # slopes scatter as before, over three fifths
    assert other == pytest.approx(9.01)


def test_steps_without_noise_are_those_of_the_sum_of_normal_equations():
    A, B = np.array([[1.0, 0.97], [0.97, 1.0]]), np.diag([3.0, 1e-2])
    seen = Normal(A, np.array([1.0, 2.0])) + Normal(B, np.array([-4.0, 0.5]))
    none = Normal(np.zeros((2, 2)), np.zeros(2))
    expected = np.linalg.solve(A + B, [-3.0, 2.5])
    np.testing.assert_allclose(Corrected(seen, none).step(), expected, rtol=1e-9)
    close = Corrected(Normal(A, np.array([1.0, 0.0])), none).step()  # condition 66
    np.testing.assert_allclose(close, np.linalg.solve(A, [1.0, 0.0]), rtol=1e-9)


def test_elimination_of_own_unknowns_changes_neither_steps_nor_errors():
    rng = np.random.default_rng(5)
    tables = rng.standard_normal((2, 40, 6))  # residual and slopes by five unknowns of two records
    normal = [Normal(x[:, 1:].T @ x[:, 1:], x[:, 1:].T @ x[:, 0]) for x in tables]
    parts = [Eliminated(each, 3) for each in normal]
    total = parts[0].shared + parts[1].shared
    step = np.linalg.solve(total.information, total.slope)
    whole = np.zeros((80, 7))  # three of all, two of each
    whole[:, :3] = tables[:, :, 1:4].reshape(80, 3)
    whole[:40, 3:5], whole[40:, 5:] = tables[:, :, 4:]
    expected = np.linalg.lstsq(whole, tables[:, :, 0].ravel())[0]
    np.testing.assert_allclose([*step, *parts[0].step(step), *parts[1].step(step)], expected)
    scores = np.vstack([p.scores(x[:, 1:] * x[:, :1]) for p, x in zip(parts, tables, strict=True)])
    np.testing.assert_allclose(scores.sum(axis=0), total.slope)
    P = np.linalg.inv(whole.T @ whole)
    np.testing.assert_allclose(np.linalg.inv(total.information), P[:3, :3])
    own = parts[0].variances(np.zeros((1, 5)), P[:3, :3])
    np.testing.assert_allclose(own, np.diag(P)[3:5])


def test_equations_of_a_quadratic_are_known_a_step_on():
    # Those of |y − X θ|² at θ and, computed anew, at θ + s.
    rng = np.random.default_rng(5)
    X, y, theta, s = rng.standard_normal((9, 3)), rng.standard_normal(9), *np.eye(3)[:2]
    here, there = (Normal(X.T @ X, X.T @ (y - X @ at)) for at in (theta, theta + s))
    np.testing.assert_allclose(here.after(s).slope, there.slope, atol=1e-12)
    np.testing.assert_array_equal(here.after(s).information, there.information)
