"""Costs of a response and their derivatives, against differences and the sums they stand for."""

import numpy as np
import pytest
from truths.structures import TRUTH, HoverRoll

from casid.matching.costs import Decibels, MeanSquare
from casid.matching.mismatch import weighted_errors
from casid.matching.targets import comparison_of

MODEL = HoverRoll(Yv=-0.3, Lv=-0.2, Lp=-2.0, Llat=9.0, tau=0.03)
MASK = np.ones((40, 2, 1))
MASK[:9, 1] = 0.0  # no roll angle at low frequency
COMPARISON = comparison_of(MODEL, [TRUTH.system()], weight=MASK)
G = MODEL.system().response(COMPARISON.s.imag, COMPARISON.shift)
COSTS = {"mean square": MeanSquare(COMPARISON, 0.5, 0.3), "decibels": Decibels(COMPARISON, 0.5)}


def test_values_are_those_sums():
    square = 0.3 * np.linalg.norm(COMPARISON.error(MODEL.system())) ** 2 / len(COMPARISON.s)
    decibels = np.sum(weighted_errors(G, COMPARISON.G, COMPARISON.decibel_weight) ** 2)
    for name, sum_ in {"mean square": square, "decibels": decibels}.items():
        cost = COSTS[name]
        assert cost.value(cost.errors(G)) == pytest.approx(sum_ / 0.25, rel=1e-12)


@pytest.mark.parametrize("cost", COSTS.values(), ids=COSTS)
def test_derivatives_are_those_of_differences(cost):
    rng, h = np.random.default_rng(8), 1e-4
    d = (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)) * np.abs(G)

    def along(step):
        return cost.value(cost.errors(G + step * d))

    E, dE = cost.errors(G), (cost.factor(G) * d)[None]
    slope = np.sum(cost.pull(E).conj() * dE).real
    assert slope == pytest.approx((along(h) - along(-h)) / (2 * h), rel=1e-6)
    twice = np.sum(dE.conj() * cost.curved(E, dE)).real
    assert twice == pytest.approx((along(h) - 2 * along(0) + along(-h)) / h**2, rel=1e-5)
