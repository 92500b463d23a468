"""One attitude or velocity that is late by itself, on flights of which it is known."""

import numpy as np
import pytest
from truths import bodies

from casid import kinematic_check
from casid.consistency.flightpath import reconstruct
from casid.consistency.measured import Flight

HEADED = (*bodies.WHOLE, "psi")


def flown(seed, regime="cruise", **late):
    """Records in each of which one axis moves, channels late by so much [s]."""
    return bodies.flown(seed, regime, late=late, outputs=HEADED, single=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("regime", "name", "lag"),
    [
        ("cruise", "phi", 0.08),  # p and a lever of -1.9 m were told
        # r, ay and a lever of 0.8 m
        pytest.param("slow", "psi", 0.08, marks=pytest.mark.campaign),
        # all attitudes, p, r and ay
        pytest.param("fast", "theta", 0.08, marks=pytest.mark.campaign),
        # ax
        pytest.param("cruise", "u", 0.3, marks=pytest.mark.campaign),
        # clocks of each record
        pytest.param("slow", "v", 0.1, marks=pytest.mark.campaign),
        # all velocities and ax
        pytest.param("fast", "w", -0.1, marks=pytest.mark.campaign),
    ],
)
def test_the_one_that_is_late_is_told_and_moves_alone(regime, name, lag):
    check = kinematic_check(flown(301, regime, **{name: lag}))
    (remark,) = check.remarks
    assert remark.startswith(f"{name} is ")
    assert {*check.shifts} == {name}
    late, error = check.apart.late[name]
    assert late == pytest.approx(lag, abs=4 * error)
    assert error < 0.012
    mates = bodies.SPEEDS if name in bodies.SPEEDS else bodies.ANGLES
    assert all(other in remark for other in mates if other != name)
    assert not (np.abs(check.place) > 4 * np.array(check.place_error)).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    "late",
    [
        pytest.param({"p": 0.08}, marks=pytest.mark.campaign),
        pytest.param({"az": 0.08}, marks=pytest.mark.campaign),
        pytest.param(dict.fromkeys("uvw", 0.1), marks=pytest.mark.campaign),
    ],
    ids=str,
)
def test_what_a_rate_a_force_or_all_velocities_explain_is_laid_to_no_single_one(late):
    check = kinematic_check(flown(302, **late))
    assert len(check.remarks) == 1
    assert {*check.shifts} == {*late}
    np.testing.assert_allclose(
        [*check.shifts.values()], [-each for each in late.values()], atol=0.02
    )


@pytest.mark.second
@pytest.mark.parametrize("name", ["phi", "v"])
def test_a_clock_of_its_own_has_its_lag_and_error(name):
    records = flown(303, **{name: 0.06})
    flights = [
        Flight(r.dt, 0, dict(zip(HEADED, r.y.T, strict=True)), record=k)
        for k, r in enumerate(records)
    ]
    found = reconstruct(flights, (*bodies.ANGLES, *bodies.SPEEDS), alone=name)
    late, error = found.clocks[-1], np.sqrt(found.covariance[-1, -1])
    assert abs(late - 0.06) < 3.5 * error
    assert error < 0.02  # it is told, by three errors
