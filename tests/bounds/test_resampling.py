"""Ensembles of linear least squares scatter as their covariance says."""

from dataclasses import replace

import numpy as np
import pytest
from truths.mixture import NOISE, TRUTH, Inline, Mixture, least_squares, record

from casid import Ensemble, Execution, OutputError, bootstrap, monte_carlo, output_error

HERE = Execution(executor=Inline())
RUNS = 40
SPREAD = 4 / np.sqrt(2 * (RUNS - 1))  # four standard deviations of a standard deviation


def expected():
    X, _ = least_squares()
    return np.sqrt(np.diag(np.linalg.inv(X.T @ X))[:3])


@pytest.mark.campaign
def test_monte_carlo_scatters_as_the_cramer_rao_bound_says():
    found = monte_carlo(TRUTH, [record()], noise={"y": NOISE}, runs=RUNS, execution=HERE)
    assert found.names == ("a", "b", "d")
    assert not any(found.reasons)
    np.testing.assert_allclose(found.scatter / expected(), 1, atol=SPREAD)
    assert (np.abs(found.bias) < 4 * expected() / np.sqrt(RUNS)).all()
    assert (found.coverage > 0.95 - 4 * np.sqrt(0.95 * 0.05 / RUNS)).all()
    low, high = found.interval().T
    assert ((low < found.reference) & (found.reference < high)).all()
    assert "coverage" in found.to_markdown()


def test_a_parameter_on_its_bound_in_all_draws_has_no_claim_and_no_warning():
    found = Ensemble(
        names=("a", "b"), reference=np.zeros(2), values=np.array([[1.0, 0.0], [3.0, 0.0]]),
        std_errors=np.array([[0.5, np.nan], [1.5, np.nan]]), reasons=("", ""),
    )  # fmt: skip
    assert "| a | 0 | 2 | 1.414 | 1 |" in found.to_markdown()
    assert "| b | 0 | 0 | 0 | nan | nan |" in found.to_markdown()
    with pytest.raises(ValueError, match="level=95: expected a share between 0 and 1"):
        found.interval(95)


@pytest.mark.campaign
def test_a_bootstrap_of_white_residuals_scatters_as_the_standard_errors():
    fit = output_error(Mixture(), [record()])
    found = bootstrap(fit, [record()], runs=RUNS, block=0.2, execution=HERE)
    np.testing.assert_allclose(found.scatter / expected(), 1, atol=SPREAD)
    np.testing.assert_array_equal(found.reference, fit.model.vector())


@pytest.mark.second
def test_what_the_fit_held_is_held_in_every_draw_and_biases_are_those_of_the_fit():
    held = output_error(Mixture(a=1.0), [record()], fixed=["a"], bounds={"b": (0.3, 0.58)})
    assert held["b"].active
    found = bootstrap(held, [record()], runs=4, block=0.2, execution=HERE)
    assert found.names == ("b", "d")
    assert (found.values[:, 0] <= 0.58).all()
    wider = bootstrap(held, [record()], runs=4, bounds={"b": (0.3, 0.9)}, execution=HERE)
    assert (wider.values[:, 0] > 0.58).any()
    assert bootstrap(held, [record()], runs=2, fixed=["d"], execution=HERE).names == ("b",)
    none = output_error(Mixture(), [record()], biases=False)
    with pytest.raises(ValueError, match=r"no biases .*estimator=OutputError\(biases=False\)"):
        bootstrap(none, [record()], runs=2)
    bare = OutputError(biases=False)
    assert len(bootstrap(none, [record()], runs=2, estimator=bare, execution=HERE).values) == 2


@pytest.mark.second
def test_draws_depend_on_seed_and_run_alone_and_keep_gaps():
    r = record()
    y = r.y.copy()
    y[10:20] = np.nan
    gappy = [type(r)(r.t, r.u, y, r.inputs, r.outputs, r.name)]
    first = monte_carlo(TRUTH, gappy, noise={"y": NOISE}, runs=3)
    more = monte_carlo(TRUTH, gappy, noise={"y": NOISE}, runs=2)
    np.testing.assert_array_equal(first.values[:2], more.values)
    other = monte_carlo(TRUTH, gappy, noise={"y": NOISE}, runs=2, seed=1)
    assert not np.isclose(other.values[0], first.values[0], rtol=1e-6).all()
    assert len(first.to_csv().splitlines()) == 4


def test_only_an_output_error_fit_of_the_records_is_bootstrapped():
    fit = output_error(Mixture(), [record()])
    with pytest.raises(ValueError, match="of 1 record; bootstrap was given 2"):
        bootstrap(fit, [record(), record(1)])
    # the same manoeuvre with other noise, and another one
    for other in (with_noise(record(), 7), record(1)):
        with pytest.raises(ValueError, match="not estimated from these records"):
            bootstrap(fit, other)
    with pytest.raises(ValueError, match="by derivid"):
        bootstrap(replace(fit, method="derivid"), record())


def with_noise(flight, seed):
    return flight.with_noise({"y": NOISE}, np.random.default_rng(seed))


def test_a_bootstrap_takes_records_with_missing_samples_and_a_given_covariance():
    r = record()
    y = r.y.copy()
    y[10:50] = np.nan
    gappy = replace(r, y=y)
    fit = output_error(Mixture(), gappy, R=np.array([[NOISE**2]]))
    assert np.isfinite(bootstrap(fit, gappy, runs=2, execution=HERE).values).all()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"runs": 0}, "runs=0"),
        ({"runs": 1}, "runs=1"),
        ({"block": 0.0}, "block=0.0"),
        ({"block": 6.8}, "6.67 s at most"),
    ],
)
def test_ensembles_of_nothing_are_refused(settings, said):
    fit = output_error(Mixture(), record())
    with pytest.raises(ValueError, match=said):
        bootstrap(fit, record(), **settings)
    with pytest.raises(ValueError, match="runs=1"):
        monte_carlo(TRUTH, record(), noise={"y": NOISE}, runs=1)
    with pytest.raises(ValueError, match="noise names 'zz'; known are y"):
        monte_carlo(TRUTH, record(), noise={"y": NOISE, "zz": 0.01})
    for quiet in ({}, {"y": 0.0}):
        with pytest.raises(ValueError, match="noise lacks y: every output needs a standard dev"):
            monte_carlo(TRUTH, record(), noise=quiet)


def test_scatter_is_the_unbiased_standard_deviation_and_coverage_counts_intervals():
    found = Ensemble(
        names=("a",), reference=np.array([2.0]), values=np.array([[1.0], [2.0], [4.5], [np.nan]]),
        std_errors=np.array([[0.6], [0.1], [1.0], [1.0]]), reasons=("", "", "", "lost"),
    )  # fmt: skip
    assert found.bias == pytest.approx(0.5)
    assert found.scatter == pytest.approx(np.sqrt((1.5**2 + 0.5**2 + 2**2) / 2))
    assert found.coverage == pytest.approx(2 / 3)  # 1 ± 1.18 and 2 ± 0.2, not 4.5 ± 1.96


@pytest.mark.campaign
def test_what_a_prior_tells_scatters_too():
    # A prior that tells nearly all there is of a: its own deviation is what a is known to.
    std = 0.1 * expected()[0]
    by = OutputError(priors={"a": (1.0, std)})
    fit = by.fit(Mixture(), [record()])
    found = bootstrap(fit, [record()], runs=20, block=0.2, estimator=by, execution=HERE)
    assert found.scatter[0] == pytest.approx(std, rel=4 / np.sqrt(2 * 19))
    other = bootstrap(fit, [record()], runs=2, block=0.2, estimator=by, execution=HERE)
    np.testing.assert_array_equal(found.values[:2], other.values)


def test_constants_of_the_equations_are_simulated():
    flights = [record(seed) for seed in (0, 1)]
    drifting = [
        replace(each, y=each.y + k * (1 - np.exp(-each.t))[:, None])  # of the slow lag
        for k, each in enumerate(flights, 1)
    ]
    by = OutputError(state_biases=("slow",), biases=False)
    fit = by.fit(Mixture(), drifting)
    assert (np.abs(fit.state_biases) > 1).all()
    found = bootstrap(fit, drifting, runs=3, estimator=by, execution=HERE)
    assert not any(found.reasons)
    assert (np.abs(found.bias) < 5 * np.sqrt(np.diag(fit.covariance))).all()
    with pytest.raises(ValueError, match="1 state bias, the estimator 0"):
        bootstrap(fit, drifting, runs=3)


def test_estimates_on_a_bound_have_no_interval_to_count():
    found = Ensemble(
        names=("a", "b"), reference=np.array([2.0, 2.0]), values=np.array([[2.0, 2.0], [2.1, 2.0]]),
        std_errors=np.array([[np.nan, np.nan], [0.1, np.nan]]), reasons=("", ""),
    )  # fmt: skip
    np.testing.assert_array_equal(found.coverage, [1.0, np.nan])
