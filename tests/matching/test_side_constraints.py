"""Constraints beside the responses: which there are, and that poles stay where they allow."""

import numpy as np
import pytest
from truths.structures import TRUTH, HoverRoll
from truths.swing import Swing

from casid import Constraint, Scalar, Trim, parameter
from casid.evaluation import MatrixFunction
from casid.free import free_parameters
from casid.matching.side_constraints import SideConstraints, _factor
from casid.matching.targets import comparison_of


class Composed(HoverRoll):
    """A delay of two parameters and a constraint."""

    rotor: Scalar = parameter(default=0.03, lower=0.0, upper=0.3, unit="s")

    def delays(self):
        return {"lat": self.tau + 2 * self.rotor}

    def constraints(self):
        return [Constraint("damped", self.Lp * self.Yv, lower=0.1, upper=9.0)]


def test_constraints_and_composed_delays_have_their_limits():
    model = Composed(Lp=-2.0, Yv=-0.3, tau=0.02)
    free = free_parameters(model)
    side = SideConstraints(free, comparison_of(model, [TRUTH.system()]), None)
    values = side.values(free.guess / free.scale[free.index])
    # d (Lp Yv) = Yv dLp + Lp dYv, each parameter moved by its own scale: what counts as one
    scale = dict(zip(free.names, free.scale[free.index], strict=True))
    one = 0.3 * scale["Lp"] + 2.0 * scale["Yv"]
    np.testing.assert_allclose(values, [0.6 / one, 0.08], rtol=1e-12)
    np.testing.assert_allclose(side.limits, [[0.1 / one, 0.0], [9.0 / one, np.inf]], rtol=1e-12)


@pytest.mark.parametrize("shift", [0.5, 2.0])
def test_the_lyapunov_equation_holds_at_the_start_exactly_left_of_the_line(shift):
    free = free_parameters(TRUTH)
    comparison = comparison_of(TRUTH, [TRUTH.system()], shift=shift)
    at = MatrixFunction(free)(free.guess)
    side = SideConstraints(free, comparison, at)
    residual = side.values(np.concatenate([free.guess / free.scale[free.index], side.start[0]]))
    assert (
        np.linalg.eigvals(at.blocks[0]).real.max() < shift - 0.1 * np.prod(comparison.band) ** 0.5
    )
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)
    assert side.count == 6


def test_conditions_that_nothing_couples_have_lyapunov_equations_of_their_own():
    conditions = [Trim(name=f"{x}", values={"theta": x}) for x in (0.0, 0.5, 1.1)]
    model = Swing(M=6.0, tau=0.1).at(*conditions)
    free = free_parameters(model)
    at = MatrixFunction(free)(free.guess)
    side = SideConstraints(free, comparison_of(model, [model.system()]), at)
    residual = side.values(np.concatenate([free.guess / free.scale[free.index], side.start[0]]))
    assert len(side.start[0]) == 3 * 3  # of 6 * 7 / 2
    assert side.count == 3 * 3
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)


def test_values_that_ran_far_away_still_have_a_start():
    # Poles at -0.1 ± 1e7 j: by their size on the line, where Lyapunov's equation has no solution.
    far = np.array([[-1.2, 0.0, 1e-4], [0.0, -0.1, -6.9], [-540.0, 2.5e13, -0.1]])
    for F in (far, -np.eye(3)):
        M, lower, upper = _factor(F)
        assert np.isfinite(M).all()
        assert len(M) == len(lower) == len(upper) == 6
    np.testing.assert_allclose(_factor(-np.eye(2))[0], [np.sqrt(0.5), 0.0, np.sqrt(0.5)])
