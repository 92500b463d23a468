"""Lost samples against the truth, and against a general least-squares solver."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from truths import closed_roll, uh60
from truths.systems import innovation_record

from casid import Record, read_csv
from casid.autoregression import (
    Autoregression,
    _apart,
    autoregression,
    filled,
    outliers,
)

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


FLOWN = [f"3211_{axis}" for axis in uh60.INPUTS]


def spiked(name, seed, spoil):
    """A flight of the UH-60 with noise and five outliers of 20 deviations, and where they are."""
    columns = {"inputs": uh60.INPUTS, "outputs": uh60.OUTPUTS}
    record = read_csv(uh60.EXAMPLE / "data" / f"{name}.csv", **columns)
    rng = np.random.default_rng([seed, 77])
    record = spoil(record.with_noise(uh60.NOISE, rng), rng)
    seen = np.argwhere(np.isfinite(record.y))
    places = seen[rng.choice(len(seen), 5, replace=False)]
    y = record.y.copy()
    for k, i in places:
        y[k, i] += 20 * uh60.NOISE[record.outputs[i]] * rng.choice([-1, 1])
    return replace(record, y=y), {(int(k), int(i)) for k, i in places}


def at_random(record, rng):
    return record.mask(rng.random(record.y.shape) < 0.2)


def at_rates(record, rng):
    """Channels at all, every second or every fourth sample, a tenth of these lost."""
    every = rng.choice([1, 2, 4], record.ny)
    k = np.arange(record.N)[:, None] + rng.integers(4, size=record.ny)
    return record.mask((k % every != 0) | (rng.random(record.y.shape) < 0.1))


def in_rows(record, rng):
    """Rows lost, and three seconds of them."""
    return record.take((rng.random(record.N) > 0.1) & (np.abs(record.t - 8) > 1.5))


@pytest.mark.parametrize("spoil", [at_random, at_rates, in_rows])
@pytest.mark.parametrize("name", [FLOWN[1], pytest.param(FLOWN[0], marks=pytest.mark.slow),
                                  pytest.param(FLOWN[2], marks=pytest.mark.slow),
                                  pytest.param(FLOWN[3], marks=pytest.mark.slow)])  # fmt: skip
def test_samples_lost_at_random_make_no_outliers_and_hide_none(name, spoil):
    for seed in range(1 + 2 * (name != FLOWN[1])):
        record, there = spiked(name, seed, spoil)
        assert {(int(k), int(i)) for k, i in np.argwhere(outliers(record))} == there


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_the_edges_of_a_gap_in_which_inputs_moved_are_no_outliers(seed):
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(1500)
    record = closed_roll.flown(t=t, seed=seed).with_noise(NOISE, rng)
    record = record.take((np.abs(t - 8.0) > 0.5) & (np.abs(t - 19.0) > 0.8))
    assert not outliers(record).any()
    y = record.y.copy()
    wrong = [(200, 1), (700, 0), (record.N - 40, 2)]
    for row, i in wrong:
        y[row, i] += 40 * NOISE[record.outputs[i]]
    assert list(zip(*np.nonzero(outliers(replace(record, y=y))), strict=True)) == sorted(wrong)


@pytest.mark.parametrize("seed", [21, 22, 23, 24])
def test_outliers_right_after_a_gap_are_judged_by_what_follows(seed):
    rng = np.random.default_rng(seed)
    record = closed_roll.flown(t=0.02 * np.arange(1000), seed=seed).with_noise(NOISE, rng)
    a = 300 + 20 * (seed - 21)
    record = record.take((np.arange(1000) < a) | (np.arange(1000) >= a + 50))
    for after in (-1, 0, 1, 5):
        y = record.y.copy()
        y[a + after, 1] += 40 * NOISE["p"]
        assert np.argwhere(outliers(replace(record, y=y))).tolist() == [[a + after, 1]]


@pytest.mark.parametrize("seed", [14, 15, 16])
def test_a_gap_beside_an_output_that_feedback_tells_exactly_is_no_singular_matrix(seed):
    # An axis that nobody flies: its input is its rate times a gain, whose innovations are none.
    rng = np.random.default_rng(seed)
    e = rng.standard_normal((300, 3)) * [0.01, 0.01, 0.005]
    y, u, p, r, phi = np.zeros((300, 3)), np.zeros((300, 2)), 0.0, 0.0, 0.0
    for k in range(300):
        y[k] = e[k] + [p, r, phi]
        lat, ped = 0.08 * (k // 30 % 2) - 0.15 * y[k, 0] - 0.5 * y[k, 2], -0.15 * y[k, 1]
        u[k] = lat, ped
        p, r, phi = (
            0.92 * p + 0.6 * lat + 0.04 * ped, 0.98 * r - 0.002 * p + 0.24 * ped - 0.02 * lat,
            phi + 0.02 * p,
        )  # fmt: skip
    t = 0.02 * np.arange(300)
    record = Record(t, u, y, ("lat", "ped"), ("p", "r", "phi"), hold="zoh")
    assert not outliers(record.take((t < 2.99) | (t > 3.99))).any()


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
    off, std = _apart(model, whole, lost, np.arange(N))
    inner = np.arange(2 * N)[known] > 20  # the start is nearly, but not quite, unknown
    wanted = (inverse @ y.ravel()[known]) / np.diag(inverse)
    np.testing.assert_allclose(off.ravel()[known][inner], wanted[inner], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(
        std.ravel()[known][inner], 1 / np.sqrt(np.diag(inverse))[inner], rtol=1e-3
    )
    # In other units of the outputs it is the same.
    large = Autoregression(model.A, model.B, model.c, 1e12 * model.R)
    far = _apart(large, replace(whole, y=1e6 * whole.y), lost, np.arange(N))
    np.testing.assert_allclose(far[0][~lost], 1e6 * off[~lost], rtol=1e-8)
    np.testing.assert_allclose(far[1], 1e6 * std, rtol=1e-8)


@pytest.mark.parametrize("size", [20, 200, 1e5])
@pytest.mark.parametrize("length", [1, 3])
def test_rows_where_all_channels_jump_together_are_found_however_far(size, length):
    rng = np.random.default_rng(5)
    record = closed_roll.flown(t=0.02 * np.arange(900), seed=11).with_noise(NOISE, rng)
    rows = (np.array([[210], [330], [421], [555], [700]]) + np.arange(length)).ravel()
    there = np.zeros(record.y.shape, dtype=bool)
    there[rows] = True
    jumps = size * np.array([NOISE[name] for name in record.outputs])
    np.testing.assert_array_equal(outliers(replace(record, y=record.y + there * jumps)), there)


def garbled(record, kind, first, length, rng):
    """The record with a run of its p far off, and where it is."""
    y, rows = record.y.copy(), slice(first, first + length)
    i, size = record.outputs.index("p"), record.y[:, 1].std()
    off = 10 * size * np.sign(rng.uniform(-1, 1, length)) * rng.uniform(0.5, 1, length)
    y[rows, i] = {
        "garbage": y[rows, i].mean() + off,
        "offset": y[rows, i] + 8 * size,
        "rail": np.full(length, 8 * size),
        "spikes": y[rows, i] + np.where(rng.random(length) < 0.5, off, 0.0),
    }[kind]
    return replace(record, y=y), y != record.y


@pytest.mark.parametrize("kind", ["garbage", "offset", "rail", "spikes"])
@pytest.mark.parametrize("length", [8, 20, 60])
def test_a_run_of_outliers_is_found_whole_and_nothing_beside_it(kind, length):
    rng = np.random.default_rng(length)
    record = closed_roll.flown(t=0.02 * np.arange(900), seed=12).with_noise(NOISE, rng)
    spoilt, there = garbled(record, kind, 420, length, rng)
    np.testing.assert_array_equal(outliers(spoilt), there)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_quick_honest_motion_is_not_taken_for_a_jump(noise):
    # Pulses of two samples, which the outputs follow at once.
    k = np.arange(900)
    u = np.where((k % 150 > 100) & (k % 150 < 103), 1.0, 0.0)[:, None]
    y = np.zeros((900, 2))
    for i in range(1, 900):
        y[i] = [0.5 * y[i - 1, 0] + u[i, 0], 0.9 * y[i - 1, 1] + 0.3 * y[i - 1, 0]]
    y += noise * 0.003 * np.random.default_rng(6).standard_normal(y.shape)
    assert not outliers(Record(0.02 * k, u, y, ("lat",), ("p", "phi"), "pulses")).any()


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("tiny", [1e-160, 1e-305])
def test_channels_next_to_nothing_are_filled_in_without_overflow(tiny):
    _, _, record, _ = innovation_record(N=300)
    gone = lose(record, slice(50, 54))
    small = replace(gone, u=tiny * gone.u, y=np.column_stack([gone.y[:, 0], tiny * gone.y[:, 1]]))
    whole, _ = filled(small)
    assert np.isfinite(whole.y).all()
