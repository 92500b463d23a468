"""Profiles of linear least squares have closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from truths.mixture import NOISE, TRUTH, Inline, Mixture, least_squares, record

from casid import Execution, ModelError, OutputError, profile_parameters
from casid.bounds.profiles import _parabola

QUANTILE = scipy.stats.chi2.ppf(0.95, 1)
HERE = Execution(executor=Inline())
KNOWN = {"estimator": OutputError(R=np.array([[NOISE**2]])), "execution": HERE}


def solved():
    X, y = least_squares()
    free = np.linalg.lstsq(X, y)[0]
    return free, np.linalg.inv(X.T @ X), float(np.sum((X @ free - y) ** 2)), len(y)


@pytest.mark.second
def test_the_profile_of_a_linear_problem_is_the_parabola_of_its_covariance():
    free, covariance, _, _ = solved()
    sigma = np.sqrt(covariance[0, 0])
    values = free[0] + sigma * np.array([-3, -1, 0, 2, 3])
    found = profile_parameters(Mixture(), [record()], values={"a": values}, **KNOWN)
    rise = 0.5 * ((values - free[0]) / sigma) ** 2
    np.testing.assert_allclose(found.cost - found.fit.cost, rise, atol=1e-5)
    np.testing.assert_allclose(found.parabola - found.fit.cost, rise, atol=1e-5)
    np.testing.assert_allclose(found.slope[:, 0], (values - free[0]) / sigma**2,
                               atol=1e-4 / sigma)  # fmt: skip
    expected = free[0] + sigma * np.sqrt(QUANTILE) * np.array([-1, 1])
    np.testing.assert_allclose(found.cramer_rao["a"], expected, rtol=1e-4)
    half = np.sqrt(QUANTILE) * found.fit["a"].std_error * np.array([-1, 1])
    np.testing.assert_allclose(found.standard["a"], found.fit["a"].value + half, rtol=1e-12)
    np.testing.assert_allclose(found.intervals["a"], found.standard["a"], rtol=1e-5)
    assert "Cramér-Rao" in found.to_markdown()
    assert len(found.to_csv().splitlines()) == 6


@pytest.mark.slow
def test_the_interval_allows_for_correlated_residuals_and_does_not_depend_on_the_values():
    # Noise of a first-order process with the white noise's variance.
    rng, r = np.random.default_rng(2), record()
    e = np.zeros(r.N)
    for k in range(1, r.N):
        e[k] = 0.8 * e[k - 1] + 0.6 * NOISE * rng.standard_normal()
    clean = TRUTH.system().simulate(r.t, r.u)
    coloured = replace(r, y=clean + e[:, None])
    free, far = (
        profile_parameters(Mixture(), coloured, values={"a": [value]}, **KNOWN)
        for value in (1.0, 1.5)
    )
    row = free.fit["a"]
    assert row.std_error > 1.3 * row.cramer_rao
    expected = row.value + np.sqrt(QUANTILE) * row.std_error * np.array([-1, 1])
    np.testing.assert_allclose(free.intervals["a"], expected, rtol=1e-4)
    assert far.intervals == free.intervals


@pytest.mark.second
def test_the_interval_is_exact_when_the_noise_is_estimated_too():
    # The variance concentrated out, 2 ΔJ = n log(1 + d² / (v S)), S the sum of squares.
    free, covariance, squares, n = solved()
    v = covariance[1, 1]
    w = n / (n - len(free))  # by which the residuals' variance is larger than their mean square
    half = np.sqrt(v * squares * np.expm1(w * QUANTILE / n))
    values = free[1] + half * np.array([-1.5, 1.5])
    found = profile_parameters(Mixture(), record(), values={"b": values}, execution=HERE)
    np.testing.assert_allclose(found.intervals["b"], [free[1] - half, free[1] + half], rtol=1e-4)


@pytest.mark.second
def test_there_is_no_parabola_of_an_estimate_on_its_bound_nor_beside_a_tie():
    free, covariance, _, _ = solved()
    sigma = np.sqrt(np.diag(covariance))
    edge = {"a": (-9.0, free[0] - 2 * sigma[0])}
    axes = {"a": edge["a"][1] - sigma[0] * np.array([1.0, 0.0])}
    found = profile_parameters(Mixture(), [record()], values=axes, bounds=edge, **KNOWN)
    assert np.all(np.isfinite(found.cost))
    assert np.isnan(found.parabola).all()  # the cost rises by a slope there as well

    tied = np.outer(sigma[:3], sigma[:3]) * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]])
    fit = replace(found.fit, notes=replace(found.fit.notes, cramer_rao=tied))
    at = np.array([fit["a"].value, fit["b"].value])
    rise = _parabola(fit, "ab", at + sigma[:2] * np.array([[0, 0], [2, 2], [2, 1]])) - fit.cost
    np.testing.assert_allclose(rise, [0.0, 2.0, np.nan], atol=1e-9)


@pytest.mark.slow
def test_a_grid_over_two_parameters_gives_the_interval_of_each():
    free, covariance, _, _ = solved()
    sigma = np.sqrt(np.diag(covariance))
    rho = covariance[0, 1] / sigma[0] / sigma[1]
    steps = np.array([-3.0, 0.0, 3.0])
    axes = {"a": free[0] + sigma[0] * steps, "b": free[1] + sigma[1] * rho * steps}
    found = profile_parameters(Mixture(), [record()], values=axes, **KNOWN)
    assert found.points.shape == (9, 2)
    np.testing.assert_allclose(found.cost, found.parabola, atol=1e-4)
    for k, name in enumerate("ab"):  # least over the other, whatever the grid
        variance = found.fit.covariance[k, k]
        expected = free[k] + np.sqrt(QUANTILE * variance) * np.array([-1, 1])
        np.testing.assert_allclose(found.intervals[name], expected, rtol=1e-3)


class Direct(Mixture):
    """Known lags with unknown gains; the direct term is a share d of the fast one's."""

    def B(self):
        return [[self.a], [self.b]]

    def C(self):
        return [[1, 1]]

    def D(self):
        return [[self.a * self.d]]


@pytest.mark.second
def test_a_value_that_leaves_another_parameter_without_effect_has_its_own_slope():
    X, y = least_squares()
    with pytest.warns(UserWarning, match="d has no effect"):
        found = profile_parameters(Direct(), [record()], values={"a": [0.0]}, **KNOWN)
    others = X[:, [1, 3, 4, 5]]  # the slow lag, initial states, the bias
    left = y - others @ np.linalg.lstsq(others, y)[0]
    assert found.slope[0] == pytest.approx(-(X[:, 0] + Direct().d * X[:, 2]) @ left, rel=1e-5)


@pytest.mark.second
def test_an_interval_ends_on_a_bound_that_comes_first():
    free, covariance, _, _ = solved()
    sigma = np.sqrt(covariance[0, 0])
    limit = float(free[0] + 0.5 * sigma)
    found = profile_parameters(
        Mixture(a=free[0] - sigma), record(), values={"a": [limit - sigma]},
        bounds={"a": (-9.0, limit)}, **KNOWN,
    )  # fmt: skip
    assert found.intervals["a"][1] == limit
    assert found.intervals["a"][0] < free[0] - 1.5 * sigma


def test_a_profile_of_nothing_or_of_strangers_is_refused():
    with pytest.raises(ModelError, match="no values of a"):
        profile_parameters(Mixture(), [record()], values={"a": []})
    with pytest.raises(ModelError, match="values of a have 1 twice"):
        profile_parameters(Mixture(), [record()], values={"a": [1.0, 0.5, 1.0]})
    with pytest.raises(ModelError, match="name 3 parameters, expected one or two"):
        profile_parameters(Mixture(), [record()], values={name: [1.0] for name in "abd"})
    with pytest.raises(ValueError, match=r"level=95: expected"):
        profile_parameters(Mixture(), [record()], values={"a": [1.0]}, level=95)
    with pytest.raises(ModelError, match="no parameter 'z'"):
        profile_parameters(Mixture(), [record()], values={"z": [1.0]})
