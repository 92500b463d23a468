"""The package as a module."""

import subprocess
import sys


def test_the_package_runs_as_a_module():
    command = [sys.executable, "-m", "casid", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("Usage: casid [OPTIONS] COMMAND")
