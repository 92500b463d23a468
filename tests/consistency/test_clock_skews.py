"""Which of several clocks is odd, on flights of which it is known."""

import numpy as np
import pytest
from truths import bodies
from truths.flights import FORCES, NOISE, RATES, STATES, flight

from casid import Record
from casid.consistency.alignment import aligned
from casid.consistency.clock_skews import Apart
from casid.consistency.kinematics import kinematic_check

ATTITUDES, VELOCITIES = STATES[:3], STATES[3:]


def late(names, lag, seed=21):
    """A flight at 40 m/s, its accelerometers at the centre of gravity, channels so much late."""
    return flight(seed, dict.fromkeys(names, (0.0, 0.0, lag)), NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.05, pytest.param(0.2, marks=pytest.mark.campaign)])
@pytest.mark.parametrize(
    "names",
    [pytest.param(VELOCITIES, marks=pytest.mark.campaign), ATTITUDES],
    ids=["velocities", "attitudes"],
)
def test_what_is_late_by_itself_is_told_and_moves_alone(names, lag):
    record = late(names, lag)
    check = kinematic_check(record)
    assert check.apart.names == names
    found, error = check.apart.late[names[0]]
    assert found == pytest.approx(lag, abs=4 * error)
    assert error < 0.01
    (remark,) = check.remarks
    assert remark.startswith(f"{' '.join(names)} are ")
    assert " s late against rates, specific forces and " in remark
    assert {*check.shifts} == {*names}
    moves, _ = aligned(check, record.outputs, (), ["lat"])
    assert moves == check.shifts
    assert kinematic_check(record.shift(moves)).consistent


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [pytest.param(VELOCITIES, marks=pytest.mark.campaign), ATTITUDES],
    ids=["velocities", "attitudes"],
)
def test_a_late_reference_is_no_place_of_accelerometers(names):
    # At 40 m/s velocities 0.1 s late read as a lever of -4 m where only forces are delayed.
    check = kinematic_check(late(names, 0.1))
    assert np.abs(np.array(check.place) / check.place_error).max() < 4
    assert max(check.place_error) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "lag"),
    [
        ((*bodies.ATTITUDES, *VELOCITIES), 0.06),
        pytest.param(bodies.ATTITUDES, -0.06, marks=pytest.mark.campaign),
        pytest.param(VELOCITIES, -0.06, marks=pytest.mark.campaign),
        pytest.param(bodies.ATTITUDES, 0.06, marks=pytest.mark.campaign),
    ],
    ids=str,
)
def test_one_source_that_is_late_or_early_is_named_whole_and_alone(names, lag):
    check = kinematic_check(bodies.flown(105, late=dict.fromkeys(names, lag)))
    assert check.apart.names == names
    (remark,) = check.remarks
    assert f" s {'late' if lag > 0 else 'early'} against rates" in remark
    np.testing.assert_allclose([*check.shifts.values()], -lag, atol=0.005)


HEADED = (*bodies.WHOLE, "psi")


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.06, pytest.param(-0.06, marks=pytest.mark.campaign)])
@pytest.mark.parametrize(
    "names",
    [
        pytest.param(("phi", "theta"), marks=pytest.mark.campaign),
        pytest.param(("psi",), marks=pytest.mark.campaign),
        pytest.param(("phi",), marks=pytest.mark.campaign),
        pytest.param(("theta",), marks=pytest.mark.campaign),
    ],
    ids="-".join,
)
def test_attitudes_of_one_source_late_beside_others_are_named_and_no_rate_is(names, lag):
    records = bodies.dirty(bodies.flown(106, late=dict.fromkeys(names, lag), outputs=HEADED), 106)
    check = kinematic_check(records)
    assert check.apart.names == names
    assert {*check.shifts} == {*names}
    np.testing.assert_allclose([*check.shifts.values()], -lag, atol=0.012)  # ψ: to some 5 ms
    (remark,) = check.remarks
    rest = [each for each in ("phi", "theta", "psi") if each not in names]
    assert f"against rates, specific forces, {', '.join(rest)} and velocities" in remark


@pytest.mark.campaign
def test_a_late_heading_spoils_no_skew_of_a_rate():
    z = []
    for seed in range(2):
        records = bodies.flown(120 + seed, late={"psi": 0.06}, outputs=HEADED, noise=0.3)
        for each in kinematic_check(records).channels[:3]:
            true = -0.06 if each.channel == "r" else 0.0
            z.append((each.skew - true) / each.skew_error)
    assert np.abs(z).max() < 3.5  # six normal values: exceeded once in 360


@pytest.mark.campaign
def test_forces_late_beside_late_velocities_are_told_against_the_others():
    check = kinematic_check(late((*VELOCITIES, *FORCES), 0.1))
    assert check.apart.names == VELOCITIES
    assert {*check.shifts} == {*VELOCITIES, *FORCES}
    np.testing.assert_allclose([*check.shifts.values()], -0.1, atol=0.02)
    assert sum("once these have moved" in each for each in check.remarks) == 3


@pytest.mark.second
@pytest.mark.parametrize(
    "names",
    [
        *(pytest.param(each, marks=pytest.mark.campaign) for each in (RATES, FORCES)),
        (*RATES, *FORCES),
    ],
    ids=str,
)
def test_nothing_stands_apart_where_rates_or_forces_are_late(names):
    check = kinematic_check(late(names, 0.1))
    assert check.apart.names == ()
    assert {*check.shifts} == {*names}
    np.testing.assert_allclose([*check.shifts.values()], -0.1, atol=0.02)


def in_steps(hold, late=0, dt=0.04, seed=5):
    """Level flight in which az jumps with held inputs and w integrates it exactly; az late by rows.

    Between samples az is what it was at the first: w gains that times dt.
    """
    rng = np.random.default_rng([79, seed])
    stick = np.repeat(rng.uniform(-1.0, 1.0, 150), 10)
    w = dt * np.concatenate([[0.0], np.cumsum(stick)[:-1]])
    flown = {"az": np.roll(stick, late) - 9.80665, "w": w - w.mean(), "u": np.full(len(w), 20.0)}
    y = [
        flown.get(name, np.zeros(len(w))) + 0.2 * bodies.NOISE[name] * rng.standard_normal(len(w))
        for name in (*bodies.WHOLE, "psi")
    ]
    t, names = dt * np.arange(len(w)), (*bodies.WHOLE, "psi")
    return Record(t, stick[:, None], np.column_stack(y), ("col",), names, hold=hold)


@pytest.mark.campaign
def test_a_force_that_follows_held_inputs_at_once_is_half_a_sample_early_and_not_skewed():
    check = kinematic_check(in_steps("zoh"))
    (az,) = (each for each in check.channels if each.channel == "az")
    assert az.skew == pytest.approx(-0.02, abs=4 * az.skew_error)
    assert az.skew_error < 0.004
    assert check.remarks == ()
    assert check.shifts == {}
    assert kinematic_check(in_steps("foh")).shifts
    late = kinematic_check(in_steps("zoh", late=2))
    # Two samples less what steps make up for: az is late or w early, as nothing else moves.
    assert {*late.shifts} in ({"az"}, {*VELOCITIES})
    assert all(0.055 < abs(lag) < 0.085 for lag in late.shifts.values())


def test_nothing_apart_says_nothing():
    assert Apart().told() == ()
