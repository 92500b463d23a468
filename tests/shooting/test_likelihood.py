"""Likelihood of residuals against SciPy's normal distribution."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from casid.shooting.likelihood import Noise, moments_of

PATTERNS = np.array([[True, True, True], [True, False, True], [False, True, False]])
SIGMA = np.array([[4.0, 1.0, 0.2], [1.0, 2.0, -0.3], [0.2, -0.3, 1.0]])


def residuals(n=300):
    rng = np.random.default_rng(6)
    pattern = rng.integers(0, 3, n)
    r = rng.multivariate_normal(np.zeros(3), SIGMA, n) * PATTERNS[pattern]
    return r, pattern


def noise_of(pattern, kind="full"):
    return Noise(PATTERNS, np.bincount(pattern), np.full(3, 1e-6), kind)


def test_the_cost_is_minus_the_logarithm_of_the_normal_density():
    r, pattern = residuals()
    cost = noise_of(pattern).cost(SIGMA, moments_of(r, pattern, 3))
    log = 0.0
    for row, p in zip(r, pattern, strict=True):
        seen = PATTERNS[p]
        block = SIGMA[np.ix_(seen, seen)]
        log += scipy.stats.multivariate_normal.logpdf(row[seen], np.zeros(seen.sum()), block)
    n = PATTERNS[pattern].sum()
    assert cost == pytest.approx(-log - 0.5 * n * np.log(2 * np.pi), rel=1e-12)


@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_no_covariance_of_its_kind_is_more_likely(kind):
    r, pattern = residuals()
    noise, moments = noise_of(pattern), moments_of(r, pattern, 3)
    if kind == "diagonal":  # of the channels one by one, each from the samples that have it
        noise, r = noise_of(pattern, kind), r * PATTERNS[pattern]
    R = noise.covariance(moments)
    best = noise.cost(R, moments)
    rng = np.random.default_rng(7)
    for _ in range(50):
        step = rng.standard_normal((3, 3)) * 1e-3
        step = np.diag(np.diag(step)) if kind == "diagonal" else step + step.T
        assert noise.cost(R + step, moments) > best - 1e-9
    assert np.count_nonzero(R) == (3 if kind == "diagonal" else 9)


def test_a_floor_keeps_what_is_fitted_exactly_and_a_given_covariance_stays():
    _, pattern = residuals()
    noise = noise_of(pattern)
    nothing = noise.covariance(np.zeros((3, 3, 3)))
    np.testing.assert_allclose(nothing, 1e-12 * np.eye(3), rtol=1e-9, atol=1e-24)
    assert noise.exact(nothing)
    assert not noise.exact(SIGMA)
    given = replace(noise, given=SIGMA)
    np.testing.assert_array_equal(given.covariance(np.zeros((3, 3, 3))), SIGMA)
    assert (given.unknowns, noise.unknowns, noise_of(pattern, "diagonal").unknowns) == (0, 6, 3)
