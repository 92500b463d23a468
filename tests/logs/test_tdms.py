import io

import nptdms
import numpy as np
import pytest
from truths.logs import flight, tdms

from casid.logs.tdms import read_tdms


def topics(data):
    return {topic.name: topic for topic in read_tdms(data, nptdms)[0]}


def written(*channels):
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment([nptdms.ChannelObject(*each) for each in channels])
    return file.getvalue()


def test_columns_of_times_and_waveforms_are_clocks_and_units_become_si():
    t, x = flight(2.0)
    found = topics(tdms(2.0))
    np.testing.assert_array_equal(found["sticks"].t, t[::2])
    np.testing.assert_allclose(found["gyros"].t, t, rtol=1e-12)
    np.testing.assert_allclose(found["gyros"].columns["q"], x["q"], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(found["sticks"].columns["yaw"], x["yaw"][::2])


def test_channels_without_a_time_are_told():
    (said,) = read_tdms(tdms(2.0), nptdms)[1]
    assert said.startswith("group 'gyros': no time is known for without time: waveforms have it")


def test_waveforms_of_a_group_keep_their_clocks_apart():
    begun = np.datetime64("2026-01-01T12:00:00", "us")
    later = {"wf_increment": 0.1, "wf_start_time": begun + np.timedelta64(250_000, "us")}
    data = written(
        ("G", "a", np.arange(5.0), {"wf_increment": 0.1, "wf_start_time": begun}),
        ("G", "b", np.arange(5.0), later),
        ("G", "c", np.arange(10.0), {"wf_increment": 0.05, "wf_start_time": begun}),
    )
    found = topics(data)
    assert [list(topic.columns) for topic in found.values()] == [["a"], ["b"], ["c"]]
    np.testing.assert_allclose(found["G (2)"].t, 0.25 + 0.1 * np.arange(5), rtol=1e-12)
    assert found["G (3)"].interval == pytest.approx(0.05)


def test_time_stamps_of_labview_are_seconds_from_the_first():
    stamps = np.datetime64("2026-01-01", "us") + np.arange(4) * np.timedelta64(20_000, "us")
    found = topics(written(("G", "Timestamp", stamps), ("G", "p", np.arange(4.0))))
    np.testing.assert_allclose(found["G"].t, 0.02 * np.arange(4), atol=1e-9)


@pytest.mark.parametrize("kind", ["waveform", "stamps", "mixed"])
def test_groups_that_count_from_dates_have_one_clock(kind):
    begun, late = np.datetime64("2026-05-05T12:00:00", "us"), np.timedelta64(300_000, "us")

    def group(name, start, *, wave):
        if wave:
            told = {"wf_increment": 0.02, "wf_start_time": start}
            return ((name, "x", np.arange(5.0), told),)
        stamps = start + np.arange(5) * np.timedelta64(20_000, "us")
        return (name, "Time", stamps), (name, "x", np.arange(5.0))

    data = written(
        *group("sticks", begun, wave=kind == "waveform"),
        *group("gyros", begun + late, wave=kind != "stamps"),
    )
    found = topics(data)
    np.testing.assert_allclose(found["sticks"].t, 0.02 * np.arange(5), atol=1e-9)
    np.testing.assert_allclose(found["gyros"].t, 0.3 + 0.02 * np.arange(5), atol=1e-9)


def test_clocks_that_nobody_can_compare_are_told():
    begun = np.datetime64("2026-05-05T12:00:00", "us")
    unset = np.datetime64("1904-01-01T00:00:00", "us")
    data = written(
        ("G", "a", np.arange(5.0), {"wf_increment": 0.1, "wf_start_time": begun}),
        ("H", "Time", np.arange(0.0, 500.0, 100.0), {"unit_string": "ms"}),
        ("H", "b", np.arange(5.0)),
        ("I", "c", np.arange(5.0), {"wf_increment": 0.1, "wf_start_time": unset}),
    )
    found, (note,) = read_tdms(data, nptdms)
    assert note.startswith("'H', 'I' count from an unknown instant")
    for topic in found:
        np.testing.assert_allclose(topic.t, 0.1 * np.arange(5), rtol=1e-12)


@pytest.mark.parametrize(
    ("unit", "second"),
    [("", 1), ("s", 1), ("ms", 1e3), ("msec", 1e3), ("Milliseconds", 1e3), ("min", 1 / 60)],
)
def test_instants_are_read_in_the_unit_that_they_name(unit, second):
    clock = ("G", "time", second * 0.02 * np.arange(4), {"unit_string": unit})
    found, notes = read_tdms(written(clock, ("G", "p", np.arange(4.0))), nptdms)
    (topic,) = found
    np.testing.assert_allclose(topic.t, 0.02 * np.arange(4), atol=1e-12)
    assert notes == ()


def test_a_unit_of_time_that_nobody_knows_is_told():
    clock = ("G", "time", np.arange(4.0), {"unit_string": "ticks"})
    assert read_tdms(written(clock, ("G", "p", np.arange(4.0))), nptdms)[1] == (
        "group 'G': time is in 'ticks', no unit of time that is known: taken as seconds",
    )


@pytest.mark.parametrize(
    ("name", "second"),
    [
        *(("Time [ms]", 1e3), ("Time (s)", 1), ("Elapsed Time", 1), ("time_ms", 1e3), ("T", 1)),
        *(("Timestamp (μs)", 1e6), ("TIME [ msec ]", 1e3), ("Elapsed_Time_us", 1e6), ("Zeit", 1)),
        *(("milliseconds", 1e3), ("Relative time (min)", 1 / 60), ("time s", 1)),
    ],
)
def test_names_of_instants_bear_units_as_those_of_channels_do(name, second):
    clock = ("G", name, second * 0.02 * np.arange(4))
    found, notes = read_tdms(written(clock, ("G", "p [rad/s]", np.arange(4.0))), nptdms)
    (topic,) = found
    np.testing.assert_allclose(topic.t, 0.02 * np.arange(4), rtol=1e-12, atol=1e-12)
    assert (list(topic.columns), notes) == (["p [rad/s]"], ())


def test_what_a_property_states_of_instants_goes_before_their_name():
    clock = ("G", "Time [s]", 20.0 * np.arange(4), {"unit_string": "ms"})
    (topic,) = read_tdms(written(clock, ("G", "p", np.arange(4.0))), nptdms)[0]
    np.testing.assert_allclose(topic.t, 0.02 * np.arange(4), atol=1e-12)


@pytest.mark.parametrize("name", ["Date", "p [ms]", "Time constant [s]", "dead time", "Set_Time_s"])
def test_numbers_of_other_names_are_no_instants(name):
    data = written(("G", name, np.arange(4.0)), ("G", "p", np.arange(4.0)))
    found, notes = read_tdms(data, nptdms)
    assert not list(found)
    assert f"no time is known for {name}, p" in notes[0]


def test_of_several_columns_of_instants_the_plainest_counts():
    every = [("Elapsed Time [ms]", 100.0), ("Time", 0.1), ("Relative Time", 0.3)]
    data = written(*(("G", name, dt * np.arange(4)) for name, dt in every))
    (topic,) = read_tdms(data, nptdms)[0]
    np.testing.assert_allclose(topic.t, 0.1 * np.arange(4), atol=1e-12)
    assert list(topic.columns) == ["Elapsed Time [ms]", "Relative Time"]
