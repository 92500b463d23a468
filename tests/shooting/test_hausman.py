"""One source of an estimate against the others, by closed forms of linear measurements."""

import numpy as np
import pytest
from scipy.stats import chi2

from casid.shooting.hausman import SELDOM, SMALLER, Source, disagreement, misstated

RNG = np.random.default_rng(3)
NF = 4


def information(rank=NF):
    J = RNG.standard_normal((rank, NF))
    return J.T @ J


def joint(one, other, F1, F2):
    """The source of the one estimate at that of both, weighed by their information."""
    P = np.linalg.inv(F1 + F2)
    at = P @ (F1 @ one + F2 @ other)
    return Source(F1 @ (at - one), F1, F1), P, at


def test_the_distance_is_that_of_the_estimates_of_both_sides():
    F1, F2 = information(), information()
    one, other = RNG.standard_normal((2, NF))
    source, P, at = joint(one, other, F1, F2)
    own, V2 = np.linalg.inv(F1), np.linalg.inv(F2)
    found = disagreement(source, P, P)
    off = one - other
    assert found.freedom == NF
    assert found.square == pytest.approx(off @ np.linalg.solve(own + V2, off))
    np.testing.assert_allclose(found.apart, (other - at) / np.sqrt(np.diag(V2 - P)))
    # Coloured noise of the others, three times the variance, and own errors half as large again.
    rough = source._replace(S=1.5**2 * F1)
    V = P @ (1.5**2 * F1 + 3 * F2) @ P
    found = disagreement(rough, P, V)
    assert found.square == pytest.approx(off @ np.linalg.solve(1.5**2 * own + 3 * V2, off))


def test_errors_of_the_others_below_the_stated_make_nothing_surer():
    F1, F2 = information(), information()
    source, P, _ = joint(*RNG.standard_normal((2, NF)), F1, F2)
    assert disagreement(source, P, P / 9).square == pytest.approx(disagreement(source, P, P).square)


def test_a_source_of_some_combinations_is_compared_in_these():
    F1, F2 = information(rank=2), information()
    F2[:, 0] = F2[0] = 0.0  # the first parameter is held
    F1[:, 0] = F1[0] = 0.0
    P = np.zeros((NF, NF))
    P[1:, 1:] = np.linalg.inv((F1 + F2)[1:, 1:])
    off = RNG.standard_normal(NF)
    found = disagreement(Source(F1 @ off, F1, F1), P, P)
    assert found.freedom == 2
    assert found.apart[0] == 0


def test_agreement_is_called_none_as_seldom_as_said():
    F1, F2 = information(), information()
    roots = [np.linalg.cholesky(np.linalg.inv(F)) for F in (F1, F2)]
    squares = [
        disagreement(*joint(*(L @ RNG.standard_normal(NF) for L in roots), F1, F2)[:2], P).square
        for P in [np.linalg.inv(F1 + F2)] * 2000
    ]
    assert np.mean(squares) == pytest.approx(NF, abs=4 * np.sqrt(2 * NF / 2000))
    limit = chi2.isf(SELDOM, NF)
    assert np.mean(np.array(squares) > limit) < 8 * SELDOM
    source, P, _ = joint(np.zeros(NF), np.zeros(NF), F1, F2)
    assert not disagreement(source, P, P).significant
    step = np.array([1.0, 0, 0, 0])
    away = np.sqrt(1.01 * limit / (step @ np.linalg.solve(sum(L @ L.T for L in roots), step)))
    found = disagreement(joint(away * step, 0 * step, F1, F2)[0], P, P)
    assert found.significant
    assert f"in {NF} combinations of parameters, where chance exceeds 18 once" in found.told(
        ("a", "b", "c", "d")
    )


def test_residuals_as_large_as_stated_are_called_otherwise_as_seldom_as_said():
    # The mean of 50 independent complex residuals is chi-square of 100 degrees of freedom.
    draws = RNG.exponential(size=(4000, 50))
    assert np.mean([misstated(each, 50.0, 0.0) != 1 for each in draws]) < 3 * SELDOM
    # Ten of every residual are alike: there are no more for that.
    alike = np.repeat(RNG.exponential(size=(4000, 5)), 10, axis=1)
    assert np.mean([misstated(each, 5.0, 0.0) != 1 for each in alike]) < 3 * SELDOM


@pytest.mark.parametrize("factor", [0.01, 0.5 * SMALLER, 1.5, 3.0])
def test_residuals_of_another_size_than_stated_tell_by_what(factor):
    found = misstated(factor**2 * RNG.exponential(size=4000), 4000.0, 7.0)
    assert found == pytest.approx(factor, rel=0.1)


def test_what_is_off_at_some_points_is_no_error_of_all():
    power = RNG.exponential(size=1000)  # the median, 1.13 squared, is known to 5 %
    power[:150] *= 100.0
    assert misstated(power, 1000.0, 0.0) == 1


def test_few_points_that_many_parameters_take_tell_nothing():
    assert misstated(np.full(3, 1e-6), 3.0, 6.0) == 1


def test_what_one_source_alone_tells_contradicts_nothing():
    F1, F2 = np.diag([1.0, 2.0, 3.0, 4.0]), np.diag([2.0, 0.0, 1.0, 0.0])
    source, P, _ = joint(*RNG.standard_normal((2, NF)), F1, F2)
    found = disagreement(source, P, P)
    assert found.freedom == 2
    assert np.isfinite(found.square)
