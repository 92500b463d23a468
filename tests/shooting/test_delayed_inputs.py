"""Delayed inputs that move along, against those laid out anew."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, flown, jittered

from casid.free import free_parameters
from casid.intersample import delayed_input
from casid.shooting import delayed_inputs
from casid.shooting.delayed_inputs import LATE, Delayed, common_step, stretch
from casid.shooting.stepping import collect_breaks
from casid.shooting.unknowns import FilterFunction

FUNCTION = FilterFunction(FREE := free_parameters(TRUTH), None)
H = 0.02


def matrices(tau):
    return replace(FUNCTION(FREE.guess[FREE.index]), tau=np.array([tau, 0.0]))


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("sampling", ["alike", "of its own", "jittered"])
def test_what_moves_along_is_what_is_laid_out_anew(hold, sampling):
    records = [replace(flown(seed=k).between(0, 3 + k), hold=hold) for k in (1, 2)]
    if sampling == "of its own":
        records[1] = replace(records[1], t=2 * records[1].t)
    if sampling == "jittered":
        records[1] = jittered(records[1])
    inputs = Delayed(records, FUNCTION.direct)
    for tau in np.array([1.3, 1.7, 1.0, 2.0, 0.0, 0.4, 1.9, 6.5]) * H:
        m = matrices(tau)
        found = inputs.at(m)
        for record, mine in zip(records, found.inputs, strict=True):
            # Outputs jump with steps that go through at once: no delay is then one of none.
            late = max(tau, LATE * record.dt if hold == "foh" else 0.0)
            u = delayed_input(record.t, record.u, m.tau, hold, np.array([late, 0.0]))
            np.testing.assert_array_equal(mine.step, u.step)
            np.testing.assert_array_equal(mine.channel, u.channel)
            for name in ("value", "slope", "rest", "jump"):
                expected = getattr(u, name)
                size = np.abs(expected).max(initial=H)
                np.testing.assert_allclose(getattr(mine, name), expected, atol=1e-13 * size)
        mine = found.columns(records, m.A)
        u = collect_breaks(found.inputs, [hold, hold], m.A)
        np.testing.assert_array_equal(mine.channel, u.channel)
        np.testing.assert_allclose(mine.rest, u.rest, atol=1e-13)
        np.testing.assert_allclose(mine.jumps, u.jumps, atol=1e-13 * np.abs(u.jumps).max())


def test_steps_may_be_felt_at_once_whatever_the_direct_terms_are_just_now():
    inputs = Delayed([record := replace(flown(seed=1), hold="zoh")], FUNCTION.direct)
    (found,) = inputs.at(replace(matrices(0.0), D=0 * matrices(0.0).D)).inputs
    np.testing.assert_array_equal(found.value, record.u)


def test_within_a_stretch_nothing_is_laid_out_again(monkeypatch):
    calls = []

    def counted(*arguments):
        calls.append(arguments)
        return delayed_input(*arguments)

    monkeypatch.setattr(delayed_inputs, "delayed_input", counted)
    inputs = Delayed([flown(seed=1), flown(seed=2)], FUNCTION.direct)
    for tau in np.array([1.1, 1.5, 1.9, 2.0]) * H:
        inputs.at(matrices(tau))
    assert len(calls) == 2
    inputs.at(matrices(2.1 * H))
    assert len(calls) == 4


def test_delays_may_pass_samples_without_the_breaks():
    # Ordered as for 1.5 samples, a delay of 2.2 is the continuation of what is below two.
    record = flown(seed=1)
    inputs = Delayed([record], FUNCTION.direct).within(np.array([1.5 * H, np.nan]))
    (found,) = inputs.at(matrices(2.2 * H)).inputs
    at = matrices(2.2 * H).tau
    expected = delayed_input(record.t, record.u, at, record.hold, np.array([1.5 * H, 0.0]))
    np.testing.assert_allclose(found.value, expected.value, atol=1e-13)
    np.testing.assert_allclose(found.rest, expected.rest, atol=1e-13)
    assert found.rest.min() < 0


def test_records_are_sampled_alike_or_not():
    record = flown(seed=1)
    assert common_step([record, record.between(1, 3)]) == pytest.approx(H)
    assert common_step([record, replace(record, t=2 * record.t)]) is None
    assert common_step([record, jittered(record)]) is None


def test_a_stretch_ends_at_a_whole_sample():
    np.testing.assert_allclose(stretch(H, [np.array([0.3, 1.0, 1.2, 0.0]) * H]), [H, H, 2 * H, 0])
    assert stretch(H, [np.array([-0.1 * H])]) is None
    assert stretch(H, [np.array([0.5 * H]), np.array([1.5 * H])]) is None
