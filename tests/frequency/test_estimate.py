"""What is left of an estimate under feedback, and why the rest is not."""

from dataclasses import replace

import numpy as np
import pytest
from truths.systems import TWO, white

from casid import DataWarning, frequency_response
from casid.frequency.estimate import WEAK, Estimate
from casid.frequency.feedback import noise_in_inputs
from casid.frequency.response import FED_BACK, UNDRIVEN

OMEGA = np.array([1.0, 2.0, 3.0])


def estimate(**given):
    """One output after one input at three frequencies, nothing wrong with it but what is given."""
    values = np.ones((3, 1, 1))
    kept = {"feedback": 0 * values, "driven": None} | given
    return Estimate(
        G=values + 0j, coherence=values, random_error=values, leakage=0.3 * values,
        resolution=values, output_correlation=None, input_correlation=None, **kept,
    )  # fmt: skip


def test_a_small_bias_of_feedback_is_stated_and_a_large_one_left_out():
    found, lost = estimate(feedback=np.array([0.0, 0.4, 0.6])[:, None, None]).under_feedback(
        OMEGA, [np.inf]
    )
    np.testing.assert_array_equal(np.isnan(found.G).ravel(), [False, False, True])
    np.testing.assert_allclose(found.leakage.ravel()[:2], [0.3, 0.5])
    np.testing.assert_array_equal(lost[FED_BACK].ravel(), [False, False, True])
    assert UNDRIVEN not in lost


def test_what_is_beyond_the_end_of_an_input_is_left_out():
    found, _ = estimate().under_feedback(OMEGA, [2.0])
    np.testing.assert_array_equal(np.isnan(found.coherence).ravel(), [False, False, True])


def test_what_references_hardly_move_is_left_out_for_that_reason_alone():
    given = {"driven": WEAK * np.array([[2.0], [0.5], [np.nan]])}
    found, lost = estimate(feedback=np.ones((3, 1, 1)) * 0.6, **given).under_feedback(
        OMEGA, [np.inf]
    )
    assert np.isnan(found.G).all()
    np.testing.assert_array_equal(lost[UNDRIVEN].ravel(), [False, True, True])
    np.testing.assert_array_equal(lost[FED_BACK].ravel(), [True, False, False])


@pytest.mark.second
def test_outputs_that_a_record_lacks_keep_averaged_spectra_and_are_told():
    rng, omega = np.random.default_rng(3), np.array([2.0, 4.0])
    records = [white(TWO, rng, noise=0.1, duration=120.0, name=n) for n in "abc"]
    lacking = [*records[:2], replace(records[2], y=records[2].y * [1.0, np.nan])]
    local = frequency_response(records, omega=omega)
    with pytest.warns(DataWarning) as told:
        found = frequency_response(lacking, omega=omega)
    assert sum("record 'c' has no sample of 'y'" in str(each.message) for each in told) == 1
    with pytest.warns(DataWarning):
        windows = frequency_response(lacking, omega=omega, method="windows")
    np.testing.assert_array_equal(found.G[:, 1], windows.G[:, 1])
    np.testing.assert_allclose(found.random_error[:, 0], local.random_error[:, 0], rtol=0.2)
    assert np.all(found.G[:, 0] != windows.G[:, 0])


def test_averaged_spectra_in_place_of_local_models_are_told_where_losses_leave_no_stretch():
    record = white(TWO, np.random.default_rng(2), noise=0.1, duration=200.0)
    noise = noise_in_inputs([record], OMEGA, later=False)
    y = record.y.copy()
    y[2:-2] = np.nan
    with pytest.warns(DataWarning, match="losses leave no stretch for local models"):
        found = estimate().refined([replace(record, y=y)], OMEGA, [0], noise)
    np.testing.assert_array_equal(found.G, estimate().G)


def test_leakage_is_what_tells_an_estimate_from_another_beyond_noise_and_its_own_without_one():
    sure = replace(estimate(), random_error=np.full((3, 1, 1), 1e-6))
    moved = np.array([1.0, 1.0 + 0.2j, np.nan])[:, None, None]
    other = replace(sure, G=moved, leakage=np.zeros((3, 1, 1)))
    found = sure.compared(other).leakage.ravel()
    third = 0.04 / 3  # the mean of three neighbours' squares, of which one differs
    np.testing.assert_allclose(found[1], np.sqrt(third / (1 + third)), rtol=1e-4)
    np.testing.assert_array_equal(found[[0, 2]], 0.3)  # the same, and none
    np.testing.assert_array_equal(sure.compared(sure).leakage, sure.leakage)
