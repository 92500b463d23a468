"""Lost samples against the truth, and against a general least-squares solver."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from truths import closed_roll, uh60
from truths.systems import innovation_record

from casid import Record
from casid.autoregression import autoregression, filled, outliers

NOISE = {"ay": 0.05, "p": 0.004, "phi": 0.01}  # m/s^2, rad/s, rad


def lose(record, *rows):
    y = record.y.copy()
    for row in rows:
        y[row] = np.nan
    return replace(record, y=y)


def test_a_noise_free_flight_is_filled_in_over_half_a_second():
    record = uh60.linear_sweep("lat")
    whole, lost = filled(lose(record, slice(1000, 1025), slice(2000, 2001)))
    assert lost.sum() == 26 * record.ny
    np.testing.assert_array_equal(whole.y[~lost], record.y[~lost])
    # Ten lags do not hold 32 states: a hundredth of each channel's deviation.
    assert np.all(np.abs(whole.y - record.y).max(axis=0) < 0.01 * record.y.std(axis=0))


def test_filled_samples_minimise_the_weighed_innovations():
    _, _, record, _ = innovation_record(N=300)
    holed = lose(record, (slice(100, 104), 0), (slice(102, 105), 1), (slice(200, 202), 1))
    whole, lost = filled(holed)
    model = autoregression(record.take(slice(None)), whole.y, np.ones(record.N, dtype=bool))
    # The model that filled them was fitted before: a step of its own from where it ended.
    W = np.linalg.inv(np.linalg.cholesky(model.R))

    def innovations(values):
        y = record.y.copy()
        y[lost] = values
        return (model.innovations(record.u, y) @ W.T).ravel()

    best = scipy.optimize.least_squares(innovations, whole.y[lost], x_scale=0.1)
    np.testing.assert_allclose(whole.y[lost], best.x, atol=0.05 * record.y.std())


def test_innovations_of_an_autoregression_are_those_it_was_made_of():
    rng = np.random.default_rng(3)
    N, e = 20_000, 0.1 * rng.standard_normal((20_000, 1))
    u, y = rng.standard_normal((N, 1)), np.zeros((N, 1))
    for k in range(2, N):
        y[k] = 1.2 * y[k - 1] - 0.5 * y[k - 2] + 0.3 * u[k] + 0.7 * u[k - 1] + 0.2 + e[k]
    record = Record(np.arange(N, dtype=float), u, y, ("u",), ("y",))
    model = autoregression(record, y, np.ones(N, dtype=bool))
    p = len(model.A)
    # Errors of B_0 and B_1 scatter by about σ_e/(σ_u √N); several lags of y share theirs.
    np.testing.assert_allclose(model.A[:2, 0, 0], [1.2, -0.5], atol=0.05)
    np.testing.assert_allclose(model.B[:2, 0, 0], [0.3, 0.7], atol=5 * 0.1 / np.sqrt(N))
    np.testing.assert_allclose(model.innovations(u, y), e[p:], atol=0.02)
    assert model.R[0, 0] == pytest.approx(0.01, rel=0.05)


def test_what_is_not_lost_stays_and_a_channel_without_samples_stays_lost():
    record = uh60.linear_sweep("ped", duration=20.0)
    assert filled(record)[0] is record
    holed = lose(record, (slice(None), 3), (slice(50, 55), 4))
    whole, lost = filled(holed)
    assert np.isnan(whole.y[:, 3]).all()
    assert lost[:, 3].all()
    assert np.isfinite(np.delete(whole.y, 3, axis=1)).all()


def half_rate(seed, every):
    """A flight of 40 s with white noise, its bank angle measured at every so many samples only."""
    rng = np.random.default_rng(seed)
    record = closed_roll.flown(t=0.02 * np.arange(2000), seed=seed).with_noise(NOISE, rng)
    y = record.y.copy()
    y[np.arange(len(y)) % every != 0, 2] = np.nan
    return replace(record, y=y)


@pytest.mark.parametrize(("seed", "every"), [(11, 2), (12, 2), (13, 3), (14, 5)])
def test_empty_cells_of_a_slower_channel_make_no_outliers(seed, every):
    record = half_rate(seed, every)
    assert not outliers(record).any()
    y = record.y.copy()
    wrong = [(401, 0), (901, 1), (100 * every, 2)]
    for row, i in wrong:
        y[row, i] += 40 * NOISE[record.outputs[i]]
    assert list(zip(*np.nonzero(outliers(replace(record, y=y))), strict=True)) == sorted(wrong)
