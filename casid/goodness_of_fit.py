"""How close a model's output comes to the measured one, in single figures.

R. Jategaonkar, Flight Vehicle System Identification, chapter 11: Theil's coefficient, whiteness.
"""

import numpy as np

from casid.arrays import Array
from casid.samples import autocorrelation, root_mean_square

LAGS = 40  # largest lag of the whiteness test
BAND = 2.5758293035489004  # 99 % band of a white sequence's autocorrelations, in 1/√N


def rms_error(y: Array, y_model: Array) -> float:
    """Root of the mean squared error."""
    return root_mean_square(y - y_model)


def fit_percent(y: Array, y_model: Array) -> float:
    """100 (1 - ‖y - ŷ‖/‖y - mean y‖); NaN for an output that does not move."""
    error, spread = rms_error(y, y_model), root_mean_square(y - y.mean())
    if np.isinf(error):
        return -np.inf
    return 100 * (1 - error / spread) if spread > 0 else np.nan


def theil_coefficient(y: Array, y_model: Array) -> float:
    """RMS error over the sum of both RMS values; NaN for an output that is zero."""
    error, size = rms_error(y, y_model), root_mean_square(y) + root_mean_square(y_model)
    if np.isinf(error):
        return 1.0
    return error / size if size > 0 else np.nan


def whiteness(y: Array, y_model: Array) -> float:
    """Share of a residual's autocorrelations inside the band; NaN of one that rests."""
    if np.isinf(rms_error(y, y_model)):
        return 0.0
    e = y - y_model
    lags = min(LAGS, len(e) // 4)
    if lags < 1 or np.ptp(e) == 0:
        return np.nan
    return float(np.mean(np.abs(autocorrelation(e, lags)[1:]) <= BAND / np.sqrt(len(e))))
