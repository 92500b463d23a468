"""Clocks that differ by more than a skew, against signals moved by known times."""

from dataclasses import replace

import numpy as np
import pytest
from truths import uh60
from truths.bodies import SPEEDS, flown
from truths.flights import NOISE, RATES, flight

from casid import outliers, read_csv
from casid.consistency.kinematics import kinematic_check
from casid.consistency.lags import clocks_apart, correlations, peak
from casid.consistency.measured import Flight


def test_correlations_are_those_of_a_loop_over_lags():
    rng = np.random.default_rng(0)
    x, y, most = *rng.standard_normal((2, 60)), 7
    inner = y[most:-most]
    expected = []
    for lag in range(2 * most + 1):
        part = x[lag : lag + len(inner)]
        expected.append(part @ inner / np.linalg.norm(part) / np.linalg.norm(inner))
    np.testing.assert_allclose(correlations(x, y, most), expected, atol=1e-12)


def test_the_peak_of_a_parabola_is_its_own():
    k = np.arange(9)
    assert peak(3 - 0.2 * (k - 4.3) ** 2, 4) == pytest.approx(4.3)


@pytest.mark.parametrize("clock", [0.65, -3.0])
def test_loggers_started_apart_are_told_by_how_much_and_nothing_else_is(clock):
    whole = flight(0, None, NOISE, (*RATES, "phi", "theta"))
    angles = whole.select((), ("phi", "theta"))
    remarks = kinematic_check(whole.select(outputs=RATES).join(angles, clock=clock)).remarks
    assert [said.split()[0] for said in remarks] == ["phi", "theta"]
    for said in remarks:
        assert ("after" in said) == (clock > 0)
        assert float(said.split("first, ")[1].split(" s")[0]) == pytest.approx(-clock, abs=0.02)


@pytest.mark.second
@pytest.mark.parametrize("clocks", [(0.0, 3.0, 0.0), (2.0, -1.5, 0.0), (4.0, 4.0, 4.0)], ids=str)
def test_clocks_of_every_record_are_looked_at_and_those_that_differ_named(clocks):
    records = []
    for k, clock in enumerate(clocks):
        whole = flight(40 + k, None, NOISE, (*RATES, "phi", "theta"), f"r{k}")
        whole = whole.take(slice(None if k == 0 else 1500))  # the first is the longest
        angles = whole.select((), ("phi", "theta"))
        records.append(whole.select(outputs=RATES).join(angles, clock=clock))
    check = kinematic_check(records)
    assert [said.split()[0] for said in check.remarks] == ["phi", "theta"]
    if len({*clocks}) == 1:
        assert check.by_record == ()
        return
    assert check.by_record == check.remarks
    for said in check.remarks:
        each = said.split("(")[1].split(")")[0].split(", ")
        assert [one.split()[0] for one in each] == [f"r{k}" for k in range(len(clocks))]
        found = [float(one.split()[1]) for one in each]
        np.testing.assert_allclose(found, clocks, atol=0.03)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("late", [0.0, 0.4])
def test_a_steady_oscillation_or_a_skew_within_reach_is_no_clock(late):
    t = 0.02 * np.arange(2000)
    swing = Flight(0.02, 0, {"p": np.cos(2 * t), "phi": 0.5 * np.sin(2 * (t - late))})
    assert clocks_apart([swing], 0.5, {0: "a"}) == ((), False)
    noisy = flight(1, dict.fromkeys(RATES, (0.0, 0.0, -late)), NOISE)
    assert not any("clocks of" in said for said in kinematic_check(noisy).remarks)


def test_what_goes_the_other_way_is_no_clock():
    t, rng = 0.02 * np.arange(2000), np.random.default_rng(4)
    p = np.convolve(rng.standard_normal(2000), np.hanning(60), "same")
    late = np.interp(t - 3.0, t, 0.02 * np.cumsum(p))
    assert len(clocks_apart([Flight(0.02, 0, {"p": p, "phi": late})], 0.5, {0: "a"})[0]) == 1
    assert clocks_apart([Flight(0.02, 0, {"p": p, "phi": -late})], 0.5, {0: "a"})[0] == ()


def test_a_skew_at_the_end_of_the_search_is_called_that():
    t = 0.02 * np.arange(2000)
    rng = np.random.default_rng(2)
    slow = np.sin(0.15 * t) + 0.4 * np.sin(0.06 * t)
    rate = 0.15 * np.cos(0.15 * (t + 0.8)) + 0.024 * np.cos(0.06 * (t + 0.8))
    y = np.column_stack([rate, slow]) + 1e-4 * rng.standard_normal((2000, 2))
    record = replace(flight(0, outputs=("p", "phi")), y=y)
    said = kinematic_check(record).remarks
    assert any("where the search ended" in each or "set the clocks" in each for each in said)


def test_records_without_channels_that_kinematics_ties_are_not_looked_at():
    record = flight(0, outputs=("p", "phi")).rename({"p": "rpm", "phi": "torque"})
    assert kinematic_check(record).consistent


def test_where_a_signal_rests_it_is_like_nothing():
    x = np.zeros(300)
    x[:80] = np.random.default_rng(3).standard_normal(80)
    y = np.random.default_rng(4).standard_normal(300)
    found = correlations(x, y, 120)
    assert np.abs(found).max() < 1
    np.testing.assert_array_equal(found[100:], 0.0)


def test_an_attitude_that_hardly_leaves_its_step_tells_no_clock():
    records = []
    for k, axis in enumerate(uh60.INPUTS):
        file = uh60.EXAMPLE / "data" / f"3211_{axis}.csv"
        record = read_csv(file, inputs=uh60.INPUTS, outputs=uh60.OUTPUTS)
        y = record.with_noise(uh60.NOISE, np.random.default_rng(k)).y.copy()
        step = np.radians([3.0, 3.0])  # attitudes of a coarse indicator
        y[:, 6:] = step * np.round(y[:, 6:] / step)
        records.append(replace(record, y=y))
        assert not outliers(records[-1]).any()
    assert not any("clock" in said for said in kinematic_check(records).remarks)


@pytest.mark.second
@pytest.mark.parametrize("late", [2.0, -1.2])
def test_velocities_of_a_clock_far_off_are_told(late):
    remarks = kinematic_check(flown(113, late=dict.fromkeys(SPEEDS, late), count=2)).remarks
    assert remarks
    assert {said.split()[0] for said in remarks} <= {*SPEEDS}
    for said in remarks:
        assert float(said.split("first, ")[1].split(" s")[0]) == pytest.approx(-late, abs=0.05)


def exchanged(record, one, other):
    """The record with two of its outputs under each other's name."""
    i, j = (record.outputs.index(name) for name in (one, other))
    y = record.y.copy()
    y[:, [i, j]] = y[:, [j, i]]
    return replace(record, y=y)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize(
    ("names", "turned"),
    [
        (("phi", "theta"), {"phi": "q", "theta": "p"}),
        (("p", "q"), {"phi": "q", "theta": "p"}),
        (("p", "r"), {"phi": "r"}),
    ],
)
def test_axes_that_are_exchanged_are_no_clocks(names, turned):
    records = uh60.sweeps(seed=3)
    assert not [x for x in kinematic_check(records).remarks if " follows what" in x]
    remarks = kinematic_check([exchanged(record, *names) for record in records]).remarks
    assert [x.split(" turns")[0] for x in remarks] == [
        f"{angle} follows what {rate}" for angle, rate in turned.items()
    ]
    assert all("look at the axes of both" in x for x in remarks)


def test_a_rate_that_is_like_the_own_one_does_not_hide_a_clock():
    whole = flight(0, None, NOISE, (*RATES, "phi", "theta"))
    y = whole.y.copy()
    y[:, whole.outputs.index("r")] = 0.5 * whole.channel("p")
    whole = replace(whole, y=y)
    angles = whole.select((), ("phi", "theta"))
    remarks = kinematic_check(whole.select(outputs=RATES).join(angles, clock=3.0)).remarks
    assert [said.split()[:2] for said in remarks] == [["phi", "comes"], ["theta", "comes"]]
    assert float(remarks[0].split()[2]) == pytest.approx(3.0, abs=0.02)


@pytest.mark.campaign
@pytest.mark.parametrize(("seed", "names"), [(4, ("v", "w")), (5, ("v", "w")), (1, ("u", "v"))])
def test_velocities_that_are_exchanged_are_neither_late_nor_scales(seed, names):
    remarks = kinematic_check([exchanged(record, *names) for record in flown(seed)]).remarks
    assert [x for x in remarks if "does not follow from the other channels" in x]
    assert not [x for x in remarks if "time stamps" in x or "scale factors" in x]
