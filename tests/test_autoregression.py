"""Lost samples against the truth, and against a general least-squares solver."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal
from truths import closed_roll, uh60
from truths.systems import innovation_record

from casid import Record
from casid.autoregression import Autoregression, apart, autoregression, filled


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
    model = autoregression(record.take(slice(None)), whole.y, np.zeros(record.y.shape, dtype=bool))
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
    model = autoregression(record, y, np.zeros(y.shape, dtype=bool))
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


def test_an_output_is_judged_by_all_others_as_a_general_gaussian_is():
    _, _, record, _ = innovation_record(N=300)
    y = record.y[:60] - record.y[:60].mean(axis=0)
    u = 0 * record.u[:60]
    lost = np.random.default_rng(4).random(y.shape) < 0.2
    model = Autoregression(
        np.array([[[0.5, 0.2], [-0.3, 0.4]], [[0.1, 0.0], [0.2, -0.2]]]),
        np.zeros((3, 2, u.shape[1])), np.zeros(2), np.array([[1.0, 0.3], [0.3, 0.5]]),
    )  # fmt: skip
    # The covariance of all outputs by simulation of unit innovations, from any first two samples.
    N, p = len(y), 2
    L = np.linalg.cholesky(model.R)
    G = np.zeros((N, 2, 2 * N))
    for k in range(N):
        G[k, :, 2 * k : 2 * k + 2] = L if k >= p else 30.0 * np.eye(2)
        if k >= p:
            G[k] += model.A[0] @ G[k - 1] + model.A[1] @ G[k - 2]
    P = (G.reshape(2 * N, -1) @ G.reshape(2 * N, -1).T).reshape(N, 2, N, 2)
    known = ~lost.ravel()
    inverse = np.linalg.inv(P.reshape(2 * N, 2 * N)[np.ix_(known, known)])
    whole = replace(record, t=record.t[:60], u=u, y=np.where(lost, 0.0, y))
    off, std = apart(model, whole, lost, np.arange(N))
    inner = np.arange(2 * N)[known] > 20  # the start is nearly, but not quite, unknown
    wanted = (inverse @ y.ravel()[known]) / np.diag(inverse)
    np.testing.assert_allclose(off.ravel()[known][inner], wanted[inner], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(
        std.ravel()[known][inner], 1 / np.sqrt(np.diag(inverse))[inner], rtol=1e-3
    )
    # In other units of the outputs it is the same.
    large = Autoregression(model.A, model.B, model.c, 1e12 * model.R)
    far = apart(large, replace(whole, y=1e6 * whole.y), lost, np.arange(N))
    np.testing.assert_allclose(far[0][~lost], 1e6 * off[~lost], rtol=1e-8)
    np.testing.assert_allclose(far[1], 1e6 * std, rtol=1e-8)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("tiny", [1e-160, 1e-305])
def test_channels_next_to_nothing_are_filled_in_without_overflow(tiny):
    _, _, record, _ = innovation_record(N=300)
    gone = lose(record, slice(50, 54))
    small = replace(gone, u=tiny * gone.u, y=np.column_stack([gone.y[:, 0], tiny * gone.y[:, 1]]))
    whole, _ = filled(small)
    assert np.isfinite(whole.y).all()


def drifting(rng, N=800, pole=0.92, white=0.5):
    """Two outputs of first-order noise of variance 1 and white noise beside it, and an input."""
    e = np.sqrt(1 - pole**2) * rng.standard_normal((N + 300, 2))
    y = scipy.signal.lfilter([1.0], [1.0, -pole], e, axis=0)[300:]
    t, u = 0.02 * np.arange(N), rng.standard_normal((N, 1))
    return Record(t, u, y + white * rng.standard_normal((N, 2)), ("u",), ("p", "r"))


@pytest.mark.second
@pytest.mark.parametrize("rows", [slice(0, 1), slice(2, 5), slice(0, 25), slice(0, None, 7)])
def test_the_beginning_is_filled_in_as_surely_as_the_rest_tells_of_it(rows):
    n, early = 150, 25
    covariance = scipy.linalg.toeplitz(0.92 ** np.arange(n)) + 0.25 * np.eye(n)
    lost = np.zeros(n, dtype=bool)
    lost[rows] = True
    # A Gaussian given all others has the inverse of its own block of the inverse covariance.
    own = np.linalg.inv(np.linalg.inv(covariance)[np.ix_(lost, lost)])
    std = np.sqrt(np.diag(own))[: lost[:early].sum()]
    off = []
    for seed in range(20):
        record = drifting(np.random.default_rng(seed))
        found = filled(lose(record, rows))[0].y[:early][lost[:early]]
        off.append((found - record.y[:early][lost[:early]]) / std[:, None])
    # 40 values or more: the root of their mean square is known to a ninth.
    assert np.sqrt(np.mean(np.square(off))) < 1.35


@pytest.mark.second
def test_losses_in_step_with_the_inputs_are_filled_in():
    # Its sticks step every 35 samples: what they do at once is in lost rows alone.
    noise = np.array(list(closed_roll.NOISE.values()))

    def off(first, seed):
        record = closed_roll.campaign(seed, count=1)[0]
        rows = slice(first, None, 7)
        return ((filled(lose(record, rows))[0].y - record.y) / noise)[rows]

    seeds = (1, 2, 3)
    size = {k: np.sqrt(np.mean([off(k, seed) ** 2 for seed in seeds])) for k in (0, 3)}
    assert size[0] < 1.5 * size[3]
