"""Residuals on lines: exact for the truth, with the cost's own gradient."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import (
    NAMES,
    TRUTH,
    campaign,
    with_response,
)
from truths.felt import Slight, felt

from casid.free import free_parameters
from casid.shooting.lines import transformed
from casid.shooting.spectral import SpectralResiduals

CLEAN = campaign()


def residuals(records, values, model=TRUTH):
    lines = transformed(records)
    weights = [np.repeat(each.weight[:, None], each.Y.shape[1], 1) for each in lines]
    return SpectralResiduals(free_parameters(model), lines)(values, weights)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("N", [600, 599])
def test_the_truth_leaves_no_residual_on_any_line(hold, N):
    # An unstable model, a delay between samples, a state at the start and biases: all exact.
    record = replace(CLEAN[0].take(slice(0, N)), hold=hold)
    record = with_response(record, TRUTH, np.array([0.3, -0.02, 0.01]), [0.1, 0.2, 0.3])
    (found,) = residuals([record], TRUTH.vector())
    assert np.abs(found.E).max() < 1e-11 * np.abs(transformed([record])[0].Y).max()


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_gradient_is_that_of_the_cost_without_transients(hold):
    records = [replace(record, hold=hold) for record in campaign(0)[:2]]
    lam, gradient = 1.05 * TRUTH.vector(), np.zeros(len(NAMES))
    for i, size in enumerate(np.abs(lam)):
        step = 1e-5 * size * np.eye(len(lam))[i]
        ahead, behind = (sum(r.cost for r in residuals(records, lam + s)) for s in (step, -step))
        gradient[i] = (ahead - behind) / (2 * step[i])
    analytic = sum(each.g for each in residuals(records, lam))
    np.testing.assert_allclose(analytic, gradient, rtol=1e-5)


@pytest.mark.parametrize("start", [1.5, 0.0])
def test_what_is_not_late_is_felt_at_once_also_from_no_direct_term_on(start):
    # Outputs are linear in the direct term: one step from anywhere leads to it.
    record, model = felt(Slight, 0.0), Slight().at({"q": 0.0, "e": 0.0})
    assert model.parameter_names() == ("k", "g", "tau")
    (found,) = residuals([record], np.array([2.0, start, 0.0]), model)
    (left,) = residuals([record], np.array([2.0, 1.5, 0.0]), model)
    assert start - found.g[1] / found.F[1, 1] == pytest.approx(1.5, rel=1e-9)
    assert np.abs(left.E).max() < 1e-11 * np.abs(transformed([record])[0].Y).max()


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_records_of_as_many_lines_but_other_frequencies_share_nothing_wrong(hold):
    records = [replace(CLEAN[0].take(slice(0, N)), hold=hold) for N in (598, 599, 600)]
    assert [len(each.z) for each in transformed(records)] == [299, 299, 300]
    lam = 1.05 * TRUTH.vector()
    for record, found in zip(records, residuals(records, lam), strict=True):
        (alone,) = residuals([record], lam)
        np.testing.assert_allclose(found.E, alone.E, atol=1e-12)
        np.testing.assert_allclose(found.g, alone.g, rtol=1e-9)
