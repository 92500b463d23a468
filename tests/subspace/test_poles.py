"""Laguerre poles by the bandwidths of signals that are known."""

import numpy as np
import pytest
from truths.systems import campaign
from truths.uh60 import sweeps

from casid import Record, select_order
from casid.records import standard_deviations
from casid.subspace.columns import gather, output_bandwidth
from casid.subspace.laguerre import support
from casid.subspace.poles import COST, PASTS, clear_bandwidth, usable_poles


def test_kernels_cost_at_most_a_quarter_of_a_16_s_record_and_the_loss_is_reported():
    t = np.arange(0, 16.0, 0.02)
    poles = (6.0, 8.0, 10.0, 14.0)
    fit = [(a, p) for a in poles for p in PASTS if support(a, p) <= COST * t[-1]]
    assert fit  # there is a choice
    rng = np.random.default_rng(0)
    record = Record(t, rng.standard_normal((800, 1)), rng.standard_normal((800, 1)), ("u",), ("y",))
    su, sy = standard_deviations([record])
    for a, past in fit:
        _, (segment,) = gather([record], su, sy, past, a)
        assert segment.duration - segment.used <= 0.25 * segment.duration + 0.02
        assert segment.duration - segment.used == pytest.approx(support(a, past), abs=0.03)


def test_records_that_suit_no_pole_are_refused():
    slow = campaign(records=1)[0].take(slice(None, None, 50))  # every second: 0.5 π rad/s at most
    with pytest.raises(ValueError, match="suit no Laguerre pole"):
        select_order([slow])


def test_poles_are_somewhat_faster_than_the_outputs_move():
    assert usable_poles(sweeps(seed=1)) == [6.0, 8.0, 10.0, 14.0]
    t = np.arange(0, 60.0, 0.02)
    rng = np.random.default_rng(0)
    slow, fast = np.sin(1.0 * t), np.sin(5.0 * t)  # powers 1 and 2: 90 % is with the fast one
    y = np.column_stack([slow + 1.5 * fast, 2 * fast + slow, rng.standard_normal(len(t))])
    y[100:110, :2] = np.nan
    u = rng.standard_normal((len(t), 1))
    records = [Record(t, u, y, ("u",), ("a", "b", "noise"))]
    assert output_bandwidth(records) == pytest.approx(5.0, rel=0.05)
    assert usable_poles(records) == [8.0, 10.0, 14.0]


def test_poles_keep_to_what_is_sampled_and_to_what_fits_the_record():
    t = np.arange(0, 60.0, 0.02)
    u = np.random.default_rng(0).standard_normal((len(t), 1))
    for omega in (0.01, 140.0):  # outputs that drift, outputs that are vibration
        poles = usable_poles([Record(t, u, np.sin(omega * t)[:, None], ("u",), ("y",))])
        assert len(poles) >= 3
        assert all(a <= 0.5 * np.pi / 0.02 for a in poles)
        assert all(support(a, min(PASTS)) <= COST * t[-1] for a in poles)


def test_noise_of_most_outputs_is_no_bandwidth_of_theirs_unless_inputs_make_it():
    t, rng = np.arange(0, 60.0, 0.02), np.random.default_rng(0)
    motion = np.sin(1.0 * t) + 1.5 * np.sin(5.0 * t)
    noise = rng.standard_normal((len(t), 3))
    y = motion[:, None] * [1.0, 1.0, 0.5] + noise
    # Of powers 1.6 of motion and 1 of noise, 10 % are the upper 26 % of the noise's frequencies.
    for u, bandwidth, noisy in ((motion, 5.0, True), (noise.sum(axis=1), 116.0, False)):
        records = [Record(t, u[:, None], y, ("u",), ("a", "b", "c"))]
        found = clear_bandwidth(records)
        assert found == (pytest.approx(bandwidth, rel=0.1), noisy)
    quiet = [Record(t, motion[:, None], y - 0.8 * noise, ("u",), ("a", "b", "c"))]
    assert clear_bandwidth(quiet) == (output_bandwidth(quiet), False)
