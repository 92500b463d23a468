"""Output error against simulated truth, closed forms and an independent estimator."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign, flown, off, relative_error
from truths.swing import Swing, swung

from casid import SolverOptions
from casid.errors import ConvergenceError
from casid.free import free_parameters
from casid.shooting.output_error import output_error, select_records

SIGMA = {"ay": 0.05, "p": 0.005, "phi": 0.005}


def test_unstable_plant_in_closed_loop_is_recovered_from_30_percent_off_delay_included():
    assert TRUTH.system().poles()[0].real > 0.05
    fit = output_error(off(), [flown(seed=1), flown(seed=2)])
    assert fit.success
    assert relative_error(fit).max() < 1e-6
    np.testing.assert_allclose(fit.initial_states, [[0.3, -0.02, 0.01]] * 2, atol=1e-6)
    np.testing.assert_allclose(fit.biases, [[0.1, 0.01, -0.02]] * 2, atol=1e-6)


@pytest.mark.second
@pytest.mark.parametrize("interval", [0.3, 2.0, 100.0])
def test_the_interval_does_not_move_the_estimate(interval):
    records = [flown(seed=1).with_noise(SIGMA, np.random.default_rng(4))]
    reference = output_error(TRUTH, records)
    fit = output_error(TRUTH, records, interval=interval)
    # Same optimum, solver tolerance 1e-8 relative to a curvature of order one.
    std = np.array([row.cramer_rao for row in reference.parameters])
    assert np.abs((fit.model.vector() - reference.model.vector()) / std).max() < 1e-3
    np.testing.assert_allclose(fit.cost, reference.cost, rtol=1e-8)
    np.testing.assert_allclose([row.cramer_rao for row in fit.parameters], std, rtol=1e-4)


def test_noise_covariance_and_parameters_come_out_within_their_scatter():
    sigma = np.array([0.05, 0.005, 0.005])
    noise = dict(zip(TRUTH.outputs, sigma, strict=True))
    rng = np.random.default_rng(5)
    fit = output_error(off(), [flown(seed=s).with_noise(noise, rng) for s in (1, 2, 3)])
    z = [(row.value - getattr(TRUTH, row.name)) / row.std_error for row in fit.parameters]
    assert np.max(np.abs(z)) < 4
    # 1800 samples: a standard deviation scatters by 1/√(2·1800) = 1.7 %.
    np.testing.assert_allclose(np.sqrt(np.diag(fit.R)), sigma, rtol=4 * 0.017)


def test_limits_of_iterations_are_those_of_each_solve():
    told, limit = [], 7
    solver = SolverOptions(max_iterations=limit, progress=told.append)
    record = flown(seed=1).with_noise(SIGMA, np.random.default_rng(4))
    fit = output_error(off(), [record], solver=solver)
    assert max(each.iteration for each in told) <= limit < fit.iterations


def test_an_iteration_limit_is_an_error_that_carries_the_best_fit():
    with pytest.raises(ConvergenceError, match="iteration limit") as caught:
        output_error(off(), [flown(seed=1)], solver=SolverOptions(max_iterations=2))
    assert not caught.value.best.success
    assert np.isfinite(caught.value.best.model.vector()).all()


def test_a_record_has_measurements_for_its_own_state_and_biases():
    free, short = free_parameters(TRUTH), campaign(1)[0].take(slice(0, 2))
    own = len(TRUTH.states)
    needs = {True: own + len(TRUTH.outputs), False: own}
    for biases, needed in needs.items():
        y = np.full((2, 3), np.nan)
        y.flat[: needed - 1] = 0.0
        with pytest.raises(ValueError, match=f"has .* biases alone need {needed}: leave it out"):
            select_records(free, replace(short, y=y), biases)


@pytest.mark.second
def test_a_fit_says_what_shorter_steps_of_integration_would_change():
    told = output_error(Swing(), swung(4, dt=0.1)).notes.integration
    assert told.shift <= 1e-4
    assert output_error(TRUTH, flown().between(0.0, 6.0)).notes.integration is None
