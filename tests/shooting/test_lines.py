"""Transforms of whole records."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign

from casid import Record, output_error
from casid.intersample import delayed_input
from casid.shooting.lines import transformed

CLEAN = campaign()


def test_a_record_that_is_not_sampled_evenly_is_refused():
    t = CLEAN[0].t + 0.005 * np.sin(np.arange(600))
    record = Record(t, CLEAN[0].u, CLEAN[0].y, CLEAN[0].inputs, CLEAN[0].outputs, "uneven")
    with pytest.raises(ValueError, match="'uneven' is not sampled evenly"):
        output_error(TRUTH, record, domain="frequency")


@pytest.mark.parametrize("N", [600, 599])
def test_lines_hold_the_power_about_the_mean(N):
    record = CLEAN[0].take(slice(0, N))
    (lines,) = transformed([record])
    power = lines.weight @ np.abs(lines.Y) ** 2
    np.testing.assert_allclose(power, N * np.var(record.y, axis=0), rtol=1e-12)


def test_records_alike_in_length_and_sampling_are_of_one_kind():
    long = replace(CLEAN[0], t=2 * CLEAN[0].t)
    records = [long, CLEAN[1], CLEAN[2].take(slice(0, 450)), CLEAN[2].take(slice(0, 200))]
    kinds = [each.kind for each in transformed(records)]
    assert kinds[1] == kinds[2]
    assert len(set(kinds)) == 3


def test_a_channel_that_lost_much_is_refused_and_one_that_a_record_lacks_is_not():
    t, y = 0.1 * np.arange(100), np.random.default_rng(0).standard_normal((100, 2))
    y[:, 1] = np.nan
    lacking = Record(t, np.zeros((100, 1)), y, ("u",), ("p", "r"), "one")
    assert not transformed([lacking])[0].Y[:, 1].any()
    y[::10, 1] = 0.0
    with pytest.raises(ValueError, match="'one': 90% of the samples of 'r' are missing"):
        transformed([replace(lacking, y=y)])


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("jitter", [0.0, 1e-4])
def test_delayed_inputs_on_lines_are_the_transforms_of_each_delay(hold, jitter):
    h, rng = 0.05, np.random.default_rng(2)
    t = h * (np.arange(101) + jitter * rng.random(101))
    u, nu = rng.standard_normal((101, 2)), 2
    (lines,) = transformed([Record(t, u, u, ("a", "b"), ("y", "z"), "one", hold=hold)])
    assert lines.record.equidistant
    for late in (0.5, 0.2, 0.999, 1.0, 1.001, 0.2, 0.0, 3.3, -0.4):
        tau = h * np.array([late, 0.7])
        S, rest = lines.inputs.at(tau, tau, 40)
        held = delayed_input(t, u, tau, hold)
        n = np.exp(-2j * np.pi * np.outer(np.arange(1, 41), np.arange(101)) / 101) / np.sqrt(101)
        jumps = np.zeros((101, nu))
        jumps[held.step, held.channel] = held.jump
        expected = np.hstack([n @ held.value, n @ held.slope, n @ jumps])
        np.testing.assert_allclose(S, expected, atol=1e-12 * np.abs(expected).max())
        means = [held.rest[held.channel == j].mean() for j in range(nu)]
        np.testing.assert_allclose(rest, means, atol=1e-13)
