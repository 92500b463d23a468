"""Regressors with noise: the slope of a line through points that err in both coordinates."""

import numpy as np
import pytest

from casid.consistency.pretended import Corrected, Normal


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
    (variance,) = corrected.variances(scores, np.ones(1))
    assert np.mean(steps**2) < variance < 1.0


def test_of_what_is_mostly_noise_nothing_but_the_prior_is_known():
    seen = Normal(np.diag([100.0, 100.0]), np.array([1.0, 1.0]))
    pretended = Normal(np.diag([0.0, 90.0]), np.zeros(2))
    corrected = Corrected(seen, pretended)
    np.testing.assert_allclose(corrected.step(), [0.01, 0.01])
    one, other = corrected.variances(np.zeros((10, 2)), np.array([1.0, 3.0]))
    assert one == pytest.approx(0.01)
    assert other == pytest.approx(9.01)


def test_steps_without_noise_are_those_of_the_sum_of_normal_equations():
    A, B = np.array([[1.0, 0.97], [0.97, 1.0]]), np.diag([3.0, 1e-2])
    seen = Normal(A, np.array([1.0, 2.0])) + Normal(B, np.array([-4.0, 0.5]))
    none = Normal(np.zeros((2, 2)), np.zeros(2))
    expected = np.linalg.solve(A + B, [-3.0, 2.5])
    np.testing.assert_allclose(Corrected(seen, none).step(), expected, rtol=1e-9)
    close = Corrected(Normal(A, np.array([1.0, 0.0])), none).step()  # condition 66
    np.testing.assert_allclose(close, np.linalg.solve(A, [1.0, 0.0]), rtol=1e-9)
