"""Files: units, missing cells, trim, and errors that name file and column."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io

from casid import DataWarning, Record, read_csv, read_mat, write_csv

CHANNELS = {"inputs": ["lat"], "outputs": ["p", "phi"]}


def csv(path, text):
    file = path / "roll.csv"
    file.write_text(text, encoding="utf-8")
    return file


def test_columns_are_taken_by_name_in_any_order(tmp_path):
    file = csv(tmp_path, "phi, extra,t,lat,p\n1,9,0,0.1,3\n2,9,0.5,0.2,4\n")
    record = read_csv(file, **CHANNELS)
    assert (record.name, record.inputs, record.outputs) == ("roll", ("lat",), ("p", "phi"))
    np.testing.assert_array_equal(record.t, [0, 0.5])
    np.testing.assert_array_equal(record.u, [[0.1], [0.2]])
    np.testing.assert_array_equal(record.y, [[3, 1], [4, 2]])


def test_units_become_si_and_percent_a_fraction_of_travel(tmp_path):
    file = csv(tmp_path, "time,lat,p,phi\n0,50,180,1\n1000,100,90,2\n")
    units = {"time": "ms", "lat": "%", "p": "deg/s", "phi": "deg"}
    record = read_csv(file, **CHANNELS, time="time", units=units)
    np.testing.assert_allclose(record.t, [0, 1])
    np.testing.assert_allclose(record.u[:, 0], [0.5, 1.0])
    np.testing.assert_allclose(record.y, [[np.pi, np.pi / 180], [np.pi / 2, np.pi / 90]])


@pytest.mark.parametrize("cell", ["", " ", "nan", "NaN"])
def test_an_empty_or_nan_cell_is_a_missing_sample(tmp_path, cell):
    record = read_csv(csv(tmp_path, f"t,lat,p,phi\n0,1,{cell},1\n1,1,2,2\n"), **CHANNELS)
    assert np.isnan(record.y[0, 0])
    assert np.isfinite(record.y).sum() == 3


def test_columns_can_be_renamed_and_paced_by_an_interval(tmp_path):
    file = csv(tmp_path, "stick,ROLL RATE,phi\n0.1,18,1\n0.2,9,2\n")
    channels = {"inputs": {"lat": "stick"}, "outputs": {"p": "ROLL RATE", "phi": "phi"}}
    record = read_csv(file, **channels, time=0.5, units={"p": "dps"})
    assert (record.inputs, record.outputs) == (("lat",), ("p", "phi"))
    np.testing.assert_allclose(record.y[:, 0], [np.pi / 10, np.pi / 20])
    np.testing.assert_array_equal(record.t, [0, 0.5])


def test_a_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path):
    record = read_csv(csv(tmp_path, "\ufefft,lat,p,phi\r\n0,1,2,3\r\n1,1,2,3\r\n"), **CHANNELS)
    np.testing.assert_array_equal(record.t, [0, 1])


def test_trim_is_removed_on_reading_and_written_back(tmp_path):
    rows = "".join(f"{0.1 * k},{30 + (k > 3)},{0.5 + k},{1 / 3}\n" for k in range(8))
    file = csv(tmp_path, "t,lat,p,phi\n" + rows)
    with pytest.warns(DataWarning, match=r"moves 0\.4 s after the start.*mean of 4 samples"):
        record = read_csv(file, **CHANNELS, detrend="first", hold="zoh", name="a")
    assert (record.name, record.hold) == ("a", "zoh")
    assert record.u[0, 0] == 0
    write_csv(tmp_path / "again.csv", record)
    again = read_csv(tmp_path / "again.csv", **CHANNELS)
    np.testing.assert_allclose(again.y, read_csv(file, **CHANNELS).y, rtol=1e-9)  # ten digits
    np.testing.assert_allclose(again.u, read_csv(file, **CHANNELS).u, rtol=1e-9)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("t,lat,p\n0,1,2\n", {}, "roll.csv: no column 'phi'; it has t, lat, p"),
        ("x,lat,p,phi\n0,1,2,3\n", {}, "no column 't'; it has .*time = NAME"),
        ("t,lat,p,p,phi\n0,1,2,3,4\n", {}, "column 'p' stands there 2 times"),
        ("t,lat,p,phi\n", {}, "no samples below the header; record it again"),
        ("", {}, "the file is empty; expected a header"),
        (
            "t,lat,p,phi\n0,1,two,3\n",
            {},
            "line 2: could not convert string 'two' to float64; .* a decimal point",
        ),
        ("t,lat,p,phi\n0,1,2,3\n1,2,3\n", {}, "line 3: 3 cells, the header has 4"),
        (
            "t,lat,p,phi\n0,1,2,3\n # pilot: x, y, z\n",
            {},
            "line 3: it begins with '#', a comment: leave such lines out",
        ),
        ("# pilot: x\nt,lat,p,phi\n0,1,2,3\n", {}, "first line begins with '#': names stand"),
        ("# t,lat,p,phi\n0,1,2,3\n", {}, "first line begins with '#': names stand there, without"),
        ("t,lat,x,p,phi\n0,1,0,2,3\n\n1,0,2,3\n", {}, "line 4: 4 cells, the header has 5"),
        ("t,lat,p,phi\n0,1,2,3,\n", {}, "line 2: 5 cells, the header has 4"),
        ("t,lat,p,phi\n0,1,2,3\n", {"units": {"q": "deg"}}, "units name channel 'q', which is not"),
        (
            "t,lat,p,phi\n0,1,2,3\n",
            {"units": {"p": "rps"}},
            "channel 'p': unknown unit 'rps'",
        ),
        ("t,lat,p,phi\n0,1,2,3\n1,,2,3\n", {}, "input 'lat' is nan at sample 1"),
        ("t,lat,p,phi\n1,1,2,3\n0,1,2,3\n", {}, "time does not increase at sample 1"),
    ],
)
def test_an_unreadable_csv_is_told_with_file_and_column(tmp_path, text, options, message):
    with pytest.raises(ValueError, match=message):
        read_csv(csv(tmp_path, text), **CHANNELS, **options)


def test_a_channel_may_be_a_sum_of_columns(tmp_path):
    rows = "".join(f"{k},{65535 * (k % 2)},{65535 * k / 8},{k},{-2 * k}\n" for k in range(8))
    file = csv(tmp_path, "t,m1,m2,p,phi\n" + rows)
    mixed = {"lat": {"m1": -0.5, "m2": 0.5}}
    record = read_csv(
        file, inputs=mixed, outputs={"p": {"p": -1}, "phi": "phi"}, units={"lat": "u16"}
    )
    k = np.arange(8)
    np.testing.assert_allclose(record.u[:, 0], k / 16 - (k % 2) / 2, atol=1e-15)
    np.testing.assert_array_equal(record.y, np.column_stack([-k, -2 * k]))
    with pytest.raises(ValueError, match="no column 'm3'; it has t, m1, m2, p, phi"):
        read_csv(file, inputs={"lat": {"m1": 1, "m3": 1}}, outputs=["p"])
    with pytest.raises(ValueError, match="sum of no columns"):
        read_csv(file, inputs={"lat": {}}, outputs=["p"])


def test_a_file_that_is_not_there_or_no_text_is_told(tmp_path):
    with pytest.raises(ValueError, match=r"none\.csv: cannot read it as CSV"):
        read_csv(tmp_path / "none.csv", **CHANNELS)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ValueError, match=r"binary\.csv: cannot read it as CSV"):
        read_csv(tmp_path / "binary.csv", **CHANNELS)


@pytest.fixture
def mat(tmp_path):
    file = tmp_path / "flight.mat"
    y = np.column_stack([np.arange(4.0), 90 * np.ones(4)])
    content = {"t": np.arange(4.0)[:, None], "lat": np.ones((1, 4)), "out": y, "text": "hello"}
    scipy.io.savemat(file, content | {"short": np.ones(3)})
    return file


def test_mat_variables_and_columns_become_channels(mat):
    channels = {"inputs": {"stick": "lat"}, "outputs": {"p": ("out", 0), "phi": ("out", 1)}}
    record = read_mat(mat, **channels, units={"phi": "deg"})
    assert (record.inputs, record.outputs) == (("stick",), ("p", "phi"))
    assert record.name == "flight"
    np.testing.assert_array_equal(record.y[:, 0], np.arange(4))
    np.testing.assert_allclose(record.y[:, 1], np.pi / 2)
    paced = read_mat(mat, **channels, time=0.5)
    np.testing.assert_array_equal(paced.t, [0, 0.5, 1, 1.5])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "flight.mat: no variable 'p'; it has t, lat, out, text, short"),
        ({"outputs": {"p": ("out", 2)}}, r"'out' has shape \(4, 2\), no column 2"),
        ({"outputs": {"p": ("out", -1)}}, "no column -1"),
        ({"inputs": ["text"]}, "variable 'text' holds no real array, expected numbers"),
        ({"inputs": ["out"]}, r"'out' has shape \(4, 2\), expected a vector; name its columns"),
        ({"inputs": ["short"], "outputs": ["lat"]}, r"differ in length \(t 4, short 3, lat 4\)"),
        (
            {"time": -0.1, "outputs": ["t"]},
            "time=-0.1: expected a column, or the sampling interval",
        ),
        ({"outputs": []}, "record 'flight': name at least one input and one output"),
    ],
)
def test_an_unreadable_mat_is_told_with_file_and_variable(mat, options, message):
    with pytest.raises(ValueError, match=message):
        read_mat(mat, **(CHANNELS | options))


def test_a_mat_file_that_is_none_is_told(tmp_path):
    with pytest.raises(ValueError, match="cannot read it as a MATLAB file"):
        read_mat(csv(tmp_path, "t,lat\n0,1\n"), **CHANNELS)
    with pytest.raises(ValueError, match="cannot read it as a MATLAB file"):
        read_mat(tmp_path / "none.mat", **CHANNELS)


def test_missing_samples_survive_a_round_trip(tmp_path):
    y = np.array([[1.0, np.nan], [2.0, 3.0]])
    record = Record(np.array([0.0, 1.0]), np.ones((2, 1)), y, ("lat",), ("p", "phi"))
    write_csv(tmp_path / "a.csv", record)
    np.testing.assert_array_equal(read_csv(tmp_path / "a.csv", **CHANNELS).y, y)


@pytest.mark.parametrize("start", [0.0, 1e5, 1e8, 1.79e9, -1.79e9])
@pytest.mark.parametrize("dt", [0.02, 0.0005])
def test_instants_long_after_the_clocks_zero_survive_a_round_trip(tmp_path, start, dt):
    t = start + dt * np.arange(200)
    record = Record(t, np.sin(t)[:, None], np.cos(t)[:, None], ("lat",), ("p",))
    write_csv(tmp_path / "a.csv", record)
    again = read_csv(tmp_path / "a.csv", inputs=["lat"], outputs=["p"])
    np.testing.assert_allclose(again.t, t, rtol=0, atol=1e-5 * dt)
    assert again.equidistant == record.equidistant


def test_ordinary_instants_are_written_in_a_few_digits(tmp_path):
    t = 0.02 * np.arange(1000)
    write_csv(tmp_path / "a.csv", Record(t, 0 * t[:, None], t[:, None], ("lat",), ("p",)))
    rows = (tmp_path / "a.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows[:4]] == ["0", "0.02", "0.04", "0.06"]
    assert max(len(row.split(",")[0]) for row in rows) == len("19.98")


def test_inputs_of_a_slower_logger_are_filled_in_and_told(tmp_path):
    t = np.arange(0, 4, 0.05)
    ramp = np.where(np.arange(80) % 4 == 0, t, np.nan)
    ramp[40:60] = np.nan  # a second without any
    rows = [f"{a:.3f},{'' if np.isnan(b) else b},{np.sin(a)}" for a, b in zip(t, ramp, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,lat,p", *rows]) + "\n")
    with pytest.warns(DataWarning, match=r"lat 8.*left out"):
        record = read_csv(tmp_path / "log.csv", inputs=["lat"], outputs=["p"])
    np.testing.assert_allclose(record.u[:, 0], record.t, atol=1e-12)
    assert not ((record.t > t[36] + 1e-9) & (record.t < t[60] - 1e-9)).any()
    assert len(record.stretches()) == 2


def test_units_of_another_quantity_are_refused_of_time_and_told_of_channels(tmp_path):
    path = csv(tmp_path, "t,lat,p\n0,0,1\n1,1,2\n2,0,3\n")
    with pytest.raises(ValueError, match="time 't': no unit of time 'ft'"):
        read_csv(path, inputs=["lat"], outputs=["p"], units={"t": "ft"})
    with pytest.warns(DataWarning, match="p is said to be in kt, where rad/s is usual"):
        read_csv(path, inputs=["lat"], outputs=["p"], units={"p": "kt"})


def test_names_of_channels_are_read_back_or_refused(tmp_path):
    names = {"inputs": ('stick, "left"',), "outputs": ("p",)}
    record = Record(np.arange(3.0), np.ones((3, 1)), np.arange(3.0)[:, None], *names.values())
    write_csv(tmp_path / "a.csv", record)
    np.testing.assert_array_equal(read_csv(tmp_path / "a.csv", **names).y, record.y)
    with pytest.raises(ValueError, match="' p' begins or ends with a blank"):
        write_csv(tmp_path / "b.csv", replace(record, outputs=(" p",)))


def test_a_log_with_a_row_a_message_is_read_as_one_sample_an_instant(tmp_path):
    t = 1780358400 + 0.5 * np.arange(40)
    lines = [f"{a:.3f},{k},\n{a:.3f},,{k + 0.5}" for k, a in enumerate(t)]
    (tmp_path / "log.csv").write_text("\n".join(["t,lat,p", *lines]))
    with pytest.warns(DataWarning) as told:
        found = read_csv(tmp_path / "log.csv", inputs=["lat"], outputs=["p"])
    assert any("40 of 80 samples follow the one before" in str(each.message) for each in told)
    np.testing.assert_array_equal(found.t, t)
    np.testing.assert_array_equal(found.u[:, 0], np.arange(40))
    np.testing.assert_array_equal(found.y[:, 0], np.arange(40) + 0.5)
