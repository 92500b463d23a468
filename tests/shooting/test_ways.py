"""Ways to a solution: how long intervals are, when they become shorter, which end is told."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, Roll, noisy

from casid import SolverOptions, output_error
from casid.free import free_parameters
from casid.shooting.ways import GAIN, Ways, choose_interval


def ways(model=TRUTH, **more):
    records = [noisy(seed=3)]
    given = {"R": "full", "biases": True, "interval": None, "options": SolverOptions()}
    return Ways(free=free_parameters(model), records=records, **(given | more))


def test_intervals_are_as_long_as_the_fastest_growing_mode_e_folds():
    growth = TRUTH.system().poles()[0].real
    records = [noisy(seed=3)]
    expected = min(1 / growth, 5.0)
    assert choose_interval(free_parameters(TRUTH), records) == pytest.approx(expected)
    fast = replace(TRUTH, Lv=-0.9)
    growth = fast.system().poles()[0].real
    assert choose_interval(free_parameters(fast), records) == pytest.approx(1 / growth)
    calm = replace(TRUTH, Lv=-1e-4, Lp=-15.0)  # e-folds in minutes
    assert choose_interval(free_parameters(calm), records) == 5.0


def test_intervals_become_shorter_as_long_as_a_record_has_several():
    lengths = list(ways()._lengths())
    assert len(lengths) > 1
    np.testing.assert_allclose(np.array(lengths[:-1]) / lengths[1:], 2.5)
    assert lengths[-1] >= 0.5
    assert list(ways(interval=1.5)._lengths()) == [1.5]  # a given one is not changed


def test_where_no_way_ends_the_best_is_told():
    hurried = ways(Roll(Lp=-6.0), options=SolverOptions(max_iterations=2)).output_error()
    assert not hurried.solution.success
    patient = ways(Roll(Lp=-6.0)).output_error()
    assert patient.solution.success
    assert patient.cost <= hurried.cost + 1e-6


def test_the_way_taken_does_not_matter():
    one, other = (output_error(TRUTH, noisy(seed=3), interval=length) for length in (0.7, 3.0))
    apart = (one.model.vector() - other.model.vector()) / [row.std_error for row in one.parameters]
    assert np.abs(apart).max() < 1e-3


def test_a_fit_nearby_is_where_it_begins():
    near = output_error(TRUTH, noisy(seed=3), R="full")
    far, warm = ways(Roll(Lp=-6.0)).output_error(), ways().output_error(near)
    assert warm.cost == pytest.approx(far.cost, rel=1e-9)
    assert warm.iterations < far.iterations / 2


@pytest.mark.slow
def test_a_filter_is_no_less_likely_than_the_output_error_it_begins_with():
    plain, filtered = ways(R="diagonal").output_error(), ways(R="diagonal").filtered(True)
    assert filtered.solution.success
    assert filtered.cost < plain.cost + GAIN


def test_the_likelihood_beside_a_fit_has_initial_states_biases_and_covariance_follow():
    names = [name for name in TRUTH.parameter_names() if name != "Lp"]
    fit = output_error(replace(TRUTH, Llat=9.0), noisy(seed=3), R="full", fixed=names)
    free = free_parameters(fit.model, names)
    poor = replace(fit, R=4 * fit.R, biases=0 * fit.biases)
    assert replace(ways(), free=free).cost_beside(poor) == pytest.approx(fit.cost, abs=1e-3)
    farther = free_parameters(replace(fit.model, Llat=9.5), names)  # nearer to the truth's 10
    assert replace(ways(), free=farther).cost_beside(poor) < fit.cost - 10


def test_the_likelihood_beside_a_fit_of_more_records_is_that_of_its_own():
    fit = output_error(TRUTH, [noisy(seed=3), noisy(seed=4)], R="full")
    names = [name for name in TRUTH.parameter_names() if name != "Lp"]
    narrow = {"Lp": (fit.model.Lp - 1e-9, fit.model.Lp + 1e-9)}
    alone = output_error(fit.model, noisy(seed=3), R="full", fixed=names, bounds=narrow)
    assert ways().cost_beside(fit) == pytest.approx(alone.cost, abs=1e-3)


def test_the_likelihood_beside_what_is_no_output_error_is_not_known():
    fit = output_error(TRUTH, noisy(seed=3))
    assert ways().cost_beside(replace(fit, R=None)) == np.inf
