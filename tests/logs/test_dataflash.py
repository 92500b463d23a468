import numpy as np
import pytest
from pymavlink import DFReader
from truths.logs import FORMAT, dataflash, dataflash_text, flight

from casid import read_log
from casid.logs.conventions import check_units, find_channels, with_units
from casid.logs.dataflash import read_dataflash, read_text


def topics(data):
    return {topic.name: topic for topic in read_dataflash(data, DFReader)[0]}


def test_values_and_stamps_are_those_of_pymavlink(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(2.0))
    rows = []
    with DFReader.DFReader_binary(str(path), zero_time_base=True) as log:
        while (row := log.recv_match(type="ATT")) is not None:
            rows.append((row.TimeUS * 1e-6, row.Roll, row.Pitch))
    t, roll, pitch = np.array(rows).T
    topic = topics(path.read_bytes())["ATT"]
    np.testing.assert_allclose(topic.t, t, rtol=1e-15)
    np.testing.assert_allclose(topic.columns["Roll"], np.radians(roll), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(topic.columns["Pitch"], np.radians(pitch), rtol=1e-14, atol=1e-15)


def test_units_multipliers_and_instances_are_the_logs_own():
    t, x = flight(2.0)
    found = topics(dataflash(2.0))
    assert {"IMU[0]", "IMU[1]", "RATE", "ATT"} <= set(found)
    np.testing.assert_allclose(found["IMU[0]"].t, 1000 + t, rtol=1e-12)
    np.testing.assert_allclose(found["IMU[0]"].columns["GyrX"], x["p"], rtol=1e-6)  # 32 bits
    assert found["IMU[1]"].t[0] == pytest.approx(1000.0001, abs=1e-9)
    np.testing.assert_allclose(found["ATT"].columns["Roll"], x["phi"][::4], atol=0.51e-4 * np.pi)


def test_damage_costs_the_messages_it_hits():
    data = bytearray(dataflash(2.0))
    whole = topics(bytes(data))
    at = data.index(b"\xa3\x95\x05", len(data) // 2)  # a RATE in the middle
    data[at : at + 3] = b"\0\0\0"
    found, notes = read_dataflash(bytes(data), DFReader)
    found = {topic.name: topic for topic in found}
    assert len(found["RATE"].t) == len(whole["RATE"].t) - 1
    assert len(found["ATT"].t) == len(whole["ATT"].t)
    assert notes == ("23 bytes between messages are damaged and left out",)


def test_formats_that_lie_about_their_length_are_not_believed():
    writer = type("Writer", (), {"formats": {0x80: FORMAT}})()
    form = bytearray(DFReader.DFReader_binary.make_format_msgbuf(writer, FORMAT))
    for length in range(256):
        form[3:5] = bytes([7, length])  # type 7, FMT's own fields
        assert topics(bytes(form) + b"\xa3\x95\x07" + bytes(300)) == {}


def text_topics(data):
    found, notes = read_text(data, DFReader)
    return {topic.name: topic for topic in found}, notes


def test_a_log_as_text_says_what_it_said_before():
    whole, (found, notes) = topics(dataflash(1.0)), text_topics(dataflash_text(1.0))
    assert not notes
    assert list(found) == list(whole)
    for name, topic in whole.items():
        np.testing.assert_allclose(found[name].t, topic.t, rtol=1e-15)
        for column, x in topic.columns.items():  # 8 bits of a letter c, 32 of f: printed in full
            np.testing.assert_allclose(found[name].columns[column], x, rtol=1e-6, atol=1e-12)


def test_pymavlink_reads_the_same_of_a_log_as_text(tmp_path):
    path = tmp_path / "flight.log"
    path.write_bytes(dataflash_text(1.0))
    log, rows = DFReader.DFReader_text(str(path), zero_time_base=True), []
    while (row := log.recv_match(type="ATT")) is not None:
        rows.append((row.TimeUS * 1e-6, row.Roll))
    log.filehandle.close()
    t, roll = np.array(rows).T
    topic = text_topics(path.read_bytes())[0]["ATT"]
    np.testing.assert_allclose(topic.t, t, rtol=1e-15)
    np.testing.assert_allclose(topic.columns["Roll"], np.radians(roll), rtol=1e-14, atol=1e-15)


def test_lines_that_are_damaged_cost_themselves():
    lines = dataflash_text(1.0).decode().splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("RATE"))
    whole = text_topics("\n".join([*lines, ""]).encode())[0]
    lines[at] = lines[at][:9]
    lines.insert(at, "RATF, 1, 2, 3, 4")
    found, notes = text_topics("\n".join([*lines, ""]).encode())
    assert len(found["RATE"].t) == len(whole["RATE"].t) - 1
    assert notes == ("2 lines damaged and left out",)


def test_a_logger_that_began_anew_is_told(tmp_path):
    path = tmp_path / "flight.log"
    lines = dataflash_text(1.0).decode().splitlines()
    again = [line for line in lines if not line.startswith("FMT")]
    path.write_text("\n".join([*lines, *again, ""]))
    *_, note = read_log(path).notes
    topic = read_log(path).topics["ATT"]
    assert topic.left_out >= len(topic.t) - 1
    assert "left out whose clock went back" in note
    assert "the logger began anew" in note


def test_stamps_that_repeat_are_told_as_that(tmp_path):
    path = tmp_path / "flight.log"
    lines = dataflash_text(1.0).decode().splitlines()
    at = [k for k, line in enumerate(lines) if line.startswith("ATT,")][3:8]
    for k in reversed(at):
        lines.insert(k, lines[k])
    path.write_text("\n".join([*lines, ""]))
    log = read_log(path)
    (note,) = (each for each in log.notes if "left out" in each)
    assert note.startswith("5 samples left out whose time stamps repeat those of others, most of ")
    assert "ATT (5 of " in note
    assert not any("went back" in each for each in log.notes)
    path.write_bytes(dataflash_text(1.0))
    assert not any("left out" in each for each in read_log(path).notes)


@pytest.mark.parametrize("name", ["flight.bin", "flight.log"])
def test_messages_without_units_have_those_that_ardupilot_documents(name, tmp_path):
    whole, silent = topics(dataflash(1.0)), dataflash(1.0).replace(b"FMTU", b"FMTX")
    lines = [line for line in dataflash_text(1.0).splitlines(keepends=True) if b"FMTU" not in line]
    (tmp_path / name).write_bytes(silent if name.endswith("bin") else b"".join(lines))
    log = read_log(tmp_path / name)
    for topic in ("ATT", "IMU[0]", "IMU[1]"):
        for column, x in whole[topic].columns.items():
            found = log.topics[topic].columns[column]
            np.testing.assert_allclose(found, x, rtol=1e-6, atol=1e-12)
    said = "the log has no units of ATT, IMU, RATE: taken as ArduPilot's documentation has them"
    assert said in log.notes
    outputs = find_channels(log)[1]
    stated = with_units(outputs, {"phi": "deg", "p": "deg/s"})  # as the column stands in the log
    np.testing.assert_allclose(stated["phi"].values, outputs["phi"].values, rtol=1e-12)
    np.testing.assert_allclose(stated["p"].values, np.radians(outputs["p"].values), rtol=1e-12)


def test_units_that_nobody_knows_are_told(tmp_path):
    rows = (f"GYR9, {k}, {k % 7}\n" for k in range(1, 99))
    path = tmp_path / "flight.log"
    path.write_text("FMT, 7, 15, GYR9, Qf, TimeUS,p\n" + "".join(rows), "utf-8")
    _, outputs = find_channels(read_log(path))
    assert check_units(path, outputs) == ["unit of p not stated: taken as rad/s"]


def test_modes_written_as_words_are_no_numbers():
    said = b"FMT, 7, 12, MODE, QM, TimeUS,Mode\nMODE, 5, STABILIZE\nMODE, 9, 3\n"
    values = text_topics(said)[0]["MODE"].columns["Mode"]
    np.testing.assert_array_equal(values, [np.nan, 3.0])
