"""Clocks that run apart: told by how much, set right, and nowhere else found."""

from dataclasses import replace

import numpy as np
import pytest
from truths.flights import FORCES, NOISE, RATES, flight, truth

from casid import kinematic_check
from casid.consistency.attitude_clocks import reconstruct_level
from casid.consistency.drifts import Drifts, _Clocks, without_drifts
from casid.consistency.innovations import growing, integral
from casid.consistency.measured import Flight

ATTITUDES, VELOCITIES = ("phi", "theta", "psi"), ("u", "v", "w")
ANGLES = (*RATES, "phi", "theta")
WHOLE = (*RATES, *FORCES, *ATTITUDES, *VELOCITIES)


def drifting(seed, drift, outputs=WHOLE, begin=0.0, noise=1.0):
    """A record some of whose channels are later by ``begin`` and from then on ``drift`` [s/s]."""
    level = {name: noise * std for name, std in NOISE.items()}
    record, (signals, t) = flight(seed, None, level, outputs), truth(seed)
    now = signals(t)
    y = record.y.copy()
    for i, name in enumerate(outputs):
        if name in drift:
            y[:, i] += signals(t - begin - drift[name] * t)[name] - now[name]
    return replace(record, y=y)


@pytest.mark.repeats(2)
@pytest.mark.second
@pytest.mark.parametrize(
    ("who", "outputs"),
    [(ATTITUDES, ANGLES), (("p",), ANGLES), (ATTITUDES, WHOLE), ((*ATTITUDES, *VELOCITIES), WHOLE)],
    ids=["attitudes", "one gyro", "attitudes of all", "navigation"],
)
@pytest.mark.parametrize("ppm", [1000, -1000])
def test_a_drift_is_told_and_nothing_else(who, outputs, ppm):
    seed = 3 if outputs is WHOLE else 1  # where velocities move enough to tell theirs in 40 s
    check = kinematic_check(drifting(seed, dict.fromkeys(who, 1e-6 * ppm), outputs))
    (said,) = check.remarks
    assert " drift" in said
    assert {*check.drifts.late} == {*who} & {*outputs}
    for late, error in check.drifts.late.values():
        assert abs(late - 1e-6 * ppm) < 3 * error < 6e-4


@pytest.mark.second
@pytest.mark.parametrize(
    ("seed", "begin", "ppm", "noise"), [(1, 0.2, 4000, 1.0), (3, 0.0, 3000, 3.0)], ids=str
)
def test_a_large_drift_hides_neither_behind_a_lag_nor_behind_what_it_makes_of_the_noise(
    seed, begin, ppm, noise
):
    record = drifting(seed, dict.fromkeys(ATTITUDES, 1e-6 * ppm), ANGLES, begin, noise)
    check = kinematic_check(record)
    assert {*check.drifts.late} == {"phi", "theta"}
    late, error = check.drifts.late["phi"]
    assert abs(late - 1e-6 * ppm) < 3 * error < 1e-3
    for each in check.channels[:2]:
        assert abs(each.skew + begin) < 3 * each.skew_error < 0.025


@pytest.mark.parametrize(
    ("late", "error", "told"),
    [(0.009, 1e-4, False), (0.011, 1e-4, True), (0.035, 0.008, False), (0.037, 0.008, True),
     (0.17, 0.02, False), (0.19, 0.02, True)],
)  # fmt: skip
def test_a_drift_is_sure_by_four_and_a_half_errors_and_more_of_those_that_are_rough(
    late, error, told
):
    clocks = _Clocks.__new__(_Clocks)
    clocks.duration, clocks.names = 60.0, [("p",), ("phi", "theta")]
    clocks.late, clocks.covariance = np.zeros(2), np.diag([error**2, 0.0])
    sure = clocks.sure(Drifts(late={"p": (late / 60, np.nan)}, duration=60.0))
    assert [*sure.late.values()] == ([pytest.approx((late / 60, error / 60))] if told else [])


@pytest.mark.second
def test_what_was_tried_and_is_not_sure_is_not_set_right(monkeypatch):
    record = drifting(1, {"p": 1e-3}, ANGLES)
    flight = Flight(record.dt, 0, dict(zip(ANGLES, record.y.T, strict=True)))
    equations = ("phi", "theta")
    # 8 ms of q within 40 s are less than what matters.
    found, rounds = reconstruct_level([flight], equations), iter([{"p": 1e-3, "q": 2e-4}, {}])
    monkeypatch.setattr(_Clocks, "drifting", lambda *_: next(rounds))
    (right,), now, drifts = without_drifts([flight], equations, found)
    assert {*drifts.late} == {"p"}
    np.testing.assert_array_equal(right.values["q"], flight.values["q"])
    expected = reconstruct_level([right], equations)
    np.testing.assert_array_equal(now.unknowns, expected.unknowns)


@pytest.mark.second
def test_scales_biases_and_skews_are_those_of_clocks_that_were_set_right():
    record = drifting(2, dict.fromkeys(("phi", "theta"), 1e-3), ANGLES, begin=0.06)
    factor = np.where(np.array(record.outputs) == "p", 1.08, 1.0)
    check = kinematic_check(replace(record, y=factor * record.y))
    p, q, _ = check.channels
    assert abs(p.scale - 0.08) < 3 * p.scale_error < 0.02
    for each in (p, q):
        assert abs(each.skew + 0.06) < 3 * each.skew_error < 0.02
    mended = record.shift(check.shifts, drift=check.drifts.remedy)
    assert not kinematic_check(mended).drifts.late
    assert not any("late" in said or "early" in said for said in kinematic_check(mended).remarks)


def seen_without(record, lost, name=None):
    """The record without its rows in ``lost`` [s], or without the samples of one channel there."""
    gone = (record.t > lost[0]) & (record.t < lost[1])
    if name is None:
        return record.take(~gone)
    return record.mask(gone[:, None] & (np.array(record.outputs) == name))


@pytest.mark.repeats(1)
@pytest.mark.parametrize("lost", [(15.0, 19.0), (24.0, 27.0)])
@pytest.mark.parametrize("seed", [3, pytest.param(5, marks=pytest.mark.campaign)])
@pytest.mark.slow
def test_a_drift_is_told_across_a_gap_as_well_as_without(seed, lost):
    whole = drifting(seed, dict.fromkeys(ATTITUDES, 1e-3), begin=0.05)
    (one, error), (other, wider) = (
        kinematic_check(each).drifts.late["phi"] for each in (whole, seen_without(whole, lost))
    )
    assert abs(other - 1e-3) < 3 * wider
    assert abs(other - one) < error
    assert wider < 1.3 * error  # a tenth of the record is lost


@pytest.mark.repeats(1)
@pytest.mark.parametrize(("lost", "name"), [((-1.0, 7.0), "p"), ((15.0, 19.0), "p"),
                                            ((36.0, 99.0), "phi")])  # fmt: skip
@pytest.mark.parametrize(
    "outputs", [ANGLES, pytest.param(WHOLE, marks=pytest.mark.campaign)], ids=len
)
@pytest.mark.slow
def test_what_a_channel_did_while_it_was_lost_for_seconds_is_not_made_up(outputs, lost, name):
    sound = seen_without(flight(3, None, NOISE, outputs), lost, name)
    assert kinematic_check(sound).remarks == ()
    drift = drifting(3, dict.fromkeys(ATTITUDES, 1e-3), outputs, begin=0.05)
    found = kinematic_check(seen_without(drift, lost, name))
    assert {*found.drifts.late} == {*ATTITUDES} & {*outputs}
    late, error = found.drifts.late["phi"]
    assert abs(late - 1e-3) < 3 * error < 4e-4


@pytest.mark.second
def test_a_delay_that_stays_is_no_drift():
    check = kinematic_check(drifting(3, dict.fromkeys(ATTITUDES, 0.0), ANGLES, begin=0.06))
    assert check.drifts.late == {}
    np.testing.assert_allclose([*check.shifts.values()], 0.06, atol=0.012)


def test_what_grows_is_integrated_by_parts():
    t = 0.02 * np.arange(400)
    slope = np.cos(2 * t)
    (found,) = growing(integral(slope[:, None], 0.02).T, 0.02, -t[-1] / 2)
    middle = t[-1] / 2
    exact = (t - middle) * np.sin(2 * t) / 2 + (np.cos(2 * t) - 1) / 4
    np.testing.assert_allclose(found, exact, atol=2e-5)  # fourth order inside, less at the ends


@pytest.mark.campaign
@pytest.mark.parametrize("outputs", [ANGLES, WHOLE], ids=len)
def test_drifts_scatter_by_their_standard_errors(outputs):
    drift = dict.fromkeys(ATTITUDES, 1e-3)
    late, error = np.transpose(
        [kinematic_check(drifting(k, drift, outputs)).drifts.late["phi"] for k in range(12)]
    )
    z = (late - 1e-3) / error
    # The root mean square of 12 normal values lies within 0.5 and 1.6 with p > 0.99.
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(z).max() < 4
