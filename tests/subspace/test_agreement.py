from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter, lsim
from truths.systems import closed_loop_record, stepped_input, unstable_plant

from casid import Record, pbsid
from casid.subspace.agreement import Fault

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


def remarks(records):
    settings = {"order": 5, "past": 10, "pole": 6.0, "feedthrough": ["z"]}
    return pbsid(records, **settings).remarks


@pytest.mark.parametrize("seed", range(2))
def test_flights_of_one_aircraft_agree(seed):
    assert remarks(flights(seed)) == ()


@pytest.mark.parametrize(("name", "factor"), [("x", 1.3), ("y", 1.3), ("z", 1 / 1.3)])
def test_a_channel_of_another_gain_is_named_with_that_gain(name, factor):
    records = flights()
    records[2] = scaled(records[2], name, factor)
    (said,) = remarks(records)
    assert said.startswith(f"Record flight 2 disagrees with the others: {name} is ")
    gain, error = (
        float(part) for part in said.split(f"{name} is ")[1].split(" times")[0].split(" ± ")
    )
    assert abs(gain - factor) < max(3 * error, 0.04)


def test_a_channel_that_is_late_is_named_with_its_delay():
    records = flights()
    records[4] = read_at(records[4], "z", records[4].t - 0.08)
    (said,) = remarks(records)
    assert said.startswith("Record flight 4 disagrees with the others: z is ")
    assert 60 <= float(said.split("z is ")[1].split(" ±")[0]) <= 100
    assert "ms later than their model predicts" in said


def test_an_input_that_is_late_is_named():
    records = flights()
    records[1] = read_at(records[1], "b", records[1].t - 0.08)
    (said,) = remarks(records)
    assert said.startswith("Record flight 1 disagrees with the others: b is ")
    assert "later" in said


@pytest.mark.parametrize(("rate", "word"), [(1.02, "faster"), (0.98, "slower")])
def test_a_clock_that_runs_at_another_rate_is_named(rate, word):
    records = flights()
    records[3] = read_at(records[3], "x", rate * records[3].t)
    (said,) = remarks(records)
    assert said.startswith("Record flight 3 disagrees with the others: the clock of x runs ")
    assert f"% {word}" in said
    assert 1.0 <= float(said.split("runs ")[1].split(" %")[0]) <= 2.4


def test_a_record_alone_has_nothing_to_disagree_with():
    assert remarks([scaled(flights()[0], "y", 1.3)]) == ()


def test_faults_are_told_in_words():
    late = Fault(record="a", channel="q", kind="delay", size=-0.05, error=0.004)
    assert "q is 50 ± 4 ms earlier than their model predicts" in late.told()
    loud = replace(late, kind="gain", size=0.29, error=0.02)
    assert "q is 1.29 ± 0.02 times what their model predicts" in loud.told()


def campaign(each=2, seed=0, other=0.1):
    """Records of a stable plant, ``each`` of which move a main input, and the other one less."""
    rng, plant = np.random.default_rng(seed), unstable_plant()
    t, made = 0.02 * np.arange(1001), []
    for k in range(2 * each):
        u = stepped_input(len(t), 2, rng) * np.where(np.arange(2) == k % 2, 1.0, other)
        exact = lsim((plant.A - 0.4 * np.eye(5), plant.B, plant.C, plant.D), u, t)[1]
        y = exact + 0.02 * rng.standard_normal(exact.shape)
        made.append(Record(t, u, y, plant.inputs, plant.outputs, f"flight {k}"))
    return made


def gained(record, name, factor):
    """The record with an input of another unit or sign."""
    return replace(record, u=record.u * np.where(np.array(record.inputs) == name, factor, 1.0))


def factor_in(said, name):
    return float(said.split(f"{name} is ")[1].split(" ±")[0])


def test_a_record_in_another_unit_is_named_and_not_the_one_it_rules():
    records = campaign()
    records[1] = gained(records[1], "b", 100.0)
    (said,) = remarks(records)
    assert said.startswith("Record flight 1 disagrees with the others: b is ")
    assert factor_in(said, "b") == pytest.approx(100, rel=0.1)


@pytest.mark.parametrize(("spoil", "name"), [(gained, "b"), (scaled, "z")])
def test_a_sign_is_told_as_one(spoil, name):
    records = campaign(each=3)
    records[1] = spoil(records[1], name, -1.0)
    (said,) = remarks(records)
    assert said.startswith(f"Record flight 1 disagrees with the others: {name} is ")
    assert factor_in(said, name) == pytest.approx(-1, abs=0.05)


@pytest.mark.parametrize("late", [False, True])
def test_one_of_two_records_that_disagree_is_named(late):
    records = campaign(other=0.02)
    one = records[1]
    records[1] = read_at(one, "z", one.t - 0.1) if late else scaled(one, "z", 1.4)
    (said,) = remarks(records)
    assert "flight 1" in said
    assert "flight 0" not in said
    assert "z is " in said


def test_a_pair_is_told_as_one():
    fault = Fault(record="a", channel="q", kind="gain", size=0.3, error=0.02, against="b")
    assert fault.told().startswith("Records a and b disagree: in a q is 1.30 ± 0.02 times what")


def test_a_gust_is_no_fault_of_a_sensor():
    rng = np.random.default_rng(3)
    for k in range(2):
        records = campaign(seed=k)
        gust = lfilter([0.2], [1, -0.98], rng.standard_normal(records[k].y.shape), axis=0)
        records[k] = replace(records[k], y=records[k].y + gust)
        assert remarks(records) == ()
