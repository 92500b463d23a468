"""Records: what they refuse, and what becomes of samples, trim and noise."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import flown
from truths.flights import flight
from truths.small_record import T, record

from casid import (
    DataWarning,
    Record,
    frequency_response,
    kinematic_check,
    read_csv,
)
from casid.records import stretches


def test_sizes_and_times_follow_from_the_arrays():
    roll = record()
    assert (roll.N, roll.nu, roll.ny) == (5, 2, 3)
    assert roll.duration == pytest.approx(0.4)
    assert roll.dt == pytest.approx(0.1)
    assert roll.equidistant
    assert not record(t=np.array([0, 0.1, 0.2, 0.3, 0.5])).equidistant


def test_a_record_is_a_copy_that_cannot_be_written():
    y = np.ones((5, 3))
    roll = record(y=y)
    y[:] = 7.0
    assert roll.y.max() == 1.0
    with pytest.raises(ValueError, match="read-only"):
        roll.y[0, 0] = 2.0


def test_missing_outputs_are_allowed():
    y = np.ones((5, 3))
    y[2, 1] = np.nan
    assert np.isnan(record(y=y).y[2, 1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": T[:1]}, r"record 'roll': t has shape \(1,\), expected \(N,\) with N >= 2"),
        ({"t": T[:, None]}, r"t has shape \(5, 1\)"),
        ({"u": np.zeros((2, 5))}, r"u has shape \(2, 5\), expected .* = \(5, 2\) .* pass u.T"),
        ({"y": np.zeros(5)}, r"y has shape \(5,\), expected \(N, ny\) = \(5, 3\)"),
        ({"inputs": ("lat", "p")}, "channel 'p' is named twice"),
        ({"hold": "soh"}, 'hold=\'soh\', expected "foh" or "zoh"'),
        ({"t": np.array([0, 0.1, np.nan, 0.3, 0.4])}, r"t\[2\] = nan; time must be finite"),
        (
            {"t": np.array([0, 0.1, 0.1, 0.3, 0.4])},
            r"time does not increase at sample 2 \(0.1 s, then 0.1 s\); sort",
        ),
        ({"u": np.full((5, 2), np.nan)}, "input 'lat' is nan at sample 0"),
        ({"u": np.full((5, 2), -np.inf)}, "input 'lat' is -inf at sample 0; mark .* with NaN"),
        ({"y": np.full((5, 3), np.inf)}, "output 'p' is inf at sample 0; mark .* with NaN"),
    ],
)
def test_what_is_no_record_is_refused_with_its_name(changes, message):
    with pytest.raises(ValueError, match=message):
        record(**changes)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_inputs_that_lack_samples_are_read_by_their_hold_as_from_a_file(tmp_path, hold):
    t = 0.02 * np.arange(60)
    slow, gone = 2 * t, -t
    slow[np.arange(60) % 2 > 0] = np.nan
    gone[20:26] = np.nan
    u, y = np.column_stack([slow, gone]), np.cos(t)[:, None]
    names = {"inputs": ("lat", "ped"), "outputs": ("p",), "hold": hold}
    said = r"inputs lack samples \(lat 50.0%, ped 10.0%\).*; 7 samples without inputs are left out"
    with pytest.warns(DataWarning, match=said):
        found = Record(t, u, y, name="n", **names)
    rows = np.delete(np.arange(60), [*range(20, 26), 59])
    np.testing.assert_array_equal(found.t, t[rows])
    np.testing.assert_array_equal(found.y, y[rows])
    known = 2 * t if hold == "foh" else 2 * t[np.arange(60) // 2 * 2]
    np.testing.assert_allclose(found.u, np.column_stack([known, -t])[rows], atol=1e-12)
    table = np.column_stack([t, u, y])
    np.savetxt(tmp_path / "n.csv", table, delimiter=",", header="t,lat,ped,p", comments="")
    with pytest.warns(DataWarning, match=said):
        read = read_csv(tmp_path / "n.csv", **names)
    np.testing.assert_allclose(read.u, found.u, atol=1e-12)
    np.testing.assert_array_equal(read.t, found.t)


def test_an_input_that_is_hardly_known_is_refused():
    t, y = 0.02 * np.arange(40), np.zeros((40, 1))
    u = np.where(np.arange(40) < 30, np.nan, 0.0)[:, None]
    with pytest.raises(ValueError, match=r"'lat' is missing nearly everywhere; .*Record\.join"):
        Record(t, u, y, ("lat",), ("p",), "n")


def test_channels_are_found_and_chosen_by_name():
    roll = record()
    np.testing.assert_array_equal(roll.channel("ped"), -T)
    np.testing.assert_array_equal(roll.channel("r"), T**2)
    chosen = roll.select(inputs=("ped",), outputs=("phi", "p"))
    assert (chosen.inputs, chosen.outputs) == (("ped",), ("phi", "p"))
    np.testing.assert_array_equal(chosen.y, np.column_stack([1 + T, 2 * T]))
    for wrong in (lambda: roll.channel("q"), lambda: roll.select(outputs=("q",))):
        with pytest.raises(ValueError, match=r"record 'roll' has no .* 'q'; it has p, r, phi"):
            wrong()
    with pytest.raises(ValueError, match=r"has no input 'pedd'; .* did you mean 'ped'\?"):
        roll.select(inputs=("pedd",))
    with pytest.raises(ValueError, match="has no input 'p'; it has lat, ped"):
        roll.select(inputs=("p",))


def test_cuts_and_decimation_keep_the_samples_named():
    np.testing.assert_array_equal(record().between(0.1, 0.3).t, T[1:4])
    np.testing.assert_array_equal(record().decimate(2).y, record().y[::2])
    with pytest.raises(ValueError, match=r"record 'roll' has 1 sample between 0.15 s and 0.25 s"):
        record().between(0.15, 0.25)
    with pytest.raises(ValueError, match="record 'roll': step=0"):
        record().decimate(0)


def test_the_quiet_stretch_ends_where_the_first_input_leaves_two_percent_of_its_range():
    u = np.zeros((5, 2))
    u[:, 0] = [0.5, 0.51, 0.49, 1.5, 0.5]  # noise of 1 % of the range
    u[4, 1] = 3.0
    assert record(u=u).quiet_samples() == 3
    assert record(u=np.ones((5, 2))).quiet_samples() == 5


def noisy_stick(share, seed=0):
    """A doublet at 2 s of a stick with white noise of that share of its range at rest."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(500)
    u = np.where((t >= 2) & (t < 3), 1.0, 0.0) - np.where((t >= 3) & (t < 4), 1.0, 0.0)
    u = u + 2 * share * rng.standard_normal(len(t))
    return Record(t, u[:, None], 3 + rng.standard_normal((500, 1)), ("lat",), ("p",), "noisy")


@pytest.mark.parametrize("share", [0.0, 0.005, 0.02, 0.05])
def test_noise_of_a_resting_stick_does_not_end_the_quiet_stretch(share):
    for seed in range(20):
        assert noisy_stick(share, seed).quiet_samples() == 100


@pytest.mark.parametrize("share", [0.0, 0.005, 0.02])
def test_an_input_as_rough_as_noise_ends_the_quiet_stretch_all_the_same(share):
    for seed in range(10):
        rest = noisy_stick(share, seed)
        rough = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], (rest.N, 1))
        u = np.where(rest.t[:, None] < 2, rest.u, rough)
        assert replace(rest, u=u).quiet_samples() == 100


@pytest.mark.parametrize(
    ("noise", "drift", "late"), [(0, 0, 0), (1e-4, 0, 16), (3e-3, 0, 30), (1e-4, 5e-4, 12)]
)
def test_a_sweep_that_fades_in_ends_the_quiet_stretch_where_it_begins(noise, drift, late):
    for seed in range(5):
        t = 0.02 * np.arange(2000)
        x = np.clip(t - 3, 0, None)
        u = np.clip(x / 5, 0, 1) * np.sin(0.3 * x + 0.05 * x**2) + drift * np.sin(t)
        u += noise * np.random.default_rng(seed).standard_normal(len(t))
        quiet = Record(t, 0.5 + u[:, None], t[:, None], ("lat",), ("p",)).quiet_samples()
        assert 150 <= quiet <= 151 + late  # it passes 2 % of its range after 0.8 s, 41 samples


def test_a_stick_that_wanders_at_rest_as_a_controller_lets_it_stays_quiet():
    t = 0.02 * np.arange(500)
    u = np.where(t >= 2, 1.0, 0.004 * t)
    assert Record(t, u[:, None], t[:, None], ("lat",), ("p",)).quiet_samples() == 100


def test_a_trim_from_too_short_a_stretch_is_said_with_its_length():
    late = noisy_stick(0.02).cut(1.8, 9.0)
    with pytest.warns(DataWarning, match=r"'noisy': an input moves 0\.2 s after.*mean of 10 samp"):
        trim = late.detrend("first").trim
    assert trim["p"] == pytest.approx(late.y[:10].mean())


def test_trim_is_subtracted_and_remembered():
    u = np.array([[1, 2], [1, 2], [5, 2], [1, 9], [1, 2.0]])
    y = np.ones((5, 3)) * [1, 2, 3]
    y[0, 0] = np.nan
    roll = record(u=u, y=y)
    with pytest.warns(DataWarning, match="the mean of 2 samples"):
        first = roll.detrend("first")
    np.testing.assert_array_equal(first.u, u - [1, 2])
    np.testing.assert_array_equal(first.y[1:], np.zeros((4, 3)))
    assert first.trim == {"lat": 1, "ped": 2, "p": 1, "r": 2, "phi": 3}
    mean = roll.detrend("mean")
    np.testing.assert_allclose(mean.u.mean(axis=0), 0, atol=1e-15)
    assert roll.detrend(None) is roll
    twice = first.detrend(dict.fromkeys(first.trim, 0.5))
    assert twice.trim["ped"] == 2.5
    np.testing.assert_array_equal(twice.u, u - [1.5, 2.5])


def test_trim_that_is_not_there_is_told():
    with pytest.raises(ValueError, match="record 'roll': no trim value for channel 'ped'"):
        record().detrend({"lat": 0.0})
    with pytest.raises(ValueError, match='how = \'last\', expected "first" or "mean"'):
        record().detrend("last")
    y = np.ones((5, 3))
    y[:2, 1] = np.nan
    u = np.zeros((5, 2))
    u[2:] = 1.0
    with (
        pytest.warns(DataWarning, match="the mean of 2 samples"),
        pytest.raises(ValueError, match="output 'r' has no sample in its first 2"),
    ):
        record(u=u, y=y).detrend("first")


def test_noise_has_the_standard_deviation_asked_for_and_no_other_channel():
    t = np.arange(20000) / 50
    still = Record(t, np.zeros((20000, 1)), np.zeros((20000, 2)), ("lat",), ("p", "phi"))
    noisy = still.with_noise({"phi": 0.3}, np.random.default_rng(0))
    np.testing.assert_array_equal(noisy.y[:, 0], 0)
    # The standard error of a standard deviation from N samples is 1/sqrt(2N) = 0.5 %; four of them.
    assert noisy.y[:, 1].std() == pytest.approx(0.3, rel=0.02)
    again = still.with_noise({"phi": 0.3}, np.random.default_rng(0))
    np.testing.assert_array_equal(again.y, noisy.y)
    with pytest.raises(ValueError, match="no output 'q'"):
        still.with_noise({"q": 1.0}, np.random.default_rng(0))


# ---- stamps that nearly agree --------------------------------------------------------------------


def test_samples_at_nearly_the_same_instant_are_one_and_told():
    whole = flown(t=0.02 * np.arange(1500), seed=2)
    twice = np.insert(np.arange(whole.N), [401, 801], [400, 800])
    t = whole.t[twice]
    t[[401, 802]] += 1e-5
    y = whole.y[twice]
    y[401] += 0.01  # noise of the second reading
    with pytest.warns(DataWarning, match=r"2 of 1502 samples .*rows 401, 802, .* 8.00001 s"):
        doubled = replace(whole, t=t, u=whole.u[twice], y=y)
    for letter in "tuy":
        np.testing.assert_array_equal(getattr(doubled, letter), getattr(whole, letter))
    np.testing.assert_allclose(doubled.resample(0.01).y[::2], whole.y, atol=1e-12)


def test_sensors_on_nearly_one_clock_fill_each_others_samples():
    t = np.sort(np.concatenate([0.1 * np.arange(20), 0.1 * np.arange(20) + 1e-4]))
    t = np.concatenate([t, 2.0 + 0.1 * np.arange(40)])  # one sensor goes on alone
    y = np.full((80, 2), np.nan)
    y[0:40:2, 0], y[1:40:2, 1], y[40:] = 1.0, 2.0, 3.0
    with pytest.warns(DataWarning, match=r"20 of 80 samples .*rows 1, 3, 5, 7, 9 \.\.\."):
        both = Record(t, np.zeros((80, 1)), y, ("u",), ("a", "b"))
    np.testing.assert_allclose(both.t, 0.1 * np.arange(60), atol=1e-12)
    np.testing.assert_array_equal(both.y[:20], np.tile([1.0, 2.0], (20, 1)))


# ---- the same flight otherwise -------------------------------------------------------------------


def test_a_resampled_record_has_the_same_response_and_keeps_its_losses():
    record = flown(t=0.02 * np.arange(1500), seed=2)
    y = record.y.copy()
    y[700:750, 1] = np.nan
    slow = replace(record, y=y).resample(0.05)
    assert (slow.dt, slow.duration) == (pytest.approx(0.05), pytest.approx(29.95))
    lost = np.isnan(slow.y[:, 1])
    # 1 s, and where the filter reaches into it: two samples at most on either side.
    assert 20 <= lost.sum() <= 25
    assert np.ptp(slow.t[lost]) == pytest.approx(0.05 * (lost.sum() - 1))
    assert not np.isnan(slow.y[:, [0, 2]]).any()
    omega = np.array([2.0, 4.0])
    how = {"omega": omega, "windows": [10.0], "method": "windows"}
    wanted = frequency_response(record, **how).G
    found = frequency_response(record.resample(0.05), **how).G
    # Windows lie a little otherwise, so that leakage of the other input differs.
    np.testing.assert_allclose(found, wanted, atol=0.005 * np.abs(wanted).max())
    with pytest.raises(ValueError, match="dt=0, expected above"):
        record.resample(0)
    with pytest.raises(ValueError, match=r"expected above .* s \(10000000 samples\)"):
        record.resample(1e-12)


@pytest.mark.parametrize("gap", [0.06, 1.0])
def test_stretches_between_gaps_are_resampled_by_themselves(gap):
    record = flown(t=0.02 * np.arange(1500), seed=2)
    torn = record.take((record.t < 5) | (record.t > 5 + gap))
    slow = torn.resample(0.05)
    assert slow.name == torn.name
    first, second = slow.stretches()
    a, b = torn.stretches()
    by_hand = a.resample(0.05), b.resample(0.05)
    np.testing.assert_allclose(first.y, by_hand[0].y[: first.N], atol=0.02 * np.std(record.y))
    np.testing.assert_array_equal(second.y, by_hand[1].y)
    np.testing.assert_array_equal(second.t, by_hand[1].t)
    assert first.t[-1] <= a.t[-1]  # nothing stands in the gap
    assert a.duration - first.duration < 3 * 0.05
    with pytest.raises(ValueError, match="no stretch of 16 samples every 2 s"):
        torn.resample(2.0)


def test_steps_stay_steps_when_sampled_faster():
    t = 0.1 * np.arange(30)
    record = Record(t, np.floor(t)[:, None], np.sin(t)[:, None], ("u",), ("y",), hold="zoh")
    fast = record.resample(0.02)
    assert fast.hold == "zoh"
    np.testing.assert_array_equal(fast.u[:, 0], np.floor(fast.t + 1e-9))
    np.testing.assert_allclose(fast.y[:, 0], np.sin(fast.t), atol=1e-6)


@pytest.mark.second
def test_a_late_channel_is_shifted_back():
    record = flight(0, {"p": (0.0, 0.0, 0.06)}, outputs=("p", "q", "r", "phi", "theta"))
    back = record.shift({"p": -0.06})
    p = {each.channel: each for each in kinematic_check(back).channels}["p"]
    assert p.skew == pytest.approx(0.0, abs=1e-4)
    assert back.t[-1] == pytest.approx(record.t[-1] - 0.06)
    np.testing.assert_array_equal(back.channel("q"), record.channel("q")[: back.N])
    with pytest.raises(ValueError, match="no channel 'beta'"):
        record.shift({"beta": 0.1})


@pytest.mark.parametrize("drift", [2e-3, -2e-3])
def test_a_channel_that_drifts_is_set_right_from_the_start_on(drift):
    t = 5 + 0.02 * np.arange(2000)
    late = 0.03 + drift * (t - 5)
    record = Record(t, t[:, None], np.sin(2 * (t - late))[:, None], ("u",), ("y",))
    back = record.shift({"y": -0.03}, drift={"y": -drift})
    np.testing.assert_allclose(back.y[:, 0], np.sin(2 * back.t), atol=1e-3)  # 40 ms grow by 2e-3
    np.testing.assert_array_equal(back.u[:, 0], back.t)
    assert t[-1] - back.t[-1] < 0.05 + abs(drift) * 40
    with pytest.raises(ValueError, match="no channel 'beta'"):
        record.shift({}, drift={"beta": 0.01})


@pytest.mark.parametrize("drift", [1.0, -0.051, 5e2])
def test_no_clock_runs_at_another_rate_by_more_than_a_twentieth(drift):
    t = 0.02 * np.arange(500)
    record = Record(t, t[:, None], np.sin(t)[:, None], ("u",), ("y",))
    with pytest.raises(ValueError, match=r"drift of 'y' .* at most 0\.05 is a clock's"):
        record.shift({}, drift={"y": drift})
    assert record.shift({}, drift={"y": 0.05}).N > 450


@pytest.mark.parametrize("late", [-0.04, 0.02, 0.03, -0.013])
def test_a_shift_adds_no_measurements(late):
    t = 0.02 * np.arange(500)
    y = np.column_stack([np.sin(t), np.cos(t), np.cos(t)])
    y[1::2, 0] = np.nan  # at half rate
    y[[100, 200, 300], 1] = np.nan
    record = Record(t, t[:, None], y, ("u",), ("slow", "holed", "whole"))
    moved = record.shift(dict.fromkeys(record.outputs, late))
    for i, lost in enumerate((moved.N / 2, 3, 0)):
        assert np.isnan(moved.y[:, i]).sum() == pytest.approx(lost, abs=0.5)
    there = np.isfinite(moved.y[:, 0])
    np.testing.assert_allclose(moved.y[there, 0], np.sin(moved.t[there] - late), atol=1e-5)
    gone = moved.t[np.isnan(moved.y[:, 1])] - late
    np.testing.assert_allclose(gone, t[[100, 200, 300]], atol=0.0101)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_inputs_are_shifted_within_each_stretch_of_a_record_with_a_gap(hold):
    t = np.delete(0.02 * np.arange(500), slice(200, 260))
    record = Record(t, np.sin(t)[:, None], np.cos(t)[:, None], ("u",), ("y",), hold=hold)
    for late, left_out in ((-0.04, [198, 199, 438, 439]), (0.04, [0, 1, 200, 201])):
        moved = record.shift({"u": late})
        np.testing.assert_array_equal(moved.t, np.delete(t, left_out))
        np.testing.assert_allclose(moved.u[:, 0], np.sin(moved.t - late), atol=1e-9)
        np.testing.assert_array_equal(moved.y[:, 0], np.cos(moved.t))


def test_two_loggers_with_two_clocks_are_one_flight():
    record = flown(seed=4)
    late = replace(record.select([], ["phi"]), t=record.t + 100.003).between(101, 111)
    both = record.select(outputs=["ay", "p"]).join(late, clock=-100.003)
    assert (both.inputs, both.outputs) == (record.inputs, record.outputs)
    rows = slice(*np.searchsorted(record.t, [both.t[0] - 1e-9, both.t[-1] + 1e-9]))
    np.testing.assert_allclose(both.y, record.y[rows], atol=1e-7)
    with pytest.raises(ValueError, match="'lat' is named twice"):
        record.join(record)
    slow = record.select(outputs=["ay", "p"]).join(late.take(slice(0, None, 4)), clock=-100.003)
    assert np.isfinite(slow.channel("phi")).mean() == pytest.approx(0.25, abs=0.01)
    with pytest.raises(ValueError, match="has 0 samples between 101"):
        record.join(late.rename({"phi": "psi"}))


def test_channels_are_renamed_with_their_trim_and_masked_by_sample():
    record = flown(seed=1).detrend("first")
    other = record.rename({"p": "roll rate", "lat": "stick"})
    assert (other.inputs, other.outputs[1]) == (("stick", "ped"), "roll rate")
    assert other.trim["roll rate"] == record.trim["p"]
    with pytest.raises(ValueError, match="no channel 'q'"):
        record.rename({"q": "p"})
    where = np.zeros(record.y.shape, dtype=bool)
    where[5, 2] = True
    assert np.isnan(record.mask(where).y).sum() == 1
    assert np.isnan(record.mask(where).y[5, 2])


def test_two_samples_make_a_record_and_one_does_not():
    two = Record(np.array([0.0, 0.1]), np.zeros((2, 1)), np.ones((2, 1)), ("u",), ("y",))
    assert (two.N, two.dt, two.quiet_samples()) == (2, 0.1, 2)
    with pytest.raises(ValueError, match="t"):
        Record(np.array([0.0]), np.zeros((1, 1)), np.ones((1, 1)), ("u",), ("y",))


def test_an_input_that_moves_at_once_is_quiet_for_one_sample():
    t = 0.1 * np.arange(6)
    u = np.array([0.0, 1.0, 1.0, 0.0, 1.0, 1.0])[:, None]
    assert Record(t, u, np.zeros((6, 1)), ("u",), ("y",)).quiet_samples() == 1
    slow = np.array([0.0, 0.01, 0.019, 0.021, 1.0, 1.0])[:, None]
    assert Record(t, slow, np.zeros((6, 1)), ("u",), ("y",)).quiet_samples() == 3  # 2 % of 1


def test_a_flight_given_twice_is_told_whatever_its_name():
    one = record()
    with pytest.warns(DataWarning, match="records 'one' and 'two' hold the same samples"):
        stretches([replace(one, name="one"), replace(one, name="two")])
    other = replace(one, y=one.y + 1e-9, name="two")
    assert len(stretches([one, other])) == 2


def test_a_headline_says_how_long_and_how_often():
    y = np.zeros((101, 1))
    y[:5] = np.nan
    record = Record(0.05 * np.arange(101), np.zeros((101, 1)), y, ("lat",), ("p",), "one")
    said = "'one', 5 s, 101 samples at 20 Hz, inputs lat, outputs p, 5 % of the outputs missing"
    assert record.headline() == said


def test_what_is_masked_is_missing_and_no_dates_or_complex_numbers_are_taken():
    t, x = 0.02 * np.arange(40), np.sin(np.arange(40.0))[:, None]
    masked = np.ma.masked_array(x, mask=x > 0.9)
    record = Record(t, x, masked, ("lat",), ("p",), "m")
    np.testing.assert_array_equal(np.isnan(record.y), x > 0.9)
    np.testing.assert_array_equal(record.y[x <= 0.9], x[x <= 0.9])
    with pytest.warns(DataWarning, match="record 'm': inputs lack samples"):
        known = Record(t, masked, x, ("lat",), ("p",), "m")
    assert np.isfinite(known.u).all()
    with pytest.raises(ValueError, match="y holds complex numbers"):
        Record(t, x, x + 0j, ("lat",), ("p",), "m")
    for clock in ((1e9 * t).astype("m8[ns]"), (1e9 * t).astype("M8[ns]")):
        with pytest.raises(ValueError, match=r"t holds dates or times.* take seconds"):
            Record(clock, x, x, ("lat",), ("p",), "m")


def test_units_follow_their_channels_through_all_that_makes_records():
    one = replace(record(), units={"lat": "rad"})
    again = one.rename({"lat": "stick"}).detrend("mean").total().cut(T[0], T[-1]).decimate(2)
    assert again.units == {"stick": "rad"}
    other = Record(
        T, np.zeros((len(T), 0)), np.cos(T)[:, None], (), ("beta",), units={"beta": "rad"}
    )
    assert one.join(other).units == {"lat": "rad", "beta": "rad"}
