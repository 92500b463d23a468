"""Ctrl-C at any moment: exit code 130, one line, and all that had ended is kept."""

import subprocess
import sys

import pytest
from truths.roll_study import write_study

from casid.folder import claimed

# Sends the process an interrupt when a module is looked for the first time, or when a method of
# casid is called for the n-th time.
PROGRAM = """
import os, signal, sys

moment, *words = sys.argv[1:]
sys.argv = ["casid", *words]


def strike():
    os.kill(os.getpid(), signal.SIGINT)


class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == moment:
            sys.meta_path.remove(self)
            strike()


if ":" in moment:
    place, name, count = moment.split(":")
    module, _, owner = place.rpartition(".")
    found = getattr(__import__(module, fromlist=[owner]), owner)
    honest, calls = getattr(found, name), []

    def counted(*arguments, **options):
        calls.append(1)
        if len(calls) == int(count):
            strike()
        return honest(*arguments, **options)

    setattr(found, name, counted)
else:
    sys.meta_path.insert(0, Finder())
from casid.__main__ import main

main()
"""
BEFORE = {  # what is kept by then
    "click": set(),
    "casadi": set(),
    "scipy.interpolate": set(),
    "casid.studies.runner": set(),
    "casid.files.Path:read_text:1": set(),
    "casid.nlp._Watcher:eval:1": {"pbsid"},
    "casid.nlp._Watcher:eval:60": {"pbsid", "quadratic"},
    "casid.report.html:body:3": {"pbsid", "quadratic", "hinf", "output_error"},
    "matplotlib.backends.backend_svg": {"pbsid", "quadratic", "hinf", "output_error"},
}


@pytest.mark.slow
@pytest.mark.parametrize("moment", BEFORE)
def test_an_interruption_at_any_moment_is_one_line_and_keeps_what_had_ended(moment, tmp_path):
    study = write_study(tmp_path)
    command = [sys.executable, "-c", PROGRAM, moment, "identify", str(study)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    lines = [
        line for line in done.stderr.splitlines() if "do not agree with kinematics" not in line
    ]
    assert lines == ["Interrupted; what had ended is kept, the same command goes on."]
    assert "Traceback" not in done.stdout
    assert {path.stem for path in tmp_path.glob("out/stages/*.json")} == BEFORE[moment]
    assert not list(tmp_path.glob("out/**/*.partial"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "moment", ["casid.nlp._Watcher:eval:60", "matplotlib.backends.backend_svg"]
)
def test_a_run_that_is_terminated_ends_alike_and_leaves_no_lock(moment, tmp_path):
    study = write_study(tmp_path)
    program = PROGRAM.replace("SIGINT", "SIGTERM")
    command = [sys.executable, "-c", program, moment, "identify", str(study)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    assert "Interrupted; what had ended is kept" in done.stderr.splitlines()[-1]
    assert {path.stem for path in tmp_path.glob("out/stages/*.json")} == BEFORE[moment]
    with claimed(tmp_path / "out"):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("sent", ["SIGINT", "SIGTERM"])
def test_a_command_that_keeps_nothing_does_not_say_that_it_goes_on(sent, tmp_path):
    study = write_study(tmp_path)
    moment, program = "casid.design.optimise.Task:slope:20", PROGRAM.replace("SIGINT", sent)
    command = [sys.executable, "-c", program, moment, "design", str(study), "--duration", "12"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stderr.splitlines()[-1] == "Interrupted."
    assert not (tmp_path / "out/design").exists()
