"""Limits on files and on the user's code."""

import signal
import threading
import time

import pytest

from casid.limits import MIB, OutOfTimeError, check_file, check_size, time_limit


def test_what_is_no_ordinary_file_is_refused_by_kind(tmp_path):
    (tmp_path / "a").write_bytes(bytes(100))
    check_file(tmp_path / "a", 100, "CSV")
    with pytest.raises(ValueError, match="more than the 0 MiB that are read as CSV"):
        check_file(tmp_path / "a", 99, "CSV")
    with pytest.raises(ValueError, match="cannot read it as CSV: it is a folder; name a file"):
        check_file(tmp_path, 100, "CSV")
    with pytest.raises(ValueError, match="No such file"):
        check_file(tmp_path / "b", 100, "CSV")
    with pytest.raises(ValueError, match="null"):
        check_file(tmp_path / "a\0b", 100, "CSV")
    with pytest.raises(ValueError, match="3 MiB, more than the 2 MiB"):
        check_size(tmp_path / "a", 3 * MIB, 2 * MIB, "CSV")


def test_code_that_takes_too_long_is_interrupted_and_the_outer_limit_goes_on():
    with time_limit(1000.0):
        with pytest.raises(OutOfTimeError, match=r"longer than 0\.01 s"), time_limit(0.01):
            time.sleep(100)
        assert 0 < signal.getitimer(signal.ITIMER_REAL)[0] < 1000
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_outside_the_main_thread_there_is_no_limit():
    done = []

    def work():
        with time_limit(1e-3):
            time.sleep(0.01)
        done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done
