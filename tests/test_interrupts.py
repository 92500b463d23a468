"""Ctrl-C at any moment: exit code 130, one line, and all that had ended is kept."""

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

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


def interrupted(program, moment, folder):
    """Stages kept by a run that a signal ended, with the times they were written, and its words."""
    command = [sys.executable, "-c", program, moment, "identify", str(folder / "study.toml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, (moment, done.stderr)
    assert "Traceback" not in done.stdout
    assert not list(folder.glob("out/**/*.partial"))
    kept = {path.stem: path.stat().st_mtime_ns for path in folder.glob("out/stages/*.json")}
    assert set(kept) == BEFORE[moment], moment
    return kept, done.stderr.splitlines()


@pytest.mark.slow
@pytest.mark.parametrize(
    "moments",
    [
        ("casadi", "casid.nlp._Watcher:eval:60", "matplotlib.backends.backend_svg"),
        pytest.param(tuple(BEFORE), marks=pytest.mark.campaign),
    ],
    ids=["three", "all"],
)
def test_an_interruption_at_any_moment_is_one_line_and_the_same_command_goes_on(moments, tmp_path):
    write_study(tmp_path)
    before = {}
    for moment in moments:
        kept, said = interrupted(PROGRAM, moment, tmp_path)
        lines = [line for line in said if "do not agree with kinematics" not in line]
        assert lines == ["Interrupted; what had ended is kept, the same command goes on."], moment
        assert before.items() <= kept.items(), moment
        before = kept


@pytest.mark.campaign
def test_a_run_that_is_terminated_ends_alike_and_leaves_no_lock(tmp_path):
    write_study(tmp_path)
    for moment in ("casid.nlp._Watcher:eval:60", "matplotlib.backends.backend_svg"):
        _, said = interrupted(PROGRAM.replace("SIGINT", "SIGTERM"), moment, tmp_path)
        assert "Interrupted; what had ended is kept" in said[-1]
        with claimed(tmp_path / "out"):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("sent", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.campaign)])
def test_a_command_that_keeps_nothing_does_not_say_that_it_goes_on(sent, tmp_path):
    study = write_study(tmp_path)
    moment, program = "casid.design.optimise.Task:slope:20", PROGRAM.replace("SIGINT", sent)
    command = [sys.executable, "-c", program, moment, "design", str(study), "--duration", "12"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stderr.splitlines()[-1] == "Interrupted."
    assert not (tmp_path / "out/design").exists()


STRIKE = "import os, signal; os.kill(os.getpid(), signal.SIGINT); [0 for _ in iter(int, 1)]"
PLACES = {
    "code made of text": "lambda: exec(STRIKE)",
    "end of an object": "type('Mortal', (), {'__del__': lambda _: exec(STRIKE)})",
}


@pytest.mark.parametrize("place", PLACES)
def test_an_interruption_where_python_loses_it_ends_alike(place, tmp_path):
    program = f"""
    from casid import __main__, cli, interrupts

    STRIKE = {STRIKE!r}
    cli.main = lambda **_: [({PLACES[place]})(), interrupts.check_interrupt()]
    __main__.main()
    """
    (tmp_path / "struck.py").write_text(dedent(program), encoding="utf-8")
    places = {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(__file__).parents[1])])}
    command = [sys.executable, "-m", "struck"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=False, env=os.environ | places
    )
    assert (done.returncode, done.stderr) == (130, "Interrupted.\n")
