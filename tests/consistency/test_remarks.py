"""Remarks that belong to no single comparison."""

from dataclasses import replace

import numpy as np
import pytest
from truths.bodies import ATTITUDES, SPEEDS, changed, flown
from truths.flights import FORCES, NOISE, RATES, STATES, flight

from casid.consistency.kinematics import kinematic_check
from casid.consistency.measured import Flight
from casid.consistency.remarks import against_gravity, misplaced, mistake, turned


def still(**values):
    return Flight(0.02, 100, {name: np.full(200, value) for name, value in values.items()})


@pytest.mark.parametrize(
    ("factor", "word"),
    [(-1.1, "sign"), (57.0, "degrees"), (0.1, " g"), (3.3, "feet"), (1001.0, "ms"), (1.5, "")],
)
def test_a_factor_betrays_a_mistake(factor, word):
    assert word in mistake(factor, "ax")
    assert bool(mistake(factor, "ax")) == bool(word)


@pytest.mark.parametrize("channel", ["p", "theta"])
def test_what_turns_is_in_no_lengths(channel):
    assert not any(mistake(factor, channel) for factor in (0.1, 3.3, 0.3048))
    assert "degrees" in mistake(57.0, channel)


def test_angles_beyond_a_turn_are_no_radians():
    assert turned([still(phi=1.0, theta=-1.0)], {"phi", "theta"}) == ()
    (said,) = turned([still(phi=0.1, theta=-2.0)], {"phi", "theta"})
    assert said.startswith("theta reaches 2 rad")


def test_accelerometers_are_misplaced_beyond_their_error():
    assert misplaced(np.array([0.3, np.nan, 0.1]), np.array([0.2, np.nan, 0.01])) == ()
    (said,) = misplaced(np.array([0.3, np.nan, 0.1]), np.array([0.02, np.nan, 0.01]))
    assert "0.30 ± 0.02 m forward, 0.10 ± 0.01 m down of" in said


def test_gravity_tells_a_specific_force_upside_down():
    names = {"ax", "ay", "az", "phi", "theta"}
    assert against_gravity([still(ax=0.0, ay=0.0, az=-9.8, phi=0.0, theta=0.0)], names) == ()
    (said,) = against_gravity([still(ax=0.0, ay=0.0, az=9.8, phi=0.0, theta=0.0)], names)
    assert said.startswith("az is 9.8 m/s^2 in trim")
    assert said.endswith("opposite sign")


def test_a_force_that_gravity_does_not_make_is_told_without_a_factor():
    names = {"ax", "ay", "az", "phi", "theta"}
    (said,) = against_gravity([still(ax=0.0, ay=9.8, az=-9.8, phi=0.0, theta=0.0)], names)
    assert said.startswith(
        "ay is 9.8 m/s^2 in trim, but gravity would make it 0: look at its sign, unit"
    )


def test_trim_is_the_mean_of_all_where_nothing_rests_for_long_enough():
    names = {"ax", "ay", "az", "phi", "theta"}
    values = {name: np.zeros(200) for name in names} | {"az": np.full(200, -9.8)}
    values["az"][:10] = -4.0  # a fifth of a second
    assert against_gravity([Flight(0.02, 10, values)], names) == ()
    values["az"][:60] = -4.0
    (said,) = against_gravity([Flight(0.02, 60, values)], names)
    assert said.startswith("az is -4 m/s^2 in trim")


@pytest.mark.second
@pytest.mark.filterwarnings("ignore::casid.DataWarning")
def test_times_in_microseconds_are_told_without_a_record_of_no_name():
    record = flight(0, None, NOISE, (*RATES, *FORCES, *STATES))
    remarks = kinematic_check([replace(record, t=1e6 * record.t)]).remarks
    assert remarks
    assert not any(" in :" in said for said in remarks)


@pytest.mark.second
@pytest.mark.parametrize("name", [*RATES[:2], *ATTITUDES, *SPEEDS, *FORCES])
def test_a_sensor_dead_in_all_records_is_told_and_no_other_blamed(name):
    dead = [
        replace(each, y=np.where(np.array(each.outputs) == name, each.y[0], each.y))
        for each in flown(105, count=2)
    ]
    check = kinematic_check(dead)
    (said,) = check.remarks
    assert said.startswith(f"{name} stands still at ")
    assert name not in [each.channel for each in check.channels]


def test_what_rests_as_all_else_of_its_axis_does_is_not_dead():
    records = flown(106, outputs=("p", "q", "phi", "theta"), single=True, count=1)
    for name in ("q", "theta"):
        records = changed(records, name, lambda x: 0 * x)
    assert not any("stands still" in said for said in kinematic_check(records).remarks)
