"""Reducing structures that have a parameter too many."""

from dataclasses import replace

import numpy as np
import pytest
from truths.mixture import Inline, Mixture, record
from truths.structures import black_box

from casid import (
    ConvergenceError,
    Derivid,
    Execution,
    FrequencyResponse,
    Match,
    ModelError,
    OutputError,
    ReductionRule,
    SolverOptions,
    StateSpace,
    output_error,
    reduce_structure,
    summary,
)
from casid.bounds.reduction import accuracy_figures

IDLE = Mixture(a=1.0, b=0.6, d=0.0)  # the truth has no direct term
DATA = [record(3, IDLE)]
TARGET = black_box(
    StateSpace([[-2.0]], [[1.0]], [[1.5]], [[0.0]], inputs=("u",), outputs=("y",)), (0.2, 8.0)
)


@pytest.mark.second
def test_a_parameter_the_data_do_not_need_is_dropped_and_no_other():
    found = reduce_structure(Mixture(), DATA)
    assert found.criterion == "aicc"
    assert found.held == {"d": 0.0}
    assert found.full.headline().endswith(", 3 free parameters")
    assert found.fit.headline().endswith(", 3 free parameters, 1 held by constraints")
    assert found.fit["d"].value == pytest.approx(0.0, abs=1e-9)
    for name in ("a", "b"):  # within three standard errors of the truth
        row = found.fit[name]
        assert abs(row.value - getattr(IDLE, name)) < 3 * row.std_error
        assert row.std_error < found.full[name].std_error
    assert "d" in found.to_markdown()
    assert "Reduction(1 of 3 free parameters held by aicc)" in summary(found)
    assert found.to_csv().splitlines()[1].startswith("d,0,")


@pytest.mark.parametrize("value", [0.5, 100.0, -100.0])
def test_figures_are_per_cent_of_a_value_and_without_end_where_that_is_zero(value):
    fit = output_error(Mixture(), DATA)
    row = replace(fit["d"], value=value, std_error=0.2, cramer_rao=0.1, insensitivity=0.3)
    assert accuracy_figures(fit, row) == pytest.approx((30 / abs(value), 40 / abs(value)))
    assert accuracy_figures(fit, replace(row, value=0.0)) == (np.inf, np.inf)


def test_a_step_that_costs_too_much_is_rejected_and_told():
    found = reduce_structure(
        Mixture(), [record(3)], rule=ReductionRule(protect=["d"], criterion="aicc")
    )
    assert all(step.accepted for step in found.steps[:-1])
    assert found.held == {}  # a and b are well determined


@pytest.mark.second
def test_the_cost_may_rise_by_the_share_allowed_only():
    slack = reduce_structure(Mixture(), DATA, rule=ReductionRule(criterion="cost", rise=0.05))
    assert slack.held == {"d": 0.0}
    none = reduce_structure(Mixture(), DATA, rule=ReductionRule(criterion="cost", rise=0.0))
    assert none.held == {}
    assert not none.steps[-1].accepted


@pytest.mark.slow
def test_protected_parameters_stay_and_a_run_can_be_replayed():
    assert reduce_structure(Mixture(), DATA, rule=ReductionRule(protect=["d"])).held == {}
    first = reduce_structure(Mixture(), DATA)
    again = reduce_structure(Mixture(), [record(4, IDLE)], rule=ReductionRule(replay=first.held))
    assert again.held == first.held
    assert again.steps[0].accepted
    script = {"d": 0.01, "a": 1.0}
    assert reduce_structure(Mixture(), DATA, rule=ReductionRule(replay=script)).held == script


@pytest.mark.second
def test_several_candidates_are_tried_at_once_and_the_cheapest_is_held():
    found = reduce_structure(
        Mixture(), DATA, rule=ReductionRule(candidates=3), execution=Execution(executor=Inline())
    )
    assert found.held == {"d": 0.0}


@pytest.mark.second
def test_what_cannot_be_reduced_is_refused():
    with pytest.raises(ModelError, match="no standard errors"):
        reduce_structure(Mixture(), TARGET, estimator=Match(norm="quadratic"))
    with pytest.raises(ModelError, match="criterion='guess'"):
        ReductionRule(criterion="guess")
    for wrong in ({"rise": -0.5}, {"candidates": 0}):
        with pytest.raises(ModelError, match=f"{next(iter(wrong))}=.*: expected"):
            ReductionRule(**wrong)
    with pytest.raises(ModelError, match=r"d is to be held again .* never to be held"):
        ReductionRule(replay={"d": 0.0}, protect=["d"])
    with pytest.raises(ModelError, match="no parameter 'z'"):
        reduce_structure(Mixture(), DATA, rule=ReductionRule(protect=["z"]))
    few = SolverOptions(max_iterations=1)
    with pytest.raises(ConvergenceError, match="nothing held"):
        reduce_structure(Mixture(), DATA, estimator=OutputError(solver=few))


def test_a_frequency_domain_fit_is_reduced_by_its_cost():
    omega = np.geomspace(0.2, 8.0, 25)
    rng = np.random.default_rng(0)
    G = IDLE.system().response(omega)
    G = G * np.exp(0.02 * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)))
    measured = FrequencyResponse(
        omega=omega, G=G, coherence=np.ones(G.shape), random_error=np.full(G.shape, 0.02),
        inputs=("u",), outputs=("y",), input_std=np.ones(1), output_std=np.ones(1),
    )  # fmt: skip
    found = reduce_structure(
        Mixture(), measured, estimator=Derivid(starts=2), rule=ReductionRule(rise=0.2)
    )
    assert found.criterion == "cost"
    assert found.held == {"d": 0.0}
    assert found.fit.cost <= 1.2 * found.full.cost
    assert np.isnan(found.steps[0].aicc)
