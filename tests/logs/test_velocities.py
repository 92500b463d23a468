from pathlib import Path

import numpy as np
import pytest

from casid.logs.conventions import BODY, derived, find_channels
from casid.logs.sources import source_of
from casid.logs.topics import Log, Topic
from casid.logs.velocities import together, turned_anew

LATE, SPEED = 0.05, 20.0  # s, m/s


def heading(t):
    return 0.3 * np.sin(1.7 * t)


def flown(name="vehicle_attitude"):
    """Northward at constant speed, the nose swings: v = -U sin ψ; attitudes are logged late."""
    t = 0.01 * np.arange(2000)
    half, zero = heading(t - LATE) / 2, 0 * t
    q = {"q[0]": np.cos(half), "q[1]": zero, "q[2]": zero, "q[3]": np.sin(half)}
    north = dict(zip(("vx", "vy", "vz"), (SPEED + zero, zero, zero), strict=True))
    topics = {name: q, "vehicle_local_position": north}
    made = {n: Topic(name=n, t=t, columns=columns) for n, columns in topics.items()}
    return Log(path=Path("x.ulg"), kind="PX4 ULog", topics=made)


def outputs_of(log):
    return find_channels(derived(log))[1]


def test_velocities_turned_by_late_attitudes_are_turned_by_those_of_their_instant():
    log = flown()
    outputs = outputs_of(log)
    t = outputs["v"].topic.t
    true, r = -SPEED * np.sin(heading(t)), 0.3 * 1.7 * np.cos(1.7 * t)
    inside = slice(20, -20)
    off = (outputs["v"].values - true)[inside]
    assert np.polyfit(r[inside], off, 1)[0] == pytest.approx(SPEED * LATE, rel=0.05)  # U r τ
    found, late = turned_anew(log, outputs, {"psi": -LATE})
    assert late == pytest.approx(LATE)
    assert set(found) <= {"u", "v", "w"}
    # A line between two attitudes errs by h²/8 of ψ'': 1.1e-5 rad, and 20 m/s times as much.
    np.testing.assert_allclose(found["v"].values[inside], true[inside], atol=3e-4)


def test_channels_of_one_message_move_together_or_not_at_all():
    outputs = outputs_of(flown())  # of which u, v and psi move
    late = dict.fromkeys(("u", "v"), -LATE)
    assert together(outputs, late) == late
    assert together(outputs, {"v": -LATE}) == {}
    assert together(outputs, late | {"v": 0.03}) == {}
    assert together(outputs, {"v": -LATE, "psi": -LATE}) == {"psi": -LATE}
    apart = outputs | {"v": outputs_of(flown())["v"]}  # of another message
    assert together(apart, {"v": -LATE}) == {"v": -LATE}


def test_velocities_of_the_attitudes_own_lateness_stay():
    log = flown()
    outputs = outputs_of(log)
    speeds = dict.fromkeys(("u", "v", "w"), -LATE)
    assert turned_anew(log, outputs, {"psi": -LATE} | speeds) == ({}, 0.0)


def test_velocities_stay_where_nothing_turned_them_or_no_attitude_moves():
    log = flown()
    outputs = outputs_of(log)
    assert turned_anew(log, outputs, {}) == ({}, 0.0)
    assert turned_anew(log, outputs, {"p": LATE}) == ({}, 0.0)
    measured = outputs | {n: source_of(log, "vehicle_local_position.vx") for n in ("u", "v")}
    assert turned_anew(log, measured, {"psi": -LATE}) == ({}, 0.0)
    other = derived(flown("other"))
    assert BODY not in other.topics
    angle = source_of(other, "other.psi")
    assert turned_anew(log, outputs | {"psi": angle}, {"psi": -LATE}) == ({}, 0.0)
