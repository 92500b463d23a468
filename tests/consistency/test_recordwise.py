"""Clocks that differ from record to record, on flights of which it is known."""

from dataclasses import replace

import numpy as np
import pytest
from truths import bodies
from truths.flights import NOISE, RATES, flight

from benchmarks.kinematics import DATA, GOOD, INPUTS, later, spoilt
from benchmarks.uh60 import OUTPUTS as BARE
from benchmarks.uh60 import STEPS, SWEEPS, nonlinear_records
from casid import read_csv
from casid.consistency import recordwise
from casid.consistency.flightpath import reconstruct
from casid.consistency.kinematics import kinematic_check
from casid.consistency.measured import Flight
from casid.consistency.recordwise import clocks_by_record, differ, rescaled

OUTPUTS = (*RATES, "phi", "theta", "psi")
ANGLES = OUTPUTS[3:]
EQUATIONS = (*bodies.ANGLES, *bodies.SPEEDS)
HEADED = (*bodies.WHOLE, "psi")


def flown(clocks, outputs=OUTPUTS, late=ANGLES):
    """A record for each clock [s] by which ``late`` channels come late."""
    return [
        replace(flight(31 + k, dict.fromkeys(late, (0, 0, by)), NOISE, outputs), name=f"r{k}")
        for k, by in enumerate(clocks)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "clocks",
    [
        pytest.param((0.1, -0.2, 0.15), marks=pytest.mark.campaign),
        pytest.param((0.0, 0.0, 0.3), marks=pytest.mark.campaign),
        (0.0, 0.03),
    ],
    ids=str,
)
def test_clocks_that_differ_are_told_record_by_record_and_no_scale_is(clocks):
    check = kinematic_check(flown(clocks))
    (said,) = check.remarks
    assert check.by_record == (said,)
    assert (check.channels, check.shifts) == ((), {})
    told = said.split("late by ")[1].split(" s;")[0].split(", ")
    assert [each.split()[0] for each in told] == [f"r{k}" for k in range(len(clocks))]
    np.testing.assert_allclose(
        [float(each.split()[1]) for each in told], -np.array(clocks), atol=0.005
    )


@pytest.mark.repeats(1)
@pytest.mark.parametrize("clocks", [(0.0, 0.0, 0.0), (0.1, 0.1, 0.1)], ids=str)
@pytest.mark.slow
def test_one_clock_of_all_records_is_none_of_each(clocks):
    check = kinematic_check(flown(clocks))
    assert check.by_record == ()
    assert {*check.shifts} == ({*RATES} if any(clocks) else set())


@pytest.mark.campaign
@pytest.mark.parametrize("late", ["uvw", bodies.ANGLES], ids=["velocities", "attitudes"])
def test_of_two_groups_the_one_that_is_late_is_told(late):
    # Rates agree with attitudes once either moves, gravity in the specific forces once one does.
    clocks = (0.1, -0.2, 0.15)
    records = [
        replace(
            bodies.flown(6 + k, "slow", dict.fromkeys(late, by), HEADED, count=1)[0], name=f"r{k}"
        )
        for k, by in enumerate(clocks)
    ]
    (said,) = kinematic_check(records).by_record
    group, told = said.split("record: ")[1].split(" s;")[0].split(" are late by ")
    assert group == ("velocities" if late == "uvw" else "attitudes")
    np.testing.assert_allclose(
        [float(each.split()[1]) for each in told.split(", ")], clocks, atol=0.02
    )


def flights_of(records, outputs=HEADED):
    return [
        Flight(each.dt, 0, dict(zip(outputs, each.y.T, strict=True)), record=k)
        for k, each in enumerate(records)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "late", [pytest.param(each, marks=pytest.mark.campaign) for each in (0.2, 0.25)]
)
def test_clocks_that_leave_no_less_are_not_told_though_records_seem_to_differ(late, monkeypatch):
    records = bodies.flown(7, "slow", dict.fromkeys("uvw", late), HEADED, single=True)
    flights, labels = flights_of(records), {0: "r0", 1: "r1", 2: "r2"}
    monkeypatch.setattr(recordwise, "drawn_apart", lambda _: True)
    monkeypatch.setattr(recordwise, "differ", lambda *_: True)
    monkeypatch.setattr(recordwise, "rescaled", lambda *_: 0.0)
    together = reconstruct(flights, EQUATIONS)
    assert clocks_by_record(flights, EQUATIONS, together, labels) == ()


@pytest.mark.campaign
def test_a_scale_of_pitch_attitude_and_rate_is_no_clock():
    names = (*BARE, "u", "v", "w")
    rng = np.random.default_rng([1, 9])
    std = GOOD | {"az": 0.05} | dict.fromkeys("uvw", 0.15)
    whole = [read_csv(DATA / f"{k}.csv", inputs=INPUTS, outputs=names) for k in STEPS]
    scale = np.where(np.isin(names, ("q", "theta")), 1.1, 1.0)
    records = [replace(each, y=each.y * scale).with_noise(std, rng) for each in whole]
    check = kinematic_check(records)
    assert check.by_record == ()
    assert check.shifts == {}


@pytest.mark.campaign
def test_the_best_scale_explains_as_much_as_that_of_scales_tried_one_by_one():
    records = bodies.flown(8, "slow", outputs=HEADED, count=2)
    records = bodies.changed(records, "theta", lambda x: 1.07 * x)
    left = {}
    for factor in np.linspace(0.89, 1.0, 12):
        tried = flights_of(bodies.changed(records, "theta", lambda x, f=factor: f * x))
        found = reconstruct(tried, EQUATIONS)
        left[factor] = recordwise.unlikely(found, tried) - 2 * 2000 * np.log(factor)
    best = min(left, key=left.get)
    assert 1 / best == pytest.approx(1.07, abs=0.02)
    assert rescaled(flights_of(records), EQUATIONS) == pytest.approx(
        left[1.0] - left[best], rel=0.1
    )


@pytest.mark.campaign
def test_one_late_channel_that_records_tell_of_unlike_well_is_no_clock(monkeypatch):
    # Of sweeps: each moves rates of its own, whose skews against one late attitude differ. By
    # no more than noise: none is reconstructed by itself.
    monkeypatch.setattr("casid.consistency.recordwise.reconstruct_level", None)
    rng = np.random.default_rng([100, 3])
    records = [spoilt(later(each, "phi", 0.06), rng) for each in nonlinear_records(SWEEPS)]
    check = kinematic_check(records)
    assert check.by_record == ()
    (p,) = (each for each in check.channels if each.channel == "p")
    assert abs(p.skew + 0.06) < 0.005


def test_skews_differ_by_more_than_errors_and_what_matters():
    assert differ(np.array([0.1, -0.2, 0.15]), np.full(3, 0.01))
    assert not differ(np.array([0.1, -0.2, 0.15]), np.full(3, 0.2))
    assert not differ(np.array([0.0, 0.009]), np.full(2, 1e-5))
    # Two skews are different at the level of 1e-4 from 3.89 deviations of their difference on.
    error = np.sqrt(0.02**2 - (0.01 / 3) ** 2)
    assert differ(np.array([0.0, 3.9 * 0.02 * np.sqrt(2)]), np.full(2, error))
    assert not differ(np.array([0.0, 3.88 * 0.02 * np.sqrt(2)]), np.full(2, error))
