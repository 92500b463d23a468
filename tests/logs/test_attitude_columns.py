from pathlib import Path

import numpy as np
import pytest

from casid.logs.attitude_columns import attitude_topics, attitudes, axis_of, turning
from casid.logs.sources import Source
from casid.logs.topics import Log, Topic

T = np.arange(0, 40, 0.02)
P = 0.3 * np.sin(1.7 * T) + 0.2 * np.sin(0.6 * T)
PHI = -0.3 / 1.7 * np.cos(1.7 * T) - 0.2 / 0.6 * np.cos(0.6 * T)  # its integral


def rates(p=P):
    topic = Topic(name="gyro", t=T, columns={"p": p})
    return {"p": Source(place="gyro.p", topic=topic, values=p)}


def flown(roll, name="flight", t=T):
    topic = Topic(name=name, t=t, columns={"Roll": roll})
    return topic, Log(path=Path("x"), kind="TDMS", topics={name: topic})


@pytest.mark.parametrize("unit", [1, 180 / np.pi])
@pytest.mark.parametrize("late", [0.0, 0.1])
def test_an_attitude_is_told_by_its_rate_through_noise_and_delay(unit, late):
    rng = np.random.default_rng(2)
    roll = unit * (np.interp(T - late, T, PHI) + 0.01 * rng.standard_normal(len(T)))
    topic, log = flown(roll)
    ((name, source, gain),) = turning(log, topic, rates(P + 0.05 * rng.standard_normal(len(T))))
    assert (name, source.place) == ("phi", "flight.Roll")
    assert gain == pytest.approx(unit, rel=0.05)


def test_an_attitude_stamped_late_turns_when_it_was_sampled():
    age = 0.8  # beyond the delays that are looked for
    for known, found in ((age, ["phi"]), (0.0, [])):
        topic = Topic(name="flight", t=T + age, columns={"Roll": PHI}, age=known)
        log = Log(path=Path("x"), kind="TDMS", topics={"flight": topic})
        assert [name for name, _, _ in turning(log, topic, rates())] == found


def test_turns_over_the_edge_go_on():
    p = 0.5 + P
    phi = PHI + 0.5 * T
    topic, log = flown((phi + np.pi) % (2 * np.pi) - np.pi)
    assert [name for name, _, _ in turning(log, topic, rates(p))] == ["phi"]


@pytest.mark.parametrize("stick", [P, -PHI, 7 * PHI, 0 * P, np.sign(P)])
def test_sticks_do_not_turn_as_rates_do(stick):
    topic, log = flown(stick)
    assert list(turning(log, topic, rates())) == []
    assert attitude_topics(log, rates()) == set()


def test_a_log_too_short_tells_nothing():
    topic, log = flown(PHI[:60], t=T[:60])
    assert list(turning(log, topic, rates())) == []


@pytest.mark.parametrize(
    ("name", "so"),
    [("ATT", True), ("AHR2", True), ("XKF1[0]", True), ("vehicle_attitude", True),
     ("Instruments", False), ("inputs", False), ("stick angles", False)],
)  # fmt: skip
def test_topics_of_attitudes_are_known_by_name(name, so):
    _, log = flown(P, name)
    assert attitude_topics(log, {}) == ({name} if so else set())


def test_attitudes_are_taken_in_the_unit_of_the_rate_and_as_flown():
    _, log = flown(PHI)
    assert {n: each.place for n, each in attitudes(log, rates()).items()} == {"phi": "flight.Roll"}
    assert attitudes(log, rates() | {"phi": rates()["p"]}) == {}
    for roll, name in ((np.degrees(PHI), "flight"), (PHI, "attitude_setpoint")):
        assert attitudes(flown(roll, name)[1], rates()) == {}


@pytest.mark.parametrize(
    ("column", "axis"), [("Roll [deg]", "roll"), ("NICK", "pitch"), ("roll_cmd", "roll_cmd")]
)
def test_axes_are_known_by_name(column, axis):
    assert axis_of(column) == axis
