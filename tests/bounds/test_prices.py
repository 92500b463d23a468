"""Shares of the price of bounds, where the cost is quadratic and the prediction is exact."""

from dataclasses import replace

import numpy as np
import pytest
from truths.mixture import NOISE, Inline, Mixture, least_squares, record

from casid import Constraint, Execution, OutputError, compare_bounds
from casid.bounds.cases import read_cases
from casid.bounds.prices import price_case
from casid.jobs.store import Done


class Ruled(Mixture):
    """A sum of gains that the structure itself keeps below what the data want."""

    def constraints(self) -> tuple[Constraint, ...]:
        return (Constraint("sum", self.a + self.b, -np.inf, 1.5),)


def cost(*rows):
    """Least half sum of squares under equations (coefficients of a, b, d; value)."""
    X, y = least_squares()
    n = X.shape[1]
    C = np.array([[*row, *np.zeros(n - 3)] for row, _ in rows])
    system = np.block([[X.T @ X, C.T], [C, np.zeros((len(C), len(C)))]])
    x = np.linalg.solve(system, np.concatenate([X.T @ y, [value for _, value in rows]]))[:n]
    return 0.5 * np.sum((y - X @ x) ** 2)


def test_the_structures_own_constraint_has_its_share_when_a_bound_frees_it():
    known = OutputError(R=NOISE**2 * np.eye(1))  # the cost is quadratic then
    here = Execution(executor=Inline())
    cases = {"free": {}, "low": {"a": "< 0.8"}}
    found = compare_bounds(Ruled(), [record()], cases=cases, estimator=known, execution=here)
    free, low = found.cases
    assert [row.active for row in (*free.fit.constraints, *low.fit.constraints)] == [True, False]
    increase = cost(((1.0, 0.0, 0.0), 0.8)) - cost(((1.0, 1.0, 0.0), 1.5))
    assert low.increase == pytest.approx(increase, rel=1e-6)
    assert set(low.shares) == {"a", "sum"}
    assert sum(low.shares.values()) == pytest.approx(increase, rel=1e-6)
    assert 0.1 < low.shares["sum"] / increase < 0.9


def test_a_fixed_value_has_the_price_of_its_tie_and_no_error():
    known = OutputError(R=NOISE**2 * np.eye(1))
    here = Execution(executor=Inline())
    cases = {"free": {}, "held": {"a": 0.8}}
    found = compare_bounds(Mixture(), [record()], cases=cases, estimator=known, execution=here)
    row = {each.name: each for each in found.cases[1].parameters}["a"]
    assert (row.value, row.lower, row.upper) == (0.8, 0.8, 0.8)
    assert row.active is True
    assert np.isnan(row.std_error)
    costs = [cost(((1.0, 0.0, 0.0), 0.8 + step)) for step in (-1e-3, 1e-3)]
    assert row.multiplier == pytest.approx((costs[1] - costs[0]) / 2e-3, rel=1e-5)


def test_what_two_solves_leave_is_no_gain_of_narrower_bounds():
    known = OutputError(R=NOISE**2 * np.eye(1))
    cases = {"free": {}, "wide": {"a": "< 3"}, "low": {"a": "< 0.8"}}
    of = {"estimator": known, "execution": Execution(executor=Inline())}
    free, wide, low = compare_bounds(Mixture(), [record()], cases=cases, **of).cases
    read = {case.name: case for case in read_cases(Mixture(), cases)}
    for less, expected in ((1e-9, 0.0), (1e-3, -1e-3)):
        fit = replace(wide.fit, cost=free.cost - less * (1 + abs(free.cost)))
        base = read["free"], free.fit
        increase = price_case(read["wide"], Done(result=fit), base, [record()], None).increase
        assert increase == pytest.approx(expected * (1 + abs(free.cost)), rel=1e-6)
    assert low.increase > 1
