"""The programmes at their start against the structure's own error, and their solutions."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, YAW, HoverRoll, Lag, TwoByTwo

from casid import Model, Rows, Scalar, SolverOptions, parameter
from casid.free import free_parameters
from casid.matching.mismatch import weighted_errors
from casid.matching.programme import START, TIE, Programme
from casid.matching.targets import comparison_of


class Wide(Model):
    """More inputs than outputs."""

    states = ("x",)
    inputs = ("u", "v")
    outputs = ("x",)

    a: Scalar = parameter(default=1.0, lower=0.1, upper=9.0, unit="1/s")
    k: Scalar = parameter(default=2.0, lower=0.0, upper=9.0, unit="-")
    tau: Scalar = parameter(default=0.1, lower=0.0, upper=1.0, unit="s")

    def A(self) -> Rows:
        return [[-self.a]]

    def B(self) -> Rows:
        return [[self.k, self.a * self.k]]

    def delays(self):
        return {"v": self.tau}


MODEL = HoverRoll(Yv=-0.3, Lv=-0.2, Lp=-2.0, Llat=9.0, tau=0.03)
COMPARISON = comparison_of(MODEL, [TRUTH.system()], weight=np.array([[1.0], [0.5]]))
ERROR = COMPARISON.error(MODEL.system())


def test_programmes_start_feasible_with_the_cost_of_their_start():
    mean = np.linalg.norm(ERROR) ** 2 / len(ERROR)
    largest = np.linalg.norm(ERROR, 2, axis=(1, 2)).max() ** 2
    model = MODEL.system().response(COMPARISON.s.imag, COMPARISON.shift)
    decibels = np.sum(weighted_errors(model, COMPARISON.G, COMPARISON.decibel_weight) ** 2)
    expected = {"quadratic": mean, "hinf": START * largest + TIE * mean, "decibel": decibels}
    free = free_parameters(MODEL)
    for norm, cost in expected.items():
        programme = Programme(free, COMPARISON, norm, free.guess)
        p = programme.problem()
        f, g = ca.Function("start", [p.x], [p.f, p.g])(p.x0)
        assert float(f) * programme.unit**2 == pytest.approx(cost, rel=1e-9)
        assert np.abs(g.full()).max(initial=0.0) < 1e-9
        np.testing.assert_allclose(programme.parameters(p.x0), MODEL.vector(), rtol=1e-12)


def central(function, x):
    """Derivatives by central differences, a column a variable."""
    steps = 1e-6 * np.eye(len(x))
    return np.array([(function(x + h) - function(x - h)) / 2e-6 for h in steps]).T


CASES = {"tall": (MODEL, COMPARISON), "square": (TwoByTwo(),
                                                comparison_of(TwoByTwo(), [YAW.system()])),
         "wide": (Wide(), comparison_of(Wide(), [Wide(a=1.3).system()]))}  # fmt: skip


@pytest.mark.parametrize("norm", ["quadratic", "hinf", "decibel"])
@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_differences(case, norm):
    model, comparison = CASES[case]
    few = comparison.sources[0].at(np.array([0.4, 1.0, 3.0]))
    free = replace(free_parameters(model), priors={model.parameter_names()[0]: (0.3, 0.2)})
    comparison = replace(comparison, sources=(few,))
    programme = Programme(free, comparison, norm, free.guess * 1.1, stable=True)
    rng = np.random.default_rng(5)
    p = programme.problem()
    x = p.x0 + 0.02 * rng.standard_normal(len(p.x0))
    mu = rng.standard_normal(len(p.lower_g))

    def jacobian(x):
        return p.functions["nlp_jac_g"](x, [])[1].full()

    def slope(x):
        return 0.7 * programme.gradient(x) + jacobian(x).T @ mu

    near = {"rtol": 1e-6, "atol": 1e-6}
    np.testing.assert_allclose(programme.gradient(x), central(programme.cost, x), **near)
    np.testing.assert_allclose(jacobian(x), central(programme.constraints, x), **near)
    H = p.hessian(x, [], 0.7, mu).full()
    np.testing.assert_allclose(H, np.triu(central(slope, x)), **near)


def test_trial_points_with_poles_right_of_the_line_have_no_value():
    free = free_parameters(MODEL)
    rightmost = MODEL.system().poles().real.max()
    programme = Programme(free, COMPARISON, "hinf", free.guess, line=rightmost + 0.05)
    x = programme.problem().x0
    assert np.isfinite(programme.cost(x))
    x[: len(free.index)] = HoverRoll(Yv=0.0, Lv=-1.0, Lp=0.0).vector() / programme.scale
    assert np.isnan(programme.cost(x))


@pytest.mark.parametrize("norm", ["quadratic", "hinf", "decibel"])
def test_every_norm_has_its_minimum_at_the_truth(norm):
    free = free_parameters(MODEL)
    comparison = comparison_of(MODEL, [TRUTH.system()])
    found = Programme(free, comparison, norm, free.guess).solve(SolverOptions(), "truth")
    assert found.success
    np.testing.assert_allclose(found.values, TRUTH.vector(), rtol=1e-3 if norm == "hinf" else 1e-6)


def test_multipliers_are_derivatives_of_the_cost_by_the_bound():
    comparison = comparison_of(Lag(), [SECOND], omega=np.geomspace(0.1, 10.0, 30))

    def optimum(norm, upper):
        free = free_parameters(Lag(), bounds={"a": (0.1, upper)})
        programme = Programme(free, comparison, norm, np.array([upper, 1.0]))
        return programme.solve(SolverOptions(), "price")

    for norm in ("quadratic", "decibel"):
        step = 1e-4
        slope = (optimum(norm, 0.7 + step).cost - optimum(norm, 0.7 - step).cost) / (2 * step)
        assert slope < 0
        assert optimum(norm, 0.7).multipliers[0] == pytest.approx(slope, rel=1e-4)
