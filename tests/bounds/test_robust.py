"""Weights of the likelihood ratio against linear least squares by hand, p-values against draws."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
import scipy.stats
from truths.mixture import NOISE, Inline, Mixture, least_squares, record

from casid import Execution, OutputError, compare_bounds, output_error
from casid.bounds.robust import (
    _by_records,
    p_value,
    price_p_values,
    ratio_p_value,
    scattered,
    weights,
)
from casid.fit import Fit
from casid.shooting.precision import OutputErrorNotes

KNOWN = OutputError(R=np.array([[NOISE**2]]))
RNG = np.random.default_rng(4)
ROOT = RNG.standard_normal((3, 3))
TRUE = ROOT @ ROOT.T  # covariance that the estimates really have


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit to records whose covariance is not the inverse information."""
    found = output_error(Mixture(), record(), R=KNOWN.R)
    scale = np.sqrt(np.diag(found.notes.cramer_rao))
    return replace(found, covariance=TRUE * np.outer(scale, scale))


def test_one_combination_has_the_ratio_of_its_variances(fit):
    for a in np.eye(3), RNG.standard_normal((3, 3)):
        for row in a:
            P, V = fit.notes.cramer_rao, fit.covariance
            (w,) = weights(fit, row[None])
            assert w == pytest.approx((row @ V @ row) / (row @ P @ row), rel=1e-9)


def test_units_of_combinations_do_not_matter(fit):
    A = np.array([[1.0, -2.0, 0.0], [0.0, 1.0, 3.0]])
    small = weights(fit, A * [[1.0], [1e-9]])
    np.testing.assert_allclose(np.sort(small), np.sort(weights(fit, A)), rtol=1e-6)
    assert len(small) == 2


@pytest.mark.campaign
def test_the_likelihood_ratio_is_distributed_as_the_weights_say(fit):
    # Estimates drawn with the true covariance; the ratio is the quadratic form of the information.
    A = np.array([[1.0, -2.0, 0.0], [0.0, 1.0, 3.0]])
    P, V = fit.notes.cramer_rao, fit.covariance
    draws = np.random.default_rng(5).multivariate_normal(np.zeros(3), V, 200_000) @ A.T
    ratio = np.einsum("ni,ij,nj->n", draws, np.linalg.inv(A @ P @ A.T), draws)
    w = weights(fit, A)
    assert len(w) == 2
    assert w.sum() == pytest.approx(ratio.mean(), rel=0.02)  # scatters by 0.4 %
    rejected = np.mean([p_value(x, w) < 0.05 for x in ratio[:20_000]])
    assert rejected == pytest.approx(0.05, abs=0.01)  # the approximation's own error
    prices = draws @ np.linalg.inv(A @ P @ A.T)  # of equations, the gradient of half the form
    shares = np.mean([price_p_values(fit, A, row) < 0.05 for row in prices[:20_000]], axis=0)
    np.testing.assert_allclose(shares, 0.05, atol=0.006)  # 20 000 draws scatter by 0.0015


def test_rows_that_repeat_or_hold_nothing_do_not_count(fit):
    A = np.array([[1.0, -2.0, 0.0], [-2.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(weights(fit, A), weights(fit, A[:1]), rtol=1e-9)
    assert not len(weights(replace(fit, notes=None), A))
    assert p_value(3.0, np.zeros(0)) == 1.0


def test_a_variance_that_is_but_rounding_does_not_count(fit):
    # As a parameter on its bound has it: 1e-35 and 1e-29 where others have 1e-6.
    tiny = np.diag([1.0, 1e-16, 1.0])
    held = replace(
        fit,
        covariance=1e4 * tiny @ fit.covariance @ tiny,
        notes=replace(fit.notes, cramer_rao=tiny @ fit.notes.cramer_rao @ tiny),
    )
    expected = 1e4 * weights(fit, np.eye(3)[[0, 2]])
    np.testing.assert_allclose(weights(held, np.eye(3)), expected, rtol=1e-6)


def test_a_combination_that_is_held_already_does_not_count_whatever_rounding_leaves(fit):
    across = np.array([[0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])  # a + b is held
    P = across @ fit.notes.cramer_rao @ across
    for left in (0.0, 3e-16, -3e-16):
        rounded = P + left * P[0, 0] * np.diag([1.0, 0.0, 0.0])
        held = replace(
            fit,
            covariance=across @ fit.covariance @ across,
            notes=replace(fit.notes, cramer_rao=rounded),
        )
        assert not len(weights(held, np.array([[1.0, 1.0, 0.0]])))
        assert len(weights(held, np.array([[1.0, -1.0, 0.0]]))) == 1
        assert ratio_p_value(held, np.array([[1.0, 1.0, 0.0]]), 1e-15) == 1.0


def test_a_price_is_as_surprising_as_its_multiplier_is_many_sigmas():
    X, y = least_squares()
    x, C = np.linalg.lstsq(X, y)[0], np.linalg.inv(X.T @ X)
    cases = {"free": {}, "bound": {"a": "< 0.97"}, "tie": {"constraints": ["a = 2 b"]}}
    cases["value"] = {"b": 0.6}
    here = Execution(executor=Inline())
    found = compare_bounds(Mixture(), record(), cases=cases, estimator=KNOWN, execution=here)
    rows = {"bound": ("a", [1, 0, 0], 0.97), "tie": ("a = 2 b", [1, -2, 0], 0.0)}
    rows["value"] = ("b", [0, 1, 0], 0.6)
    for name, (label, row, right) in rows.items():
        case = found[name]
        assert set(case.price_p_values) == {label}
        # white residuals, one thing held: price and ratio are the same test
        assert case.price_p_values[label] == pytest.approx(case.p_value, rel=0.02)
        e = np.array([*row, 0, 0, 0], dtype=float)
        expected = p_value((e @ x - right) ** 2 / (e @ C @ e), np.ones(1))
        assert np.log(case.p_value) == pytest.approx(np.log(expected), rel=0.15)


def by_records(fit, X, r, whose):
    """The fit as if its scores were those of least squares: X (n, 3), residuals r of variance 1."""
    parts = [(X[whose == c], r[whose == c]) for c in np.unique(whose)]
    told = {
        "cramer_rao": np.linalg.inv(X.T @ X),
        "record_scores": np.array([x.T @ e for x, e in parts]),
        "record_information": np.array([x.T @ x for x, _ in parts]),
    }
    return replace(fit, notes=replace(fit.notes, **told))


def test_one_combination_is_tested_as_bell_and_mccaffrey_do(fit):
    rng, whose, a = (
        np.random.default_rng(6),
        np.repeat(np.arange(5), 12),
        np.array([1.0, -2.0, 0.5]),
    )
    X = rng.standard_normal((60, 3)) * [1.0, 1e-3, 1e3]
    y = rng.standard_normal(60)
    M = np.linalg.inv(X.T @ X)
    hat = X @ M @ X.T
    r = y - hat @ y
    rows = []  # one a record: what its score adds to the estimate, by all residuals
    for c in range(5):
        own = whose == c
        A = np.linalg.inv(scipy.linalg.sqrtm(np.eye(12) - hat[np.ix_(own, own)]).real)
        rows.append(a @ M @ X[own].T @ A @ (np.eye(60) - hat)[own])
    variance, form = np.sum((np.array(rows) @ y) ** 2), np.array(rows) @ np.transpose(rows)
    freedom = np.trace(form) ** 2 / np.sum(form**2)
    assert 2 < freedom < 4
    found, gap = by_records(fit, X, r, whose), 0.7 * np.sqrt(a @ M @ a)
    expected = 2 * scipy.stats.t.sf(gap / np.sqrt(variance), freedom)
    p = ratio_p_value(found, a[None], gap**2 / (a @ M @ a))
    assert p == pytest.approx(expected, rel=1e-9)
    assert price_p_values(found, a[None], [gap / (a @ M @ a)]) == pytest.approx(expected, rel=1e-9)
    # Two records tell too little: then, and of several combinations, the covariance is asked.
    few = by_records(fit, X, r, whose % 2)
    for each, held in (few, a[None]), (found, np.eye(3)[:2]):
        assert ratio_p_value(each, held, 4.0) == p_value(4.0, weights(each, held))


def test_records_that_differ_reject_what_holds_of_all_of_them_as_often_as_stated(fit):
    rng, whose, rejected = np.random.default_rng(7), np.repeat(np.arange(5), 30), []
    for _ in range(400):
        X = rng.standard_normal((150, 3))
        r = np.einsum("nk,nk->n", X, rng.standard_normal((5, 3))[whose]) + rng.standard_normal(150)
        M = np.linalg.inv(X.T @ X)
        gap = (M @ X.T @ r)[0]
        held = by_records(fit, X, r - X @ (M @ X.T @ r), whose)
        rejected.append(ratio_p_value(held, np.eye(3)[:1], gap**2 / M[0, 0]) < 0.05)
    assert 0.02 < np.mean(rejected) < 0.085  # 400 draws scatter by 1.1 %


def test_scores_of_records_are_nothing_together_and_their_information_is_all():
    rng, flights = np.random.default_rng(8), [record(k) for k in range(4)]
    slow = scipy.signal.lfilter(
        [1.0], [1.0, -0.8], NOISE * rng.standard_normal((4, 400, 1)), axis=1
    )
    missed = [replace(r, y=r.y + e) for r, e in zip(flights, slow, strict=True)]
    notes = output_error(Mixture(), missed).notes
    size = np.sqrt(np.diag(notes.cramer_rao))
    assert np.abs(notes.record_scores * size).max() > 1
    np.testing.assert_allclose(notes.record_scores.sum(axis=0) * size, 0, atol=1e-3)
    whole = notes.record_information.sum(axis=0) @ notes.cramer_rao
    np.testing.assert_allclose(whole * size / size[:, None], np.eye(3), atol=1e-6)
    assert not len(output_error(Mixture(), flights).notes.record_scores)  # white residuals


def test_a_record_that_tells_nothing_has_no_degrees_of_freedom(fit):
    none = {"record_scores": np.zeros((1, 3)), "record_information": np.zeros((1, 3, 3))}
    silent = replace(fit, notes=replace(fit.notes, **none))
    assert np.array_equal(_by_records(silent, np.eye(3)[:1]), [[0.0], [0.0]])


@pytest.mark.parametrize(("times", "fewest", "most"), [(1.0, 0, 4), (4.0, 9, 10)])
def test_parameters_that_scatter_from_record_to_record_are_those_of_few_false_discoveries(
    times, fewest, most
):
    # Six records alike of twenty parameters, half of which scatter by so many times their errors:
    # scores less their mean are those of a sample, its variance is χ² of five degrees of freedom.
    rng, (n, m) = np.random.default_rng(7), (6, 20)
    e = rng.standard_normal((n, m)) * np.where(np.arange(m) < m / 2, times, 1.0) / np.sqrt(n)
    scores, eye = e - e.mean(axis=0), np.eye(m)
    names = tuple(f"a{i}" for i in range(m))
    notes = OutputErrorNotes(
        rounds=1, nodes=n, nuisances=0, cramer_rao=eye, correlation=eye, collinear=(),
        record_scores=scores, record_information=np.tile(eye / n, (n, 1, 1)),
    )  # fmt: skip
    stated = eye.copy()
    stated[-1, -1] = np.nan  # of what is held
    found = scattered(SimpleNamespace(notes=notes, covariance=stated, free_names=names))
    variance = n * np.var(scores[:, :-1], axis=0, ddof=1)
    chance = scipy.stats.chi2.sf((n - 1) * variance, n - 1)
    told = scipy.stats.false_discovery_control(chance) <= 0.05
    assert set(found) == {name for name, off in zip(names, told, strict=False) if off}
    assert fewest <= len(found) <= most
    for name, ratio in found.items():
        assert ratio**2 == pytest.approx(variance[names.index(name)])
    wide = replace(notes, between_records=eye)
    assert scattered(SimpleNamespace(notes=wide, covariance=stated, free_names=names)) == {}
    assert scattered(SimpleNamespace(notes=None, covariance=stated, free_names=names)) == {}
    few = replace(
        notes, record_scores=50 * scores[:2], record_information=np.tile(eye / 2, (2, 1, 1))
    )
    assert scattered(SimpleNamespace(notes=few, covariance=stated, free_names=names)) == {}
