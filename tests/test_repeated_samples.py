from dataclasses import replace

import numpy as np
import pytest

from casid import Record, repeated, without_repeats
from casid.repeated_samples import source_interval

T = 0.01 * np.arange(2000)
rng = np.random.default_rng(4)
WAVE = np.cumsum(rng.standard_normal(len(T)))


def record(u, y, **more):
    return Record(T, u[:, None], y[:, None], ("lat",), ("p",), "flight", **more)


def held(x, every):
    """What a logger reads of a source that is ``every`` times slower."""
    return np.repeat(x[::every], every)[: len(x)]


@pytest.mark.parametrize("every", [2, 5, 20])
def test_samples_of_a_slower_source_are_found_with_its_interval(every):
    flown = record(WAVE, held(WAVE, every))
    marks = repeated(flown)
    assert not marks[:, 0].any()
    np.testing.assert_array_equal(marks[:, 1], np.arange(len(T)) % every > 0)
    assert source_interval(flown, marks, 1) == pytest.approx(0.01 * every)


def test_samples_repeated_now_and_then_are_found():
    x = WAVE.copy()
    again = np.sort(rng.choice(np.arange(2, len(T), 2), 200, replace=False))
    x[again] = x[again - 1]
    np.testing.assert_array_equal(np.flatnonzero(repeated(record(x, WAVE))[:, 0]), again)


def test_rest_steps_and_chance_are_no_repetition():
    resting = np.where((T > 3) & (T < 12), WAVE, WAVE[300])
    steps = np.round(WAVE)  # of a converter, where slow motion repeats a count
    fine = np.round(WAVE, 1)  # digits of a file
    rare = WAVE.copy()
    rare[500] = rare[499]
    for x in (resting, steps, fine, rare, np.sign(np.sin(T)), np.zeros(len(T))):
        assert not repeated(record(x, x)).any()


def test_the_last_digit_of_a_channel_at_rest_is_no_slower_source():
    trim = np.cumsum(np.arange(len(T)) % 5 > 2) * 1e-4  # drifts by a digit two samples of five
    quiet = np.where(T < 5, trim, trim[500] + WAVE - WAVE[500])
    assert not repeated(record(quiet, WAVE)).any()
    slower = np.where(T < 5, trim, held(quiet, 2))
    np.testing.assert_array_equal(repeated(record(slower, WAVE))[510:, 0], np.arange(510, 2000) % 2)


def test_roundings_are_no_steps():
    digits = np.round(WAVE - WAVE.mean(), 1)  # of a file, where chance repeats some
    again = np.flatnonzero(np.diff(digits) == 0)[3]
    digits -= digits[again]
    digits[again] = 3e-18
    assert not repeated(record(digits, WAVE))[:, 0].any()


def test_missing_samples_lie_between_own_ones():
    x = held(WAVE, 4)
    x[2::4] = np.nan
    marks = repeated(record(WAVE, x))[:, 1]
    np.testing.assert_array_equal(marks, np.isin(np.arange(len(T)) % 4, (1, 3)))


def test_repeated_outputs_become_missing_and_inputs_are_read_by_their_hold():
    flown = record(held(WAVE, 2), held(WAVE, 4))
    lines = without_repeats(flown)
    own = np.arange(0, len(T), 2)
    np.testing.assert_allclose(lines.u[:, 0], np.interp(lines.t, T[own], WAVE[own]), atol=1e-9)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(lines.y[:, 0])) % 4, 0)
    steps = without_repeats(replace(flown, hold="zoh"))
    np.testing.assert_array_equal(steps.u[:, 0], flown.u[: steps.N, 0])
    whole = record(WAVE, WAVE)
    assert without_repeats(whole) is whole


def test_blanks_between_the_samples_of_a_noisy_slow_channel_are_no_repeats():
    # 10 Hz in a log of 50 Hz, rounded to hundredths of a knot: two alike in a row are chance.
    t, step = 0.02 * np.arange(651), 0.01 * 1852 / 3600
    for seed in range(40):
        rng = np.random.default_rng(seed)
        v = 0.3 * np.sin(0.8 * t) * (t > 2) + 0.08 * rng.standard_normal(len(t))
        v = np.where(np.arange(len(t)) % 5, np.nan, np.round(v / step) * step)
        flown = Record(t, np.sin(t)[:, None], v[:, None], ("lat",), ("v",), "blanks")
        assert not repeated(flown).any()


def test_the_interval_of_a_source_counts_its_own_samples_alone():
    t = 0.02 * np.arange(600)
    slow = np.repeat(np.cumsum(np.random.default_rng(1).standard_normal(60)), 2)  # 5 Hz at 10 Hz
    v = np.full(600, np.nan)
    v[::5] = slow
    flown = Record(t, np.sin(t)[:, None], v[:, None], ("lat",), ("v",), "blanks")
    assert source_interval(flown, repeated(flown), 1) == pytest.approx(0.2)


def test_one_absurd_value_makes_no_repeats_of_small_steps():
    x = WAVE.copy()
    x[777] = 1e15
    assert not repeated(record(WAVE, x)).any()
    x = held(WAVE, 5)
    x[777] = 1e15
    assert repeated(record(WAVE, x))[:, 1].mean() == pytest.approx(0.8, abs=0.01)


NOISE = np.random.default_rng(8).standard_normal(len(T))


@pytest.mark.parametrize("count", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("every", [2, 3, 5])
def test_a_slower_source_is_found_behind_coarse_steps(count, every):
    motion = 3 * np.sin(2 * np.pi * 0.4 * T)
    flown = record(WAVE, count * np.round(held(motion + NOISE, every) / count))
    marks = repeated(flown)
    # new samples that equal the last one are none; long runs by chance are left
    wrong = marks[:, 1] != (np.arange(len(T)) % every > 0)
    assert wrong.mean() < 0.05
    assert not (marks[:, 1] & (np.arange(len(T)) % every == 0)).any()
    assert source_interval(flown, marks, 1) == pytest.approx(0.01 * every, rel=0.05)


def test_a_source_between_samples_is_found_behind_coarse_steps():
    k = np.arange(len(T))
    new = np.floor(k / 2.5) > np.floor((k - 1) / 2.5)
    source = np.flatnonzero(new)[np.cumsum(new) - 1]
    found = repeated(record(WAVE, 0.5 * np.round(2 * NOISE[source])))[:, 1]
    assert (found != ~new).mean() < 0.1
    assert found.mean() == pytest.approx(0.6, abs=0.03)


MOTIONS = {
    "still": np.zeros(len(T)),
    "slow": np.sin(2 * np.pi * 0.1 * T),
    "fast": np.sin(2 * np.pi * 4 * T + 3 * np.sin(0.3 * T)),
    "ramps": np.abs((T % 4) - 2),
    "steps": np.sign(np.sin(2 * np.pi * T)),
    "vibration": np.sin(2 * np.pi * 25 * T),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_channel_that_is_merely_rounded_is_not_held(motion):
    for count in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0):
        for size in (1.0, 10.0, 100.0):
            for part in (slice(None), slice(0, 500)):
                x = count * np.round((size * MOTIONS[motion] + NOISE) / count)
                flown = Record(T[part], WAVE[part, None], x[part, None], ("lat",), ("p",))
                assert not repeated(flown).any(), (count, size)


def test_two_values_of_a_clock_are_no_source_behind_steps():
    bits = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], len(T) // 10), 10)
    assert not repeated(record(bits, bits)).any()


def test_moves_in_neighbouring_samples_are_of_no_slower_source():
    rng = np.random.default_rng(6)
    moves = np.where(np.arange(len(T)) % 5 == 0, rng.choice([1, -1, 2, -3], len(T)), 0)
    assert repeated(record(WAVE, np.cumsum(moves)))[:, 1].mean() == pytest.approx(0.8, abs=0.02)
    moves[rng.choice(len(T) // 5, 15, replace=False) * 5 + 1] = 3  # a leap goes on
    assert not repeated(record(WAVE, np.cumsum(moves))).any()
