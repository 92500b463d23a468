"""Outliers in flights of known answer: those put in, and no others."""

from dataclasses import replace

import numpy as np
import pytest
from truths import closed_roll, uh60

from casid import Record, outliers, read_csv
from casid.outlier_detection import _between, _no_value

NOISE = {"ay": 0.05, "p": 0.004, "phi": 0.01}  # m/s^2, rad/s, rad


def half_rate(seed, every):
    """A flight of 40 s with white noise, its bank angle measured at every so many samples only."""
    rng = np.random.default_rng(seed)
    record = closed_roll.flown(t=0.02 * np.arange(2000), seed=seed).with_noise(NOISE, rng)
    y = record.y.copy()
    y[np.arange(len(y)) % every != 0, 2] = np.nan
    return replace(record, y=y)


@pytest.mark.second
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


@pytest.mark.repeats(1)
@pytest.mark.parametrize("spoil", [at_random, at_rates, in_rows])
@pytest.mark.parametrize("name", [FLOWN[1], pytest.param(FLOWN[0], marks=pytest.mark.slow),
                                  pytest.param(FLOWN[2], marks=pytest.mark.slow),
                                  pytest.param(FLOWN[3], marks=pytest.mark.slow)])  # fmt: skip
def test_samples_lost_at_random_make_no_outliers_and_hide_none(name, spoil):
    for seed in range(1 + 2 * (name != FLOWN[1])):
        record, there = spiked(name, seed, spoil)
        assert {(int(k), int(i)) for k, i in np.argwhere(outliers(record))} == there


@pytest.mark.second
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


@pytest.mark.second
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


@pytest.mark.parametrize("first", [0, 450])
@pytest.mark.parametrize("length", [2, 5, 20])
@pytest.mark.parametrize("value", [-9999.0, 99.0])
def test_what_a_recorder_writes_where_it_has_no_value_is_found(value, length, first):
    rng = np.random.default_rng(length)
    record = closed_roll.flown(t=0.02 * np.arange(900), seed=12).with_noise(NOISE, rng)
    y, i = record.y.copy(), record.outputs.index("p")
    y[first : first + length, i] = value
    np.testing.assert_array_equal(outliers(replace(record, y=y)), y != record.y)


@pytest.mark.parametrize(
    ("kind", "length"),
    [("offset", 3), ("offset", 8), ("offset", 20), ("garbage", 3), ("garbage", 8)],
)
@pytest.mark.parametrize("last", [False, True])
def test_a_run_at_an_end_of_the_record_is_found_whole(kind, length, last):
    rng = np.random.default_rng(length + 1)
    record = closed_roll.flown(t=0.02 * np.arange(900), seed=12).with_noise(NOISE, rng)
    spoilt, there = garbled(record, kind, 900 - length if last else 0, length, rng)
    found = outliers(spoilt)
    assert (found & there).sum() >= there.sum() - 1  # one may lie where it is expected
    assert not (found & ~there).any()


def test_one_sample_alone_stands_for_no_value():
    x = np.sin(0.1 * np.arange(300))
    x[[40, 41]] = 99.0
    assert np.flatnonzero(_no_value(x)).tolist() == [40, 41]
    x[41] = 98.0
    assert not _no_value(x).any()


@pytest.mark.parametrize("at", [418, 462])
def test_a_run_that_begins_or_ends_as_a_stick_jumps_is_found_whole(at):
    rng = np.random.default_rng(3)
    record = closed_roll.flown(t=0.02 * np.arange(900), seed=12).with_noise(NOISE, rng)
    spoilt, there = garbled(record, "offset", 420, 40, rng)
    u = np.column_stack([record.u, np.arange(900) >= at])
    found = outliers(replace(spoilt, u=u, inputs=(*record.inputs, "col")))
    np.testing.assert_array_equal(found, there)


def test_what_jumps_all_the_time_as_a_switch_does_has_no_runs():
    # Its whole record would be expected anew, and how surely: as many numbers, squared.
    switch = np.cumsum(np.random.default_rng(4).random(3000) < 0.03) % 2.0
    never = np.zeros(3000, dtype=bool)
    assert not _between(switch, never).any()
    once = np.sin(0.01 * np.arange(3000)) + 5 * (abs(np.arange(3000) - 700) < 30)
    assert _between(once, never).sum() == 59


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


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(("share", "lost"), [(0.03, 0.0), (0.05, 0.3), (0.1, 0.0)])
def test_outliers_are_found_however_many_there_are(share, lost):
    for seed in range(3):
        rng = np.random.default_rng([seed, 78])
        record = closed_roll.flown(t=0.02 * np.arange(2000), seed=seed).with_noise(NOISE, rng)
        there = rng.random(record.y.shape) < share
        noise = [NOISE[name] for name in record.outputs]
        y = record.y + 40 * there * noise * rng.choice([-1, 1], record.y.shape)
        spoiled = replace(record, y=y).mask(rng.random(y.shape) < lost)
        found, there = outliers(spoiled), there & np.isfinite(spoiled.y)
        assert (found & there).sum() > 0.99 * there.sum()
        assert (found & ~there).sum() <= 2


def test_a_stick_that_only_jitters_hides_no_run_of_bad_samples():
    rng = np.random.default_rng(21)
    record = closed_roll.flown(t=0.02 * np.arange(900), seed=12).with_noise(NOISE, rng)
    resting = 0.5 + 0.0003 * rng.standard_normal((900, 1))
    u = np.hstack([record.u, resting])
    spoilt, there = garbled(record, "garbage", 420, 20, rng)
    found = outliers(replace(spoilt, u=u, inputs=(*record.inputs, "col")))
    np.testing.assert_array_equal(found, there)
    y = record.y.copy()
    y[[200, 330, 500]] = 0.0  # all channels at once
    together = outliers(replace(record, y=y + 1.0, u=u, inputs=(*record.inputs, "col")))
    off = np.abs(y - record.y) > 20 * np.array([NOISE[name] for name in record.outputs])
    assert together[off].all()


@pytest.mark.parametrize("delay", [3, 6, 10])
def test_what_answers_a_step_of_a_stick_late_is_no_outlier(delay):
    # A force that follows at once, but for a delay that lags of a short record do not reach.
    rng = np.random.default_rng(delay)
    k = np.arange(450)
    col = np.where((k > 100) & (k < 400), (-1.0) ** (k // 30), 0.0)
    late = np.roll(col, delay)
    w, heave = 0.0, []
    for now in late:
        heave.append(-0.6 * w - 10 * now)
        w += 0.02 * heave[-1]
    others = rng.standard_normal((450, 3)) * 0.01
    y = np.column_stack([heave, *others.T]) + 0.05 * rng.standard_normal((450, 4))
    u = np.column_stack([col, 0.01 * others[:, :2]])
    record = Record(0.02 * k, u, y, ("col", "lat", "lon"), ("az", "p", "q", "r"))
    assert not outliers(record).any()
    y[201, 0] += 30.0  # between the answers
    assert np.argwhere(outliers(replace(record, y=y))).tolist() == [[201, 0]]
