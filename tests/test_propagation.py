"""Errors carried on: what bounds leave open, and what is drawn."""

import numpy as np
import pytest
from truths.closed_roll import Roll as ClosedRoll
from truths.closed_roll import noisy

from casid import output_error, response_band, sample_models
from casid.propagation import spread


@pytest.fixture(scope="module", params=["time", "frequency"])
def domain(request):
    return request.param


@pytest.fixture(scope="module")
def free(domain):
    return output_error(ClosedRoll(), noisy(seed=5), domain=domain)


@pytest.fixture(scope="module")
def fit(free, domain):
    """With a parameter on a bound half a standard error within what is likeliest."""
    lower = free["Lp"].value + 0.5 * free["Lp"].std_error
    return output_error(ClosedRoll(), noisy(seed=5), bounds={"Lp": (lower, 0.0)}, domain=domain)


@pytest.mark.second
def test_what_is_on_a_bound_moves_inward_with_others(fit):
    assert fit["Lp"].active
    k = fit.free_names.index("Lp")
    open_ = np.sqrt(fit.covariance[k, k])
    assert spread(fit, lambda model: np.array(float(model.Lp))) == pytest.approx(open_)
    drawn = np.array([model.vector() for model in sample_models(fit, 4000)])
    away = drawn - fit.model.vector()
    assert (away[:, k] >= 0).all()
    unit = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(
        away.T @ away / len(away) / np.outer(unit, unit),
        fit.covariance / np.outer(unit, unit), atol=0.06,
    )  # fmt: skip


@pytest.mark.second
def test_what_a_bound_leaves_open_is_what_is_known_without_it_but_for_one_side(fit, free):
    # N(-1/2, 1) above 0 has E d² = 0.68; what the other parameters err by with it follows it.
    k, C, P = fit.free_names.index("Lp"), fit.covariance, free.covariance
    assert C[k, k] / P[k, k] == pytest.approx(0.680, abs=0.08)  # colour is shared
    others = [i for i in range(len(P)) if i != k]
    held = P - np.outer(P[k], P[k]) / P[k, k]
    np.testing.assert_allclose(
        np.sqrt(np.diag(C)[others]),
        np.sqrt(np.diag(held + 0.680 * np.outer(P[k], P[k]) / P[k, k])[others]), rtol=0.05,
    )  # fmt: skip
    assert np.isnan(fit["Lp"].std_error)
    assert fit["Llat"].std_error > np.sqrt(held[4, 4])


@pytest.mark.second
def test_a_hypothesis_against_the_data_leaves_nothing_open():
    far = output_error(ClosedRoll(), noisy(seed=5), bounds={"Lp": (-1.8, 0.0)})
    fixed = output_error(ClosedRoll(Lp=-1.8), noisy(seed=5), fixed=["Lp"])
    for row in fixed.parameters:
        if row.name != "Lp":
            assert far[row.name].std_error == pytest.approx(row.std_error, rel=0.05)


def test_bands_hold_that_a_bound_is_no_value(fit, free):
    omega = np.array([0.3, 1.0, 3.0])
    own, without = (response_band(each, omega).magnitude_std for each in (fit, free))
    np.testing.assert_allclose(own, without, rtol=0.25)


def test_known_to_be_on_the_bound_the_errors_are_those_of_it_held(fit, domain):
    lower = fit["Lp"].value
    held = output_error(ClosedRoll(Lp=lower), noisy(seed=5), fixed=["Lp"], domain=domain)
    known = fit.notes.on_bounds(fit.covariance)
    k = fit.free_names.index("Lp")
    np.testing.assert_allclose(known[k], 0.0, atol=1e-12)
    std = np.sqrt(np.diag(known))
    for name in held.free_names:
        assert std[fit.free_names.index(name)] == pytest.approx(held[name].std_error, rel=0.03)
