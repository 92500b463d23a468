"""Tails of weighted sums of squares, against those that have a closed form."""

import numpy as np
import pytest
import scipy

from casid.weighted_squares import upper_limit

CHANCES = [1e-2, 1e-4, 1e-6]


@pytest.mark.parametrize("chance", CHANCES)
@pytest.mark.parametrize("n", [1, 2, 18])
def test_equal_weights_of_a_known_variance_are_chi_squared(n, chance):
    limit = upper_limit(np.full(n, 1 / n), np.inf, chance)
    assert limit == pytest.approx(scipy.special.chdtri(n, chance) / n, rel=0.02)


@pytest.mark.parametrize("chance", CHANCES)
@pytest.mark.parametrize(("n", "m"), [(2, 30.0), (8, 12.0), (18, 200.0)])
def test_over_a_variance_that_is_estimated_they_are_f(n, m, chance):
    limit = upper_limit(np.full(n, 1 / n), m, chance)
    assert limit == pytest.approx(scipy.stats.f.isf(chance, n, m), rel=0.02)


@pytest.mark.parametrize("chance", CHANCES)
def test_of_two_pairs_of_weights_the_larger_rules_the_tail(chance):
    # Two squares of weight λ are exponential: P = (λ1 e^(-x/2λ1) - λ2 e^(-x/2λ2))/(λ1 - λ2).
    large, small = 0.4, 0.1
    x = float(upper_limit(np.array([large, large, small, small]), np.inf, chance))
    tail = large * np.exp(-x / (2 * large)) - small * np.exp(-x / (2 * small))
    assert tail / (large - small) == pytest.approx(chance, rel=0.1)
    # One χ² of the same mean and variance has a shorter one.
    freedom = 1 / (2 * large**2 + 2 * small**2)
    assert scipy.special.chdtri(freedom, chance) / freedom < x


def test_all_are_found_at_once_and_weights_of_zero_change_nothing():
    rows = np.array([[0.7, 0.3, 0.0], [1.0, 0.0, 0.0]])
    both = upper_limit(rows, np.array([20.0, np.inf]), 1e-3)
    assert both[0] == pytest.approx(upper_limit(rows[0, :2], 20.0, 1e-3))
    assert both[1] == pytest.approx(upper_limit(rows[1, :1], np.inf, 1e-3))
