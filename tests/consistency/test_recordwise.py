"""Clocks that differ from record to record, on flights of which it is known."""

from dataclasses import replace

import numpy as np
import pytest
from truths.flights import NOISE, RATES, flight

from benchmarks.kinematics import later, spoilt
from benchmarks.uh60 import SWEEPS, nonlinear_records
from casid.consistency.kinematics import kinematic_check
from casid.consistency.recordwise import differ

OUTPUTS = (*RATES, "phi", "theta", "psi")
ANGLES = OUTPUTS[3:]


def flown(clocks, outputs=OUTPUTS, late=ANGLES):
    """A record for each clock [s] by which ``late`` channels come late."""
    return [
        replace(flight(31 + k, dict.fromkeys(late, (0, 0, by)), NOISE, outputs), name=f"r{k}")
        for k, by in enumerate(clocks)
    ]


@pytest.mark.parametrize("clocks", [(0.1, -0.2, 0.15), (0.0, 0.0, 0.3), (0.0, 0.03)], ids=str)
@pytest.mark.slow
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


@pytest.mark.parametrize("clocks", [(0.0, 0.0, 0.0), (0.1, 0.1, 0.1)], ids=str)
@pytest.mark.slow
def test_one_clock_of_all_records_is_none_of_each(clocks):
    check = kinematic_check(flown(clocks))
    assert check.by_record == ()
    assert {*check.shifts} == ({*RATES} if any(clocks) else set())


@pytest.mark.slow
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
