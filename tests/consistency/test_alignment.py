"""Which channels move in time, by flights of which it is known which were late."""

import numpy as np
import pytest
from truths.flights import FORCES, NOISE, RATES, flight

from casid import Record
from casid.consistency.alignment import _fewer, aligned, moves_told
from casid.consistency.clock_skews import Apart
from casid.consistency.comparisons import ChannelCheck
from casid.consistency.instruments import OWN
from casid.consistency.kinematics import KinematicCheck, kinematic_check

OUTPUTS = (*RATES, *FORCES, "phi", "theta")


@pytest.fixture(scope="module")
def check():
    late = {"phi": (0.0, 0.0, 0.1), "theta": (0.0, 0.0, 0.1)}
    return kinematic_check(flight(0, late, NOISE, OUTPUTS))


@pytest.mark.second
def test_the_fewer_move_and_stay_in_the_order_of_the_record(check):
    moves, (why,) = aligned(check, OUTPUTS, (), ["lat"])
    assert list(moves) == ["phi", "theta"]
    np.testing.assert_allclose(list(moves.values()), -0.1, atol=0.005)
    assert why == "p, q, r, ax, ay, az are assumed to share one clock, and stay with the inputs"
    assert moves_told(moves).startswith("phi -")
    assert "inputs stay" in moves_told(moves)


def test_rates_that_seem_early_stay_and_their_attitudes_move(check):
    outputs = ("p", "q", "phi", "theta")
    moves, _ = aligned(check, outputs, (), ["lat"])
    assert list(moves) == ["phi", "theta"]  # which were late
    np.testing.assert_allclose(list(moves.values()), -0.1, atol=0.005)


def seen(left, late=None, against=()):
    """A check that found rates and forces late by so much, and attitudes by themselves."""
    channels = [
        ChannelCheck(
            channel=name, unit="", against=(OWN[name],), scale=0.0, scale_error=0.01, skew=by,
            skew_error=error, bias=0.0, bias_error=0.0,
        )
        for name, (by, error) in left.items()
    ]  # fmt: skip
    apart = Apart(late=late or {}, against=against, left=left)
    return KinematicCheck(channels=tuple(channels), residuals={}, apart=apart)


EARLY = dict.fromkeys("pqr", (-0.03, 0.0005))
ALL = (*RATES, *FORCES, "phi", "theta", "psi", "u", "v", "w")


@pytest.mark.parametrize(
    "forces",
    [{}, {"az": (0.008, 0.005)}, {"ay": (0.017, 0.019), "az": (0.005, 0.005)}],
    ids=str,
)
def test_of_one_sensor_no_rates_are_early_without_its_forces(forces):
    moves, _ = aligned(seen(EARLY | forces), ALL, (), ["lat"])
    assert moves == pytest.approx(dict.fromkeys(("phi", "theta", "psi"), -0.03))


def test_rates_that_are_late_move_as_a_filter_delays_them():
    late = dict.fromkeys(RATES, (0.03, 0.0005)) | {"az": (0.0, 0.002)}
    moves, why = aligned(seen(late), ALL, (), ["lat"])
    assert moves == pytest.approx(dict.fromkeys(RATES, -0.03))
    assert "az not" in why[-1]


def test_attitudes_of_one_source_move_together_unless_some_are_known_to_be_elsewhere():
    late, rest = {"phi": (0.03, 0.001)}, ("rates", "specific forces", "velocities")
    moves, (why, *_) = aligned(seen({}, late, rest), ALL, (), ["lat"])
    assert moves == dict.fromkeys(("phi", "theta", "psi"), -0.03)
    assert why == "theta, psi: assumed to share the clock of the others that move"
    apart = aligned(seen({}, late, (*rest, "theta", "psi")), ALL, (), ["lat"])[0]
    assert apart == {"phi": -0.03}
    assert aligned(seen({}, late, rest), ("phi", "p"), ("theta",), ["lat"])[0] == {"phi": -0.03}
    both = late | {"theta": (0.05, 0.001)}  # of two loggers, each late by itself
    moves, _ = aligned(seen({}, both, rest), ("phi", "p"), ("theta",), ["lat"])
    assert moves == {"phi": -0.03, "theta": -0.05}


def test_the_logger_without_inputs_moves_as_a_whole(check):
    first, second = ("p", "q"), ("phi", "theta", "psi")
    moves, why = aligned(check, first, second, ["lat"])
    assert list(moves) == list(second)
    assert why[0] == "psi: assumed to share the clock of the others that move"
    np.testing.assert_allclose(list(moves.values()), -0.1, atol=0.005)
    assert list(aligned(check, first, (*second, "lat"), ["lat"])[0]) == list(first)


@pytest.mark.second
def test_records_in_line_stay_as_they_are():
    fine = kinematic_check(flight(1, None, NOISE, OUTPUTS))
    moves, why = aligned(fine, OUTPUTS, (), ["lat"])
    assert (moves, why, moves_told(moves)) == ({}, (), "none")


@pytest.mark.second
def test_pitch_attitude_that_was_not_recorded_is_told_or_widens_the_errors():
    """phi' = p + r tan(theta), integrated by itself."""
    rng, tilt = np.random.default_rng(5), 0.06
    t = 0.02 * np.arange(2000)
    p, r = 0.2 * np.sin(1.3 * t) * np.sin(0.2 * t), 0.3 * np.sin(0.7 * t + 0.4 * np.sin(0.11 * t))
    rate = p + np.tan(tilt) * r
    phi = np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) * 0.01))
    late = np.interp(t - 0.1, t, phi)
    y = np.column_stack([p, r, late]) + 0.001 * rng.standard_normal((len(t), 3))
    record = Record(t, np.zeros((len(t), 1)), y, ["lat"], ["p", "r", "phi"], "roll")
    plain = kinematic_check(record).channels[0]
    given = kinematic_check(record, trim={"theta0": tilt}).channels[0]
    assert given.skew == pytest.approx(-0.1, abs=4 * given.skew_error)
    assert plain.skew == pytest.approx(-0.1, abs=4 * plain.skew_error)
    # The record tells of it, as r turns otherwise than p, but at the cost of both.
    assert plain.skew_error > given.skew_error
    assert plain.scale_error > 2 * given.scale_error


def test_another_logger_moves_only_if_all_rates_are_late_by_as_much():
    check, second = KinematicCheck(channels=(), residuals={}), ("phi", "theta")
    first = ("p", "q", "r")
    assert _fewer(check, dict.fromkeys(first, 0.1), first, second) == second
    assert _fewer(check, {"p": 0.1, "q": 0.1}, first, second) == ()
    assert _fewer(check, {"p": 0.1, "q": 0.1, "r": 0.2}, first, second) == ()
