"""Where the starts end, and what is held against a solver's word."""

from dataclasses import replace

import numpy as np
import pytest
from truths.structures import TRUTH, HoverRoll, Product

from casid import ConvergenceError, DataWarning, FrequencyResponse, SolverOptions, derivid
from casid.baseline import search
from casid.baseline.pairs import select
from casid.free import free_parameters
from casid.matching.descent import Condensed
from casid.matching.programme import Programme

OMEGA = np.geomspace(0.3, 12.0, 20)


def problem():
    G = TRUTH.system().response(OMEGA)
    frf = FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.ones(G.shape), random_error=np.zeros(G.shape),
        inputs=TRUTH.inputs, outputs=TRUTH.outputs, input_std=np.ones(1), output_std=np.ones(2),
    )  # fmt: skip
    return Condensed.of(free_parameters(HoverRoll()), select(HoverRoll(), frf))


def test_starts_are_named_and_reproducible():
    found = search.descents(problem(), 4, seed=1)
    names = [row.start for row, _ in found]
    assert names == ["1 (least squares)", "2 (guess)", "3 (random)", "4 (random)"]
    again = search.descents(problem(), 4, seed=1)
    for (row, values), (other, same) in zip(found, again, strict=True):
        assert row.J == other.J
        np.testing.assert_array_equal(values, same)
    best = min(found, key=lambda pair: pair[0].J)
    np.testing.assert_allclose(best[1], TRUTH.vector(), rtol=1e-5)
    assert best[0].success


def noisy(seed):
    """12/(s + 4) with noise of one per cent."""
    rng, shape = np.random.default_rng(seed), (30, 1, 1)
    omega = np.geomspace(0.5, 15, 30)
    noise = rng.standard_normal(30) + 1j * rng.standard_normal(30)
    G = 12 / (1j * omega + 4) * (1 + 0.01 * noise)
    return FrequencyResponse(
        omega=omega, G=G.reshape(shape), coherence=np.full(shape, 0.98),
        random_error=np.full(shape, 0.01), inputs=("lat",), outputs=("p",),
        input_std=np.ones(1), output_std=np.ones(1),
    )  # fmt: skip


@pytest.mark.second
def test_a_valley_of_models_as_good_is_an_answer():
    for seed in range(10):
        with pytest.warns(DataWarning, match="do not determine k, m one by one"):
            fit = derivid(Product(), noisy(seed), starts=2)
        alone = derivid(Product(k=1.0), noisy(seed), starts=1, fixed={"k"})
        assert fit.cost == pytest.approx(alone.cost, rel=1e-9)
        assert fit.model.k * fit.model.m == pytest.approx(alone.model.m, rel=1e-5)
        assert np.isinf(fit["k"].std_error)
        assert fit.iterations < 20


def test_a_worse_minimum_is_no_answer_where_the_best_is_a_valley(monkeypatch):
    solve = Programme.solve

    def lost(self, options, stage):
        """A solver that fails where the cost is least."""
        found = solve(self, options, stage)
        return replace(found, success=found.cost > 1.0)

    monkeypatch.setattr(Programme, "solve", lost)
    with pytest.raises(ConvergenceError) as caught:  # the guess ends in the worse one
        derivid(Product(), noisy(0), starts=2)
    assert caught.value.best.cost < 1.0


def test_costs_of_pairs_add_up_to_that_of_the_programme():
    task = problem()
    poor = replace(task, free=free_parameters(HoverRoll(), bounds={"Lp": (-1.5, 0.0)}))
    found = search.solve(poor, search.descents(poor, 2, seed=0), SolverOptions())
    assert found.success
    assert search.pair_costs(poor, found.values).sum() == pytest.approx(found.cost, rel=1e-9)
    assert found.cost > 1.0


def test_a_word_of_success_is_held_against_the_model(monkeypatch):
    solve = Programme.solve

    def boast(self, options, stage):
        return replace(solve(self, options, stage), cost=1e-3)

    monkeypatch.setattr(Programme, "solve", boast)
    task = problem()
    poor = replace(task, free=free_parameters(HoverRoll(), bounds={"Lp": (-1.5, 0.0)}))
    found = search.solve(poor, search.descents(poor, 1, seed=0), SolverOptions())
    assert not found.success
    assert "the model's own cost there is" in found.status


def test_a_pair_without_a_response_is_named():
    free = free_parameters(HoverRoll(Llat=0.0), fixed={"Llat"})
    still = Condensed.of(free, problem().comparison)
    found = search.solve(still, search.descents(still, 1, seed=0), SolverOptions())
    assert not found.success
    assert found.status == "p does not respond to lat in the model; leave that pair out"
