"""The condensed problem's derivatives against differences, and what a descent promises."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, HoverRoll, Lag

from casid import Constraint, ModelError, Rows, Scalar, parameter
from casid.free import free_parameters
from casid.matching.descent import Condensed, _step, check_effects, descend
from casid.matching.mismatch import DB, DEG, PHASE
from casid.matching.targets import comparison_of


class Held(HoverRoll):
    """A delay of two parts and an inequality between them, both violated below."""

    lag: Scalar = parameter(default=0.0, lower=-0.2, upper=0.3, unit="s")

    def delays(self):
        return {"lat": self.tau + self.lag}

    def constraints(self):
        late = self.tau + 2 * self.lag
        return [Constraint("damped", self.Yv - 2 * self.Lp + late, lower=5.0, upper=np.inf)]


def condensed(model=None, target=TRUTH, **changes):
    model = Held() if model is None else model
    comparison = comparison_of(model, [target.system()])
    return replace(Condensed.of(free_parameters(model), comparison), **changes)


@pytest.mark.parametrize("norm", ["quadratic", "decibel"])
@pytest.mark.parametrize("guarded", [False, True])
def test_derivatives_are_those_of_differences(norm, guarded):
    problem = condensed(norm=norm, guarded=guarded)
    values = problem.free.guess + 0.03
    values[-2:] = 0.02, -0.05  # a delay of -30 ms
    x = problem.clip(values / problem.scale)
    r, J = problem.jacobian(x)
    np.testing.assert_allclose(r, problem.residual(x)[0], rtol=1e-12, atol=1e-15)
    h = 1e-6
    for i, row in enumerate(J):
        step = h * np.eye(len(x))[i]
        slope = (problem.residual(x + step)[0] - problem.residual(x - step)[0]) / (2 * h)
        # Central differences: h² times the third derivative, and rounding of r over h.
        np.testing.assert_allclose(row, slope, atol=1e-6 * np.abs(J).max())


def test_the_cost_is_the_mean_square_of_the_weighted_error():
    problem = condensed(HoverRoll())
    r, _ = problem.residual(problem.free.guess / problem.scale)
    c = problem.comparison
    mean = np.linalg.norm(c.error(HoverRoll().system())) ** 2 / len(c.s)
    assert r @ r == pytest.approx(mean, rel=1e-12)


def test_decibel_residuals_are_weighted_nepers_and_radians():
    model = TRUTH.with_vector(TRUTH.vector() * 1.1)
    problem = condensed(model, norm="decibel")
    r, comparison = problem.residual(model.vector() / problem.scale)[0], problem.comparison
    n = comparison.G.size
    G, W = comparison.G, comparison.W / np.sqrt(len(comparison.s))
    z = model.system().response(comparison.s.imag, comparison.shift) / G
    np.testing.assert_allclose(r[:n], (W * abs(G) * np.log(abs(z))).ravel(), atol=1e-12)
    phase = np.sqrt(PHASE) * DEG / DB * np.angle(z)
    np.testing.assert_allclose(r[n : 2 * n], (W * abs(G) * phase).ravel(), rtol=1e-9)


def test_no_step_leads_upwards_and_bounds_are_kept():
    model = Lag(a=15.0, k=-3.0)
    problem = Condensed.of(
        free_parameters(model, bounds={"a": (1.5, 20.0)}), comparison_of(model, [SECOND])
    )
    costs = [descend(problem, model.vector(), steps=n, tolerance=0.0).cost for n in range(12)]
    assert (np.diff(costs) <= 0).all()
    last = descend(problem, model.vector(), steps=100, tolerance=1e-9)
    assert last.settled
    assert last.values[0] >= 1.5
    assert descend(problem, last.values, steps=5, tolerance=1e-9).cost <= last.cost


def test_a_parameter_without_effect_is_named():
    class Idle(Lag):
        nothing: Scalar = parameter(default=1.0, lower=0.0, upper=2.0, unit="-")

        def A(self) -> Rows:
            return [[-self.a]]

    problem = Condensed.of(free_parameters(Idle()), comparison_of(Idle(), [SECOND]))
    with pytest.raises(ModelError, match="nothing has no effect on any weighted response"):
        check_effects(problem)


@pytest.mark.parametrize("seed", range(6))
def test_a_step_stops_at_bounds_and_is_the_least_squares_one_of_what_is_left(seed):
    rng = np.random.default_rng(seed)
    J, r = np.eye(6, 4) + 0.2 * rng.standard_normal((6, 4)), rng.standard_normal(6)
    x, damping = np.array([0.0, 1.0, 0.2, -0.4]), 0.1
    limits = np.array([0.0, 0.8, 0.0, -0.5]), np.array([0.3, 1.0, 0.3, -0.3])
    step = _step(SimpleNamespace(limits=limits), x, J.T @ J, J.T @ r, damping)
    low, high = limits[0] - x, limits[1] - x
    assert (step >= low).all()
    assert (step <= high).all()
    held = (step == low) | (step == high)
    root = np.diag(np.sqrt(damping * np.sum(J**2, axis=0)))
    rows, right = np.vstack([J, root]), np.concatenate([-r, np.zeros(4)])
    alone = np.linalg.lstsq(rows[:, ~held], right - rows[:, held] @ step[held])[0]
    np.testing.assert_allclose(step[~held], alone, atol=1e-12)
    # as far as the gradient leads there at once, those on a bound are
    out = ((x == limits[0]) & (J.T @ r > 0)) | ((x == limits[1]) & (J.T @ r < 0))
    assert held[out].all()
