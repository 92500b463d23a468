import subprocess
import sys
from pathlib import Path

import nptdms
import numpy as np
import pytest
from truths.logs import WRITERS, damaged, outcome

from casid import read_log

TESTS = Path(__file__).parents[1]
KIND = {
    ".ulg": "PX4 ULog",
    ".bin": "ArduPilot dataflash",
    ".tdms": "TDMS",
    ".log": "ArduPilot dataflash",
}


@pytest.fixture(scope="module", params=WRITERS)
def small(request):
    """A log of at most 64 kB, as text four times that."""
    data = WRITERS[request.param](5.0)
    assert len(data) < (2**18 if request.param.endswith(".log") else 2**16)
    return request.param, data


def test_the_first_bytes_say_what_a_log_is(tmp_path, small):
    name, data = small
    path = tmp_path / "named wrongly.csv"
    path.write_bytes(data)
    log = read_log(path)
    assert log.kind == KIND[Path(name).suffix]
    assert len(log.topics) >= 3


@pytest.mark.parametrize("data", [b"", b"t,p\n0,1\n", b"ULog", b"\0" * 100])
def test_what_is_no_log_is_refused(tmp_path, data):
    assert "it is no log of PX4" in outcome(tmp_path / "x.ulg", data)


def test_a_folder_and_a_missing_file_are_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none.ulg"):
        with pytest.raises(ValueError, match="cannot read it as a log"):
            read_log(path)


@pytest.mark.parametrize("package", ["pyulog", "pymavlink.DFReader", "nptdms"])
def test_a_missing_package_is_named_with_its_remedy(tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    names = dict(zip(["pyulog", "pymavlink.DFReader", "nptdms"], WRITERS.items(), strict=False))
    name, write = names[package]
    told = outcome(tmp_path / name, write(2.0))
    assert package in told
    assert "pip install 'casid[logs]'" in told


@pytest.mark.second
def test_a_log_cut_off_anywhere_gives_what_came_before(tmp_path, small):
    name, data = small
    whole = outcome(tmp_path / name, data)
    read = 0
    for percent in range(100):
        found = outcome(tmp_path / name, data[: len(data) * percent // 100])
        if isinstance(found, str):
            continue
        read += 1
        for key, topic in found.topics.items():
            n = len(topic.t)
            if " (" in key:  # channels that ended at other samples than the rest of their group
                continue
            np.testing.assert_array_equal(topic.t, whole.topics[key].t[:n])
            for column, x in topic.columns.items():
                np.testing.assert_array_equal(x, whole.topics[key].columns[column][:n])
    assert read >= 90 or name.endswith("tdms")  # one segment, whose sizes stand at its start


@pytest.mark.second
def test_damaged_logs_are_read_in_part_or_refused(tmp_path, small, capfd):
    name, data = small
    rng = np.random.default_rng(5)
    found = [outcome(tmp_path / name, damaged(data, rng)) for _ in range(60)]
    # Messages of dataflash stand alone: those that are whole are read, whatever the others hold.
    assert name.endswith(("bin", "log")) or any(isinstance(each, str) for each in found)
    assert any(not isinstance(each, str) for each in found)
    assert capfd.readouterr() == ("", "")


@pytest.mark.campaign
def test_ten_thousand_damaged_logs_stay_within_bounded_memory():
    code = f"import sys; sys.path.insert(0, {str(TESTS)!r}); from truths.logs import fuzz; fuzz()"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=4 * 3600)


def test_a_whole_log_without_a_clock_is_not_called_cut_off(tmp_path):
    path = tmp_path / "own.tdms"
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("G", "p", np.arange(9.0))])
    with pytest.raises(ValueError, match="could be read; group 'G': no time") as told:
        read_log(path)
    assert "called Time [s]" in str(told.value)
    assert "cut off" not in str(told.value)
