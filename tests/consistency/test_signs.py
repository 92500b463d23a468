"""One channel upside down, on flights of a rigid body: it is named, and no other."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from truths.bodies import (
    BARE,
    FORCES,
    SPEEDS,
    WHOLE,
    changed,
    dirty,
    flown,
    reversed_in,
)

from casid.consistency.kinematics import kinematic_check
from casid.consistency.signs import _Guess, _misread


def named(said, name):
    """Whether a remark says that this channel has the opposite sign, and no other is blamed."""
    own = said.startswith(f"{name} is ") and said.endswith(": it has the opposite sign")
    return own or said.startswith(f"{name} has the opposite sign")


DIRTY = ("u",)  # of which CI looks at dirty records
CLEAN = ("psi", "az")  # and at clean ones


def campaigns(names, but):
    return [x if x in but else pytest.param(x, marks=pytest.mark.campaign) for x in names]


@pytest.mark.slow
@pytest.mark.parametrize("name", campaigns(WHOLE, CLEAN))
def test_one_channel_upside_down_is_named_and_no_other(name):
    (said,) = kinematic_check(reversed_in(flown(100, count=2), name)).remarks
    assert named(said, name)


@pytest.mark.second
@pytest.mark.parametrize("name", BARE)
def test_it_is_named_without_velocities_where_records_move_single_axes(name):
    (said,) = kinematic_check(reversed_in(flown(100, outputs=BARE, single=True), name)).remarks
    assert named(said, name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "regime",
    ["slow", *(pytest.param(each, marks=pytest.mark.campaign) for each in ("hover", "fast"))],
)
@pytest.mark.parametrize("name", campaigns(WHOLE, DIRTY))
def test_dirty_records_of_any_speed_name_it_too(name, regime):
    (said,) = kinematic_check(dirty(reversed_in(flown(101, regime), name), 101)).remarks
    assert named(said, name)


@pytest.mark.parametrize("late", [{}, {"p": 0.06}], ids=["alone", "beside a late rate"])
@pytest.mark.campaign
def test_other_mistakes_are_told_as_of_the_channel_set_upright(late):
    records = reversed_in(flown(102, late=late), "theta")
    check = kinematic_check(changed(records, "q", lambda q: 1.2 * q))
    said = {each.split()[0]: each for each in check.remarks}
    assert {*said} == {"theta", "q", *late}
    assert "opposite sign" in said["theta"]
    assert said["q"].startswith("q is 1.2")
    assert {*check.shifts} == {*late}


@pytest.mark.second
def test_without_velocities_and_turns_bank_and_roll_rate_cannot_be_told_apart():
    records = reversed_in(flown(103, outputs=("p", "phi")), "phi")
    (said,) = kinematic_check(records).remarks
    assert said.endswith("it or phi has the opposite sign")


@pytest.mark.campaign
def test_a_flow_angle_upside_down_is_named_and_not_the_velocity_made_of_it():
    records = flown(104)
    found = []
    for each in records:
        u, v, w = (each.channel(name) for name in SPEEDS)
        V = np.sqrt(u**2 + v**2 + w**2)
        air = np.column_stack([V, np.arctan2(w, u), -np.arcsin(v / V)])
        bare = each.select(outputs=BARE)
        more = type(each)(each.t, each.u[:, :0], air, (), ("V", "alpha", "beta"), each.name)
        found.append(bare.join(more))
    (said,) = kinematic_check(found).remarks
    assert said.startswith("beta has the opposite sign")


@pytest.mark.campaign
@pytest.mark.parametrize("spoil", [lambda records, _: records, dirty], ids=["clean", "dirty"])
def test_forty_campaigns_of_good_instruments_hardly_raise_an_alarm(spoil):
    alarms = [
        (seed, regime, said)
        for seed in range(200, 240)
        for regime in ("hover", "cruise")
        for said in kinematic_check(spoil(flown(seed, regime), seed)).remarks
    ]
    # Some twenty tests each at four standard errors: of 80 campaigns one in ten has an alarm.
    assert len(alarms) <= 1, alarms


@pytest.mark.slow
@pytest.mark.parametrize("regime", campaigns(["slow", "cruise"], ["cruise"]))
@pytest.mark.parametrize(
    ("unit", "size"),
    [
        pytest.param("ft/s", 0.3048, marks=pytest.mark.campaign),
        pytest.param("knots", 0.514444, marks=pytest.mark.campaign),
        ("km/h", 1 / 3.6),
    ],
)
def test_velocities_of_another_unit_are_told_and_nothing_else(unit, size, regime):
    records = flown(110, regime, count=2)
    for name in SPEEDS:
        records = changed(records, name, lambda x: x / size)
    (said,) = kinematic_check(records).remarks
    assert said.startswith(f"u v w: in {unit}, not m/s?")


@pytest.mark.campaign
def test_accelerometers_of_another_unit_leave_velocities_theirs():
    records = flown(111, count=2)
    for name in FORCES:
        records = changed(records, name, lambda x: x / 9.80665)
    remarks = kinematic_check(records).remarks
    assert all(said.endswith("it seems to be in g") for said in remarks)


@pytest.mark.campaign
def test_a_column_read_twice_is_doubted_in_words():
    twice = [
        each.select(outputs=[name for name in each.outputs if name != "v"]).join(
            replace(each.select((), ("u",)), outputs=("v",))
        )
        for each in flown(112, count=2)
    ]
    assert kinematic_check(twice).remarks


def test_gains_and_biases_that_no_instrument_has_are_mistakes():
    def found(gain=1.0, error=0.01, bias=0.0):
        names = ("p", "ax", "az")
        unknowns = np.array([[1.0, 0.0], [1.0, 0.0], [gain, 0.0]])
        return SimpleNamespace(
            channels=names, unknowns=unknowns, errors=np.full((3, 2), error),
            biases=np.array([[30.0, 0.0, 0.0], [0.0, 0.0, bias]]),
        )  # fmt: skip

    assert _misread(found()) == _misread(found(gain=1.15)) == _misread(found(gain=-1.0)) == 0
    assert (
        _misread(found(gain=0.5)) == _misread(found(gain=1.5)) == _misread(found(bias=-12.0)) == 1
    )
    assert _misread(found(gain=0.5, error=0.2)) == 0
    assert _Guess([], found(gain=0.5), unit="knots").mistakes(()) == 2
    assert _Guess([], found(gain=-1.0)).mistakes(()) == 1
