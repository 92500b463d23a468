"""The programmes at their start against the structure's own error, and their solutions."""

import casadi as ca
import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, HoverRoll, Lag

from casid import SolverOptions
from casid.matching.lifted import START, TIE, lift
from casid.matching.mismatch import residuals
from casid.matching.targets import compare
from casid.model import free_parameters

MODEL = HoverRoll(Yv=-0.3, Lv=-0.2, Lp=-2.0, Llat=9.0, tau=0.03)
COMPARISON = compare(MODEL, [TRUTH.system()], weight=np.array([[1.0], [0.5]]))
ERROR = COMPARISON.error(MODEL.system())


def test_programmes_start_feasible_with_the_cost_of_their_start():
    mean = np.linalg.norm(ERROR) ** 2 / len(ERROR)
    largest = np.linalg.norm(ERROR, 2, axis=(1, 2)).max() ** 2
    model = MODEL.system().response(COMPARISON.s.imag, COMPARISON.shift)
    decibels = np.sum(residuals(model, COMPARISON.G, COMPARISON.decibel_weight) ** 2)
    expected = {"quadratic": mean, "hinf": START * largest + TIE * mean, "decibel": decibels}
    free = free_parameters(MODEL)
    for norm, cost in expected.items():
        lifted = lift(free, COMPARISON, norm, free.guess)
        p = lifted.problem
        f, g = ca.Function("start", [p.x], [p.f, p.g])(p.x0)
        assert float(f) * lifted.unit**2 == pytest.approx(cost, rel=1e-9)
        assert np.abs(g.full()).max() < 1e-9
        np.testing.assert_allclose(lifted.parameters(p.x0), MODEL.vector(), rtol=1e-12)


@pytest.mark.parametrize("norm", ["quadratic", "hinf", "decibel"])
def test_every_norm_has_its_minimum_at_the_truth(norm):
    free = free_parameters(MODEL)
    comparison = compare(MODEL, [TRUTH.system()])
    found = lift(free, comparison, norm, free.guess).solve(SolverOptions(), "truth")
    assert found.success
    np.testing.assert_allclose(found.values, TRUTH.vector(), rtol=1e-3 if norm == "hinf" else 1e-6)


def test_multipliers_are_derivatives_of_the_cost_by_the_bound():
    comparison = compare(Lag(), [SECOND], omega=np.geomspace(0.1, 10.0, 30))

    def optimum(norm, upper):
        free = free_parameters(Lag(), bounds={"a": (0.1, upper)})
        return lift(free, comparison, norm, np.array([upper, 1.0])).solve(SolverOptions(), "price")

    for norm in ("quadratic", "decibel"):
        step = 1e-4
        slope = (optimum(norm, 0.7 + step).cost - optimum(norm, 0.7 - step).cost) / (2 * step)
        assert slope < 0
        assert optimum(norm, 0.7).multipliers[0] == pytest.approx(slope, rel=1e-4)
