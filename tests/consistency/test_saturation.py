"""A delay of a channel whose likelihood is a closed form: where a parabola holds."""

import numpy as np
import pytest

from casid.consistency.errors_in_variables import Eliminated, Normal
from casid.consistency.saturation import ratio_errors

T = np.arange(0, 10 * np.pi, 0.05)


class Delayed:
    """An oscillation ``frequency`` that is seen so much ``late``, besides one unknown level.

    ``beside`` of the residuals no delay explains.
    """

    def __init__(self, frequency, late, size=1.0, beside=0.0):
        self.frequency, self.late, self.size = frequency, late, size
        self.beside = beside * np.cos(13 * T)

    def blocks(self, x, _own):
        at = self.frequency * (T - x[0])
        seen = np.sin(self.frequency * (T - self.late)) + 2.0 + self.beside
        slopes = [-self.frequency * np.cos(at), np.ones(len(T)), 1e-6 * np.cos(7 * T)]
        return [("v", 0, self.size * np.array([seen - np.sin(at) - x[1], *slopes]))]

    def whitened(self, blocks):
        return blocks

    def normal(self, parts, _own):
        ((_, _, rows),) = parts
        flown = Eliminated(Normal(rows[1:] @ rows[1:].T, rows[1:] @ rows[0]), 2)
        return flown.shared, [flown]


def errors(frequency, late, size=1.0, prior=10.0, beside=0.0):
    """Standard errors of the delay: by curvature, and by the likelihood ratio."""
    problem, own = Delayed(frequency, late, size, beside), np.zeros((1, 1))
    (plain,) = problem.normal(problem.blocks(np.array([late, 2.0]), own), own)[1]
    curved = np.sqrt(np.diag(np.linalg.inv(plain.shared.information)))
    x = np.array([late, 2.0])
    parts = problem.whitened(problem.blocks(x, own))
    found = ratio_errors(problem, parts, x, own, np.array([prior, 10.0]), curved, [0])
    assert found[1] == curved[1]  # a level is no delay
    return curved[0], found[0]


def test_where_a_delay_is_short_beside_the_period_the_error_is_that_of_the_curvature():
    curved, found = errors(1.0, 0.05, 20.0)
    assert 3 * curved < 0.05  # so that it is looked at
    assert found == pytest.approx(curved, rel=1e-3)  # 1 - (ω τ)²/24 of a cosine


@pytest.mark.parametrize("beside", [0.0, 0.5])
def test_half_a_period_late_the_error_is_that_of_the_likelihood_ratio(beside):
    """Σ ε² = 2 N (1 − cos ω τ)/2 of two oscillations, a parabola says N (ω τ)²/2."""
    late = np.pi / 10
    curved, found = errors(10.0, late, 0.5, beside=beside)
    assert found / curved == pytest.approx(np.pi / 2, rel=2e-2)


def test_what_is_within_its_noise_keeps_its_error():
    curved, found = errors(10.0, 0.02, 0.05)
    assert found == curved


def test_where_the_likelihood_tells_nothing_the_error_is_that_of_the_prior():
    period = 2 * np.pi / 10  # late by a whole one all is as if it were not
    curved, found = errors(10.0, period, prior=0.3)
    assert curved < 0.01
    assert found == pytest.approx(0.3, rel=1e-3)


def test_without_the_delay_all_else_is_adjusted():
    late, size, prior = np.pi / 0.3, 5.0, 40.0  # of one and a half periods, whose mean is a level
    curved, found = errors(0.3, late, size, prior)
    differ = size * 2 * np.sin(0.3 * T)
    ratio = np.sum((differ - differ.mean()) ** 2) + (late / prior) ** 2
    assert found == pytest.approx(late / np.sqrt(ratio), rel=1e-5)
    assert found > 1.2 * curved
