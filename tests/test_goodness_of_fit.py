"""Single figures of how close a model comes, against their formulas."""

import numpy as np
import pytest
import scipy

from casid.goodness_of_fit import fit_percent, rms_error, theil_coefficient, whiteness


@pytest.mark.parametrize("lost", [np.nan, np.inf, 1e200])
def test_one_number_lost_after_the_first_prediction_is_an_infinite_error(lost):
    y, s = np.array([1.0, -1.0, 2.0, 0.0, -2.0, 1.0]), np.array([1.0, -1.0, 2.0, lost, -2.0, 1.0])
    assert (rms_error(y, s), fit_percent(y, s), theil_coefficient(y, s)) == (np.inf, -np.inf, 1.0)
    assert whiteness(y, s) == 0


@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_whiteness_is_the_share_of_autocorrelations_within_the_99_percent_band(offset):
    rng = np.random.default_rng(4)
    e = scipy.signal.lfilter([1.0, 0.45, 0.3], [1.0], rng.standard_normal(500))
    centred = e - e.mean()
    full = scipy.signal.correlate(centred, centred)[499:]
    rho = np.abs(full[1:41] / full[0])
    within = {
        p: np.mean(rho <= scipy.stats.norm.ppf(1 - p / 2) / np.sqrt(500)) for p in (0.05, 0.01)
    }
    assert within[0.05] < within[0.01] < 1
    assert whiteness(e + offset, np.zeros(500)) == pytest.approx(within[0.01])


def test_whiteness_needs_four_samples_that_differ():
    assert whiteness(np.array([1.0, -1.0, 1.0, -1.0]), np.zeros(4)) == 1  # 0.75 < 2.58/2
    assert np.isnan(whiteness(np.array([1.0, -1.0, 1.0]), np.zeros(3)))
    assert np.isnan(whiteness(np.ones(50), np.zeros(50)))
