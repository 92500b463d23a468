from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.logs.topics import Bounded, DamagedLogError, increasing, make_topic


@pytest.mark.second
@given(st.lists(st.integers(0, 6) | st.just(float("nan")), max_size=9))
def test_as_few_samples_as_possible_are_left_out_where_stamps_go_back(stamps):
    t = np.array(stamps, dtype=float)
    kept = increasing(t)
    assert (np.diff(kept) > 0).all()
    assert (np.diff(t[kept]) > 0).all()
    finite = [x for x in t if np.isfinite(x)]
    longest = max(  # brute force over all choices
        n
        for n in range(len(finite) + 1)
        if any((np.diff(each) > 0).all() for each in combinations(finite, n))
    )
    assert len(kept) == longest


def test_one_stamp_far_in_the_future_costs_one_sample():
    t = np.arange(100.0)
    t[40] = 1e12
    assert len(increasing(t)) == 99


@pytest.mark.parametrize("second", [(20, 60), (0, 45), (0, 53), (20, 120)])
def test_of_two_clocks_the_longer_part_is_kept_whole(second):
    # The longest increasing choice would go from one to the other without a seam.
    parts = np.arange(0, 50, 0.1), np.arange(*second, 0.1)
    t = np.concatenate(parts)
    wrong = np.random.default_rng(3).choice(len(t), size=8, replace=False)
    t[wrong] = [1e6, -1e6] * 4
    kept = increasing(t)
    first = 0 if np.ptp(parts[1]) < 55 else len(parts[0])
    wanted = set(range(first, first + len(parts[first > 0])))
    assert set(kept) <= wanted
    assert len(wanted - set(kept)) <= 16


def test_columns_are_in_si_and_text_is_left_out():
    columns = [
        ("a", np.array([180, 90]), "deg"), ("b", np.array([1.0, 2.0]), "%"),
        ("c", np.array(["x", "y"]), ""), ("d", np.array([1.0, 2.0]), "bar"),
    ]  # fmt: skip
    topic = make_topic("T", np.array([0.0, 1.0]), columns)
    assert set(topic.columns) == {"a", "b", "d"}
    np.testing.assert_allclose(topic.columns["a"], [np.pi, np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(topic.columns["b"], [0.01, 0.02], rtol=1e-15)
    np.testing.assert_array_equal(topic.columns["d"], [1.0, 2.0])
    assert make_topic("T", np.array([0.0, 1.0]), columns[2:3]) is None
    assert make_topic("T", np.zeros(0), columns) is None


def test_stamps_that_repeat_are_no_clock_that_went_back():
    t = np.array([0.0, 0.1, 0.1, 0.2, 0.3, 0.3, 0.3, 0.4, 0.2, 0.5, np.nan])
    topic = make_topic("T", t, [("x", np.arange(11.0), "")])
    assert (topic.repeats, topic.left_out) == (3, 2)
    np.testing.assert_array_equal(topic.t, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5])


def test_gaps_are_five_usual_intervals_or_longer():
    t = np.array([0, 1, 2, 3, 7.9, 9, 10, 11, 12, 18, 19, 20.0])
    topic = make_topic("T", t, [("x", t, "")])
    assert topic.interval == 1.0
    assert topic.gaps() == [(12.0, 6.0)]


def test_a_reader_that_goes_in_circles_is_stopped():
    data = Bounded(b"0123456789" * 1000)

    def again(times):
        for _ in range(times):
            data.seek(0)
            data.read()

    again(8)  # as a reader of a sound log may
    with pytest.raises(DamagedLogError):
        again(100_000)


@pytest.mark.parametrize("back", [0.06, 0.1, 0.113, 50.0])
def test_a_clock_that_stepped_back_is_told_and_its_longest_side_kept(back):
    """By how much is what was taken off; what follows would be that early against other topics."""
    t = 0.01 * np.arange(10_000)
    t[5500:] -= back
    found = make_topic("IMU", t, [("p", np.arange(10_000.0), "")])
    ((at, lag),) = found.went_back
    assert (at, lag) == (pytest.approx(54.99), pytest.approx(back))
    np.testing.assert_array_equal(found.columns["p"], np.arange(5500.0))


def test_stamps_out_of_order_are_no_clock_that_stepped_back():
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(2000)
    wild, late, noisy = t.copy(), t.copy(), t + 0.02 * rng.uniform(size=2000)
    wild[700] += 5.0
    late[[300, 310]] = t[[310, 300]]
    for stamps in (t, wild, late, noisy):
        assert make_topic("IMU", stamps, [("p", t, "")]).went_back == ()


def test_stamps_that_are_nearly_one_are_no_two_samples():
    """Between them a curve would swing far beyond both."""
    t = 0.01 * np.arange(400)
    t[200:] -= 0.02 - 1e-14  # the second after is the last before, to rounding
    assert np.diff(t[increasing(t)]).min() > 0.005
