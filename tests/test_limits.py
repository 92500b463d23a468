"""Limits on files and on the user's code."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from casid.limits import MIB, OutOfTimeError, check_file, check_size, time_limit

PROGRAM = "import casid.cli; casid.cli.main()"


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


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("where", ["the top", "a method", "both"])
def test_a_model_that_ends_the_process_is_told(where, tmp_path):
    leave = "    os._exit(0)" if where == "a method" else "    pass"
    body = "_exit = os._exit" if where == "both" else ""
    if where == "both":  # kept from the import
        leave = "    _exit(0)"
    top = "os._exit(0)" if where == "the top" else ""
    text = f"""
import os
from casid import Model, parameter
{top}
{body}
class Ends(Model):
    states, inputs, outputs = ("p",), ("u",), ("p",)
    Lp: float = parameter(default=-1.0, unit="1/s")
    def A(self):
    {leave}
    def B(self):
        return [[1.0]]
"""
    (tmp_path / "ends.py").write_text(text, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, "check", f"{tmp_path / 'ends.py'}:Ends"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 2
    assert "SystemExit: it called os._exit(0)" in " ".join(run.stderr.split())
    assert "Traceback" not in run.stderr


def test_after_the_users_code_the_process_can_end_again():
    leave = os._exit
    with time_limit(9.0), pytest.raises(SystemExit, match=r"called os\._exit\(3\)"):
        os._exit(3)
    assert os._exit is leave


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
