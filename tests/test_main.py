"""The package as a module."""

import os
import subprocess
import sys

import pytest
from truths.roll_study import write_study


def test_the_package_runs_as_a_module():
    command = [sys.executable, "-m", "casid", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("Usage: casid [OPTIONS] COMMAND")


@pytest.mark.second
def test_a_console_that_knows_few_characters_ends_no_command(tmp_path):
    write_study(tmp_path)
    command = [sys.executable, "-m", "casid", "check", "roll.py:Roll"]
    plain = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, cwd=tmp_path, env=plain, capture_output=True, check=True)
    assert b"0.108 ? 0.727j" in done.stdout
