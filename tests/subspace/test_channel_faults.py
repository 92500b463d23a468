import re
from dataclasses import replace

import numpy as np
import pytest
from truths.systems import closed_loop_record, unstable_plant

from casid import pbsid
from casid.subspace.channel_faults import Fault

GAIN = np.array([[0.0, 0.4, 0.0], [0.3, 0.0, 0.2]])


def flights(seed=0):
    """Six records of an unstable plant in a loop, all inputs moved, noise of a few per cent."""
    rng = np.random.default_rng(seed)
    made = {"duration": 20.0, "noise": 0.02, "gain": GAIN}
    return [closed_loop_record(unstable_plant(), rng, name=f"flight {k}", **made) for k in range(6)]


def read_at(record, name, at):
    """The record with a channel read at other instants (N,), as far as it goes."""
    known = at <= record.t[-1]
    values = {"u": record.u.copy(), "y": record.y.copy()}
    names, letter = (record.inputs, "u") if name in record.inputs else (record.outputs, "y")
    column = values[letter][:, names.index(name)]
    values[letter][:, names.index(name)] = np.interp(at, record.t, column)
    return replace(record, **values).take(known)


def scaled(record, name, factor):
    y = record.y * np.where(np.array(record.outputs) == name, factor, 1.0)
    return replace(record, y=y)


def told(said, before):
    """A number and its standard error, as a sentence states them."""
    return map(float, re.search(rf"{before}(\S+) ± (\S+)", said).groups())


def remarks(records):
    settings = {"order": 5, "past": 10, "pole": 6.0, "feedthrough": ["z"]}
    return pbsid(records, **settings).remarks


@pytest.mark.parametrize("seed", range(2))
def test_flights_of_one_aircraft_agree(seed):
    assert remarks(flights(seed)) == ()


@pytest.mark.second
@pytest.mark.parametrize("factor", [-1.0, 57.3])
def test_another_sign_or_unit_is_named_with_its_factor(factor):
    records = flights()
    records[2] = scaled(records[2], "x", factor)
    (said,) = remarks(records)
    assert said.startswith("Record flight 2 disagrees with the others: x is ")
    gain, error = told(said, "x is ")
    assert gain == pytest.approx(factor, abs=3 * error)


@pytest.mark.second
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.filterwarnings("ignore:inputs follow")
@pytest.mark.parametrize("factor", [-1.0, 3.0])
def test_of_two_records_that_disagree_both_are_named(seed, factor):
    records = flights(seed)[:2]
    records[1] = scaled(records[1], "y", factor)
    (said,) = (each for each in remarks(records) if "disagree" in each)
    assert said.startswith("Records flight ")
    assert "flight 0" in said
    assert "flight 1" in said
    assert "no third record tells which of the two is wrong" in said


@pytest.mark.second
@pytest.mark.parametrize(("name", "factor"), [("x", 1.3), ("y", 1.3), ("z", 1 / 1.3)])
def test_a_channel_of_another_gain_is_named_with_that_gain(name, factor):
    records = flights()
    records[2] = scaled(records[2], name, factor)
    (said,) = remarks(records)
    assert said.startswith(f"Record flight 2 disagrees with the others: {name} is ")
    gain, error = told(said, f"{name} is ")
    assert gain == pytest.approx(factor, abs=3 * error)
    assert error < 0.04  # of a gain that is 0.3 off


def test_a_channel_that_is_late_is_named_with_its_delay():
    records = flights()
    records[4] = read_at(records[4], "z", records[4].t - 0.08)
    (said,) = remarks(records)
    assert said.startswith("Record flight 4 disagrees with the others: z is ")
    late, error = told(said, "z is ")
    assert late == pytest.approx(80, abs=3 * error)
    assert error < 10
    assert "ms later than their model predicts" in said


def test_an_input_that_is_late_is_named():
    records = flights()
    records[1] = read_at(records[1], "b", records[1].t - 0.08)
    (said,) = remarks(records)
    assert said.startswith("Record flight 1 disagrees with the others: b is ")
    assert "later" in said


@pytest.mark.second
@pytest.mark.parametrize(("rate", "word"), [(1.02, "faster"), (0.98, "slower")])
def test_a_clock_that_runs_at_another_rate_is_named(rate, word):
    records = flights()
    records[3] = read_at(records[3], "x", rate * records[3].t)
    (said,) = remarks(records)
    assert said.startswith("Record flight 3 disagrees with the others: the clock of x runs ")
    assert f"% {word}" in said
    # Rates are tried that differ by 0.15 s at the end of 20 s, 0.75 %: the nearest is told.
    assert float(said.split("runs ")[1].split(" %")[0]) == pytest.approx(2, abs=0.75 / 2 + 0.05)


def test_a_record_alone_has_nothing_to_disagree_with():
    assert remarks([scaled(flights()[0], "y", 1.3)]) == ()


def test_faults_are_told_in_words():
    late = Fault(record="a", channel="q", kind="delay", size=-0.05, error=0.004)
    assert "q is 50 ± 4 ms earlier than their model predicts" in late.told()
    assert "q is of another delay than their model" in replace(late, size=-0.5).told()
    loud = replace(late, kind="gain", size=0.29, error=0.02)
    assert "q is 1.29 ± 0.02 times what their model predicts" in loud.told()
