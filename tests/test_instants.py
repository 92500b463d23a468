"""Time that does not increase: each cause is made of a good record, and its own word is wanted."""

import re

import numpy as np
import pytest

from casid.instants import check_time, stamp

N, STEP = 400, 0.02
JITTERS = pytest.mark.parametrize("jitter", [0.0, 0.1, 0.6])


def clock(jitter, seed=0):
    """Instants every 20 ms, each off by so much of that at most."""
    rng = np.random.default_rng(seed)
    return STEP * (np.arange(N) + jitter * rng.uniform(-0.5, 0.5, N))


def refused(t, x=None):
    x = np.random.default_rng(1).normal(size=(len(t), 3)) if x is None else x
    with pytest.raises(ValueError, match="time does not increase at sample") as told:
        check_time("flight", np.asarray(t), x)
    return str(told.value)


def test_time_that_increases_is_not_refused():
    check_time("flight", clock(0.6), np.zeros((N, 1)))


@JITTERS
@pytest.mark.parametrize("back", [0.04, 0.1, 0.113, 2.0])
def test_a_clock_that_stepped_back_is_told_with_where_and_by_how_much(jitter, back):
    t = clock(jitter)
    t[200:] -= back
    said = refused(t)
    assert f"at sample 200 ({stamp(t, 199)} s, then {stamp(t, 200)} s)" in said
    found = float(
        re.search(r"stepped back by ([0-9.]+) s and to stay there\. Cut the file there", said)[1]
    )
    assert found == pytest.approx(back, abs=0.01 * back + jitter * STEP / 2)
    assert "sort" not in said


@JITTERS
def test_rows_out_of_order_are_to_be_sorted(jitter):
    t = clock(jitter)
    near, far = t.copy(), t.copy()
    near[[100, 101]], far[[100, 105]] = t[[101, 100]], t[[105, 100]]
    blocks = np.r_[t[:100], t[200:300], t[100:200], t[300:]]
    for times in (near, far, blocks):
        assert "; sort the samples" in refused(times)
        assert "stepped back" not in refused(times)


@JITTERS
def test_rows_that_stand_twice_are_to_be_dropped(jitter):
    t, x = clock(jitter), np.random.default_rng(2).normal(size=(N, 3))
    x[::7, 1] = np.nan  # nothing was measured: the same twice, too
    for again, those in (
        (np.r_[:200, 150:N], "50 of 450 rows .*samples 200 to 249 are those from 150 on"),
        (np.r_[:N, :N], "400 of 800 rows .*samples 400 to 799 are those from 0 on"),
        (np.r_[:N, 379], "1 of 401 rows .*sample 400 is 379 once more"),
    ):
        assert re.search(f"{those}.*drop the repeated rows", refused(t[again], x[again]))
    other = np.r_[:200, 150:N]
    assert "stepped back by" in refused(t[other])  # other values at the same instants


@JITTERS
def test_time_that_runs_backward_is_to_be_reversed(jitter):
    said = refused(clock(jitter)[::-1])
    assert said.endswith("it runs backward: reverse the order of the rows")


@JITTERS
def test_a_second_flight_begins_where_the_first_did_or_before(jitter):
    t = clock(jitter)
    told = "a second flight, .* cut the file there"
    assert re.search(told, refused(np.r_[t, t + 0.01]))
    assert re.search(told, refused(np.r_[t + 500.0, t]))
    assert re.search(f"{told}, and at 1 places more", refused(np.r_[t, t, t + 0.01]))


def test_a_clock_that_stepped_back_twice_is_told_as_that():
    t = clock(0.0)
    t[100:] -= 0.1
    t[300:] -= 0.2
    said = refused(t)
    assert "at sample 100" in said
    assert "and at 1 places more" in said
    assert "add 0.1 s to all instants that follow (at each place its own)" in said


def test_a_clock_that_steps_back_soon_after_the_start_is_no_second_flight():
    t = clock(0.0)
    t[17:] -= 0.06
    assert "stepped back by 0.06 s" in refused(t)


def test_a_few_samples_at_the_instant_of_the_one_before_are_let_through():
    t, x = clock(0.0), np.random.default_rng(3).normal(size=(N, 2))
    t[[50, 90]] = t[[49, 89]]
    check_time("flight", t, x)


def test_time_that_is_rounded_or_stands_or_is_none():
    t = clock(0.0)
    rounded = np.repeat(t[:200], 2)
    assert "or write time with more digits if it is rounded (200 samples)" in refused(rounded)
    assert "sort the samples and drop repeated ones" in refused(np.full(50, 3.88))
    t[7] = np.nan
    with pytest.raises(ValueError, match=r"t\[7\] = nan; time must be finite"):
        check_time("flight", t, np.zeros((N, 1)))
