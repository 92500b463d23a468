"""Several records: shared channels, sizes, and what gaps in time make of them."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import Roll, flown
from truths.small_record import T, record

from casid import (
    DataWarning,
    Record,
    frequency_response,
    identifiability,
    output_error,
    pbsid,
    validate,
)
from casid.records import (
    check_moved,
    common_hold,
    same_channels,
    same_interval,
    standard_deviations,
    steps_told,
    stretches,
    twins_told,
)


def test_clocks_that_differ_by_less_than_a_thousandth_sample_alike():
    one = record()
    for ratio, same in ((1.0, True), (1.0009, True), (1.0011, False), (0.9989, False)):
        assert same_interval(replace(one, t=ratio * one.t), one) is same


def test_records_of_one_campaign_share_their_channels():
    assert same_channels([record(), record(name="other")]) == (("lat", "ped"), ("p", "r", "phi"))
    with pytest.raises(ValueError, match="no records given"):
        same_channels([])
    assert same_channels(record()) == (("lat", "ped"), ("p", "r", "phi"))
    with pytest.raises(ValueError, match=r"record 'b' has channels .* use Record.select"):
        same_channels([record(), record(name="b", outputs=("p", "r", "psi"))])


@pytest.mark.parametrize(
    "use",
    [
        lambda records: output_error(Roll(), records),
        lambda records: validate({"roll": Roll()}, records),
        pbsid,
        stretches,
    ],
    ids=["output_error", "validate", "pbsid", "stretches"],
)
def test_records_of_a_generator_are_refused_as_they_could_be_read_only_once(use):
    for once in ((each for each in [record()]), map(replace, [record()])):
        with pytest.raises(ValueError, match=r"come from a (generator|map), .* pass a list"):
            use(once)


def test_standard_deviations_pool_all_samples_and_leave_still_channels_at_one():
    y = np.ones((5, 3)) * [1.0, 2.0, 0.1]
    y[:, 0], y[0, 0] = [9, 1, 2, 3, 4], np.nan
    y[:, 2] += 1e-17 * T  # rounding is no motion
    su, sy = standard_deviations([record(y=y), record(y=np.roll(y, 1, axis=0))])
    assert su[0] == pytest.approx(np.std(np.tile(T, 2)))
    np.testing.assert_allclose(sy, [np.std([1, 2, 3, 4]), 1.0, 1.0])
    silent = record(y=np.full((5, 3), np.nan))
    np.testing.assert_array_equal(standard_deviations([silent])[1], 1.0)


# ---- gaps in time ------------------------------------------------------------------------------


def test_rows_missing_for_longer_than_two_intervals_end_a_stretch():
    t = 0.1 * np.arange(100)
    whole = Record(t, np.ones((100, 1)), np.ones((100, 1)), ("u",), ("y",), "a")
    one, two = np.arange(100) != 50, ~np.isin(np.arange(100), (50, 51))
    assert len(stretches(whole.take(one))) == 1  # one row lost: twice the interval
    with pytest.warns(
        DataWarning, match=r"'a' has 1 gap in time, the longest of 0.3 s after 4.9 s"
    ):
        parts = stretches([whole.take(two)])
    assert [(part.name, part.N, part.t[0]) for part in parts] == [
        ("a 1", 50, 0.0),
        ("a 2", 48, 5.2),
    ]
    random = replace(whole, t=np.cumsum(np.random.default_rng(0).uniform(0.01, 0.2, 100)))
    assert stretches(random) == (random,)  # irregular, but nothing is lost


def test_stretches_too_short_to_tell_anything_are_left_out_or_refused():
    t = np.concatenate([np.arange(30), 100 + np.arange(5), 200 + np.arange(20.0)])
    record = Record(t, np.ones((55, 1)), np.ones((55, 1)), ("u",), ("y",), "a")
    with pytest.warns(
        DataWarning, match="as 2 stretches, .*; 5 samples in shorter ones are left out"
    ):
        assert [part.N for part in stretches(record)] == [30, 20]
    with pytest.raises(ValueError, match="no stretch of 16 samples between them; leave it out"):
        stretches(record.between(20, 110))


DROPOUT = {
    "output error": lambda records: output_error(Roll(), records, interval=2.0).model.vector(),
    "black box": lambda records: pbsid(
        records, order=3, past=8, pole=6.0, feedthrough=["ay"]
    ).system.response(np.array([0.5, 2.0, 8.0])),
    "frequency response": lambda records: (
        frequency_response(records, omega=np.array([3.0, 5.0]), windows=[6.0]).G
    ),
    "validation": lambda records: validate({"truth": Roll()}, records).rms["truth"],
    "identifiability": lambda records: identifiability(Roll(), records).information,
}


@pytest.mark.second
@pytest.mark.parametrize("estimate", DROPOUT.values(), ids=DROPOUT)
def test_a_dropout_of_five_seconds_is_the_flight_cut_in_two(estimate):
    noise = {"ay": 0.05, "p": 0.005, "phi": 0.005}
    whole = flown(t=0.02 * np.arange(1750), seed=1).with_noise(noise, np.random.default_rng(3))
    lost = whole.take((whole.t < 15) | (whole.t > 20))
    with pytest.warns(DataWarning, match="1 gap in time, the longest of 5.0"):
        found = estimate(lost)
    expected = estimate([whole.between(0, 14.99), whole.between(20.01, 40)])
    np.testing.assert_allclose(found, expected, rtol=1e-9)


# ---- units -------------------------------------------------------------------------------------


def turning(rate=1.0, angle=1.0):
    """A roll of 20 s with measured rate and bank in units of that many rad/s and rad."""
    t = 0.02 * np.arange(1001)
    p, phi = np.cos(1.3 * t), np.sin(1.3 * t) / 1.3
    rng = np.random.default_rng(2)
    y = np.column_stack([p / rate, phi / angle]) + 0.01 * rng.standard_normal((1001, 2))
    y[3:9, 0], y[::2, 1] = np.nan, np.nan
    return Record(t, np.sin(t)[:, None], y, ("lat",), ("p", "phi"), "roll")


def test_degrees_per_second_beside_radians_are_suspected():
    degree = np.pi / 180
    with pytest.warns(
        DataWarning, match=r"'roll': 'p' turns 57.\d times .* is 'p' in deg/s, or 'phi' decl"
    ):
        stretches(turning(rate=degree))
    with pytest.warns(DataWarning, match="is 'phi' in deg, or 'p' declared deg/s and in rad/s[?]"):
        stretches(turning(angle=degree))
    with pytest.warns(DataWarning, match="0.01.* or 'p' declared deg/s and in rad/s[?]"):
        stretches(turning(rate=1 / degree))
    for count, unit in ((1e3, "ms"), (1e6, "us")):
        flown = turning()
        with pytest.warns(DataWarning, match=f"is time in {unit}, and read as s[?] State its unit"):
            stretches(replace(flown, t=count * flown.t))
    for sound in (turning(), replace(turning(), outputs=("q", "phi")), turning(rate=0.2)):
        stretches(sound)
    random = turning(rate=degree)
    stretches(random.with_noise({"p": 300.0}, np.random.default_rng(1)))  # nothing alike
    stretches(random.take(np.arange(1001) < 300))  # too short to tell


def stick(x, **more):
    """A record of a stick (N,) alone."""
    return Record(0.02 * np.arange(len(x)), x[:, None], x[:, None], ("lat",), ("p",), **more)


@pytest.mark.parametrize("seed", range(10))
def test_inputs_that_jump_within_a_sample_are_told_and_others_not(seed):
    rng = np.random.default_rng([18, seed])
    levels = np.repeat(rng.choice([-0.1, 0.0, 0.1], 40), rng.integers(10, 60, 40))
    fed = 0.02 * np.sin(0.05 * np.arange(len(levels)) + seed)  # back, by a controller
    smooth = np.convolve(np.repeat(rng.standard_normal(40), 30), np.hanning(25), mode="same")
    starts = np.cumsum(rng.integers(10, 60, 40)) + rng.uniform(0.2, 0.8, 40)
    corners = np.stack([starts, starts + rng.uniform(1.0, 3.0, 40)], axis=1).ravel()
    edged = np.interp(np.arange(2400), corners, np.repeat(rng.standard_normal(41), 2)[1:-1])
    for steps in (levels, levels + fed, levels + 1e-3 * rng.standard_normal(len(levels))):
        (said,) = steps_told(stick(steps), ["lat"])
        assert said.startswith("lat moves in steps, read as straight lines")
        assert "half a sample, 10 ms" in said
    slow = np.repeat(smooth[::8], 8)  # samples of a slower source, repeated
    for x in (smooth, edged, slow, np.round(smooth), rng.standard_normal(1000), 0 * smooth):
        assert not steps_told(stick(x), ["lat"])
    assert not steps_told(stick(levels, hold="zoh"), ["lat"])
    assert not steps_told(stick(levels), [])


def test_an_input_that_never_moves_tells_nothing():
    t = 0.1 * np.arange(20)
    still = Record(t, np.column_stack([np.sin(t), 0 * t]), np.cos(t)[:, None], ("a", "b"), ("y",))
    moved = replace(still, u=still.u[:, ::-1])
    check_moved([still, moved])
    with pytest.raises(ValueError, match="input 'b' never moves in any record"):
        check_moved([still, still])
    with pytest.raises(ValueError, match="input 'b' never moves"):
        pbsid(still, order=1)


def test_what_inputs_do_between_samples_is_that_of_all_records():
    t = 0.1 * np.arange(20)
    one = Record(t, np.sin(t)[:, None], np.cos(t)[:, None], ("a",), ("y",), hold="zoh")
    assert common_hold([one, one]) == "zoh"
    assert common_hold([one, replace(one, hold="foh")]) is None


def test_channels_of_the_same_samples_are_told_unless_they_rest():
    t, rng = np.arange(50) / 50, np.random.default_rng(1)
    p = np.where(np.arange(50) % 7 == 0, np.nan, rng.standard_normal(50))
    y = np.column_stack([p, p, np.zeros((50, 2))])
    record = Record(t, rng.standard_normal((50, 1)), y, ("lat",), ("p", "p2", "r", "phi"))
    assert twins_told(record) == ["p2 and p are the same samples: one column read twice?"]
    other = replace(record, y=y + 0.1 * (np.arange(4) == 1))
    assert twins_told([record, other]) == []  # in one of two records only
