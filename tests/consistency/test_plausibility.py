"""Units that must be others, and records from which nothing can be learnt."""

from dataclasses import replace

import numpy as np
import pytest

from casid import Record
from casid.consistency.plausibility import check_plausible, unit_doubts

T = 0.02 * np.arange(100)


def flight(scale=1.0, dt=0.02, travel=0.1):
    u = travel * np.sin(T)[:, None]
    y = scale * np.column_stack([0.1 * np.sin(3 * T), 0.2 * np.cos(T)])
    return Record(T * dt / 0.02, u, y, ("lat",), ("p", "phi"), "roll")


@pytest.mark.parametrize(
    ("record", "channel", "units"),
    [
        (flight(scale=100.0), "p", ("deg/s", "rad/s")),
        (flight(scale=100.0), "phi", ("deg", "rad")),
        (flight(dt=2.0), "t", ("ms", "s")),
        (flight(travel=30.0), "lat", ("%", "1")),
    ],
)
def test_a_channel_that_cannot_be_in_its_unit_is_doubted_until_it_is_stated(record, channel, units):
    doubts = {doubt.channel: doubt.units for doubt in unit_doubts(record)}
    assert doubts[channel] == units
    assert channel not in {doubt.channel for doubt in unit_doubts(record, stated=[channel])}
    assert not unit_doubts(flight())


@pytest.mark.parametrize("rate", [4, 20, 50, 400])
@pytest.mark.parametrize(("unit", "counts"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_the_unit_proposed_for_time_is_that_in_which_it_was_counted(rate, unit, counts):
    count = 1.79e9 * counts + np.round(counts / rate * np.arange(100))  # since 1970
    for taken, worth in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if worth * counts / rate < (1.0 if taken == "s" else 10.0):
            continue  # it passes for the interval of a flight, or for what somebody means
        record = replace(flight(), t=worth * count)
        (doubt,) = unit_doubts(record, stated={} if taken == "s" else {"t": taken})
        assert doubt.units == (unit, taken)
        with pytest.raises(ValueError, match=rf'is it in {unit}\? .* t = "{unit}"'):
            check_plausible([flight()], [record], {} if taken == "s" else {"t": taken})


@pytest.mark.parametrize("taken", ["s", "ms", "us"])
def test_no_unit_that_is_stated_makes_ten_seconds_a_flights_interval(taken):
    good, slow, hardly = flight(), flight(dt=2.0), flight(dt=20.0)
    check_plausible([good], [slow], {"t": taken})
    with pytest.raises(ValueError, match=r"advances 20 s a sample; is it in (\w+)\?.* t = .\1.$"):
        check_plausible([good], [hardly], {"t": taken})


@pytest.mark.parametrize("rate", [10, 50, 400])
@pytest.mark.parametrize(("unit", "worth"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6)])
def test_time_in_too_small_a_unit_is_told_with_that_in_which_it_was_counted(rate, unit, worth):
    counts = 1.79e9 / worth + np.arange(100) / rate / worth
    for taken, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if factor >= worth:
            continue
        record = replace(flight(), t=counts * factor)
        with pytest.raises(ValueError, match=rf'as no flight.*is it in {unit}\? .* t = "{unit}"$'):
            check_plausible([flight()], [record], {"t": taken})


def test_time_in_days_is_to_be_converted_unless_it_is_said_to_be_in_seconds():
    days = flight(dt=0.02 / 86400)
    with pytest.raises(ValueError, match=r"100 samples last 2.29e-05 s.*\(days times 86400"):
        check_plausible([flight()], [days], {})
    check_plausible([flight()], [days], {"t": "s"})


def test_a_kilohertz_of_less_than_a_tenth_of_a_second_is_no_flight_and_few_samples_are_few():
    t = 1e-3 * np.arange(50)
    moved = np.sin(50 * t)[:, None]
    record = Record(t, moved, np.hstack([moved, moved]), ("lat",), ("p", "phi"), "short")
    (doubt,) = unit_doubts(record)
    assert "50 samples last 0.049 s, as no flight's do" in doubt.said
    assert not unit_doubts(record.take(np.arange(50) < 10))
    with pytest.raises(ValueError, match="has 10 samples, at least 16 are wanted"):
        check_plausible([flight()], [record.take(np.arange(50) < 10)], {})


@pytest.mark.parametrize(("dt", "n"), [(1.25e-4, 1000), (1e-3, 101), (2e-3, 20)])
def test_records_of_fast_loggers_and_short_ones_pass(dt, n):
    t = dt * np.arange(n)
    moved = np.sin(50 * t)[:, None]
    record = Record(t, moved, np.hstack([moved, moved]), ("lat",), ("p", "phi"), "fast")
    assert not unit_doubts(record)
    assert not unit_doubts(record, stated={"t": "us"})


@pytest.mark.parametrize(("dt", "said"), [(5.0, "5 s"), (2e-5, "2e-05 s")])
def test_an_interval_that_is_given_is_to_be_corrected_itself(dt, said):
    with pytest.raises(ValueError, match=rf"time advances {said} a sample.*; correct dt, in sec"):
        check_plausible([flight()], [flight(dt=dt)], {}, None)


def test_a_heading_passes_for_radians_up_to_three_turns():
    for turns, doubted in ((2.9, False), (3.1, True)):
        psi = 2 * np.pi * turns * np.sin(T / T[-1])[:, None] / np.sin(1.0)
        record = Record(T, np.sin(T)[:, None], psi, ("ped",), ("psi",))
        assert bool(unit_doubts(record)) is doubted


def test_a_stick_in_pulses_of_a_servo_is_taken_for_that():
    moves = flight(travel=400.0)
    (doubt,) = unit_doubts(replace(moves, u=1500 + moves.u))
    assert doubt.units == ("pwm", "1")


def test_records_that_teach_nothing_are_refused():
    good = flight()
    check_plausible([good], [good], {})
    with pytest.raises(ValueError, match=r"'p' reaches 10 rad/s; is it in deg/s\? State its unit"):
        check_plausible([good], [flight(scale=100.0)], {"phi": "rad"})
    with pytest.raises(ValueError, match="'roll' has 15 samples, at least 16 are wanted"):
        check_plausible([good], [good.between(0, 0.28)], {})
    still = replace(good, u=np.full_like(good.u, 0.3))
    with pytest.raises(ValueError, match=r"input 'lat' is constant in record 'roll'.*excites it"):
        check_plausible([still], [good], {})
    check_plausible([still, good], [good], {})
    dead = replace(good, y=good.y * [1.0, 0.0])
    with pytest.raises(ValueError, match=r"output 'phi' is constant .*look at its sensor"):
        check_plausible([dead], [good], {})


def test_an_input_at_rest_teaches_a_structure_of_total_values_if_it_rests_elsewhere_in_another():
    good = flight()
    slow, fast = (
        replace(good, u=np.full_like(good.u, level), name=name).detrend("first")
        for level, name in ((0.3, "slow"), (0.5, "fast"))
    )
    check_plausible([slow, fast], [slow, fast], {}, total=True)
    for records, total in (([slow, fast], False), ([slow, replace(slow, name="again")], True)):
        with pytest.raises(ValueError, match="input 'lat' is constant"):
            check_plausible(records, records, {}, total=total)
    dead = [replace(each, y=good.y * [1.0, 0.0]) for each in (slow, fast)]
    with pytest.raises(ValueError, match="output 'phi' is constant"):
        check_plausible(dead, dead, {}, total=True)
