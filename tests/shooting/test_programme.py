"""Gradient and Jacobian against finite differences, simulation against the exact one."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, flown, jittered, with_holes

from casid import Constraint
from casid.free import free_parameters
from casid.shooting.innovation import starting_noises
from casid.shooting.intervals import lay_out
from casid.shooting.programme import Programme
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import noise_of, starting_programme
from casid.shooting.unknowns import GainUnknowns

GAIN = np.array([[0.1, 1.0, 0.5], [0.0, 2.0, 0.3], [0.02, 0.1, 1.0]])


class Tied(type(TRUTH)):
    """Roll with a tie and an inequality."""

    def constraints(self):
        return (
            Constraint("tie", self.Ylat - 0.2 * self.Llat),
            Constraint("slow", self.Lp * self.Lp, 0.0, 9.0),
        )


@pytest.mark.second
@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("filtering", ["output error", "gain", "noises"])
@pytest.mark.parametrize("kind", ["given", "diagonal", "full"])
def test_gradient_and_jacobian_agree_with_central_differences(filtering, kind, hold):
    records = [jittered(with_holes(flown(seed=1).between(0, 4))), flown(seed=2).between(0, 3)]
    records = [replace(record, hold=hold) for record in records]
    free = free_parameters(Tied(), fixed=("Lped",))
    R = np.diag([0.1, 0.01, 0.01])
    more = {"output error": None, "gain": GainUnknowns(GAIN, free=True)}.get(filtering)
    if filtering == "noises":
        more = starting_noises(TRUTH, records, R if kind == "given" else kind).raised(100.0)
    evaluator = Evaluator(free, lay_out(records, 1.0), more)
    programme, point = starting_programme(evaluator, free, R, True)
    if kind != "given" and filtering != "noises":
        noise = noise_of(evaluator, None, kind)
        programme = Programme(evaluator, free, programme.scales, noise, True)
    rng = np.random.default_rng(3)
    x = programme.pack(point) + 0.01 * rng.standard_normal(programme.size)
    v, eps = rng.standard_normal(programme.size), 1e-6
    up, down = programme.values(x + eps * v), programme.values(x - eps * v)
    slope = (up.cost - down.cost) / (2 * eps)
    # Rounding 1e-16 of costs of order one over 1e-6, truncation eps² times third derivatives.
    np.testing.assert_allclose(programme.gradient(x) @ v, slope, rtol=1e-6, atol=1e-8)
    difference = (up.g - down.g) / (2 * eps)
    scale = np.abs(difference).max()
    np.testing.assert_allclose(
        programme.constraint_matrix(x) @ v, difference, rtol=1e-6, atol=1e-7 * scale
    )


def test_limits_are_bounds_in_units_of_the_variables_and_sides_of_constraints():
    records = [flown(seed=1).between(0, 3)]
    free = free_parameters(Tied(), fixed=("Lped",), bounds={"Lp": (-3.0, -1.0)})
    evaluator = Evaluator(free, lay_out(records, 1.0))
    programme, _ = starting_programme(evaluator, free, np.diag([0.1, 0.01, 0.01]), True)
    (low, high), sides = programme.limits()
    unit = programme.scales.lam
    np.testing.assert_allclose(low * unit, free.lower[free.index])
    np.testing.assert_allclose(high * unit, free.upper[free.index])
    k = free.names.index("Lp")
    assert (low[k] * unit[k], high[k] * unit[k]) == pytest.approx((-3.0, -1.0))
    np.testing.assert_allclose(sides * programme.ties, [[0.0, 0.0], [0.0, 9.0]])


@pytest.mark.parametrize("filtering", [False, True])
def test_balanced_units_carry_over_what_is_known_at_the_point(filtering):
    records = [flown(seed=1).between(0, 4), flown(seed=2).between(0, 3)]
    free = free_parameters(Tied(), fixed=("Lped",))
    more = GainUnknowns(GAIN, free=True) if filtering else None
    evaluator = Evaluator(free, lay_out(records, 1.0), more)
    R = np.diag([0.1, 0.01, 0.01])
    programme, point = starting_programme(evaluator, free, R, True)
    loose = programme.variant(noise=noise_of(evaluator, None, "diagonal"))
    carried = loose.balanced(point)
    fresh, x = loose.variant(scales=carried.scales), carried.pack(point)
    assert np.abs(carried.scales.lam / loose.scales.lam - 1).max() > 0.1  # other units
    evaluator.simulate = None  # nothing is evaluated again
    carried = carried.gradient(x), carried.jacobian(x), carried.hessian(x), carried.values(x).g
    del evaluator.simulate
    fresh = fresh.gradient(x), fresh.jacobian(x), fresh.hessian(x), fresh.values(x).g
    for one, other in zip(carried, fresh, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())
