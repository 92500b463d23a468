"""Declarations before the type checkers that users' editors run."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "how-to" / "structure.md").read_text(encoding="utf-8")
FILE = re.search(r'```python title="disk_tilt.py"\n(.*?)```', PAGE, flags=re.DOTALL)[1]
CHECKERS = {
    "mypy": ["mypy", "--strict", "--cache-dir", str(ROOT / ".mypy_cache")],
    "pyright": ["pyright", "--pythonpath", sys.executable],
}
SLIPS = [  # text replaced, or a line added to the file; what the one complaint names, if any
    ("", "DiskTilt(Lfs=-8.0, Lfc=1).A()", ""),
    ("self.Lfc, self.Lfs]", "self.Lfc, self.Lfs1]", "Lfs1"),
    ("", "DiskTilt(Lfs1=1.0)", "Lfs1"),
    ("", 'DiskTilt(Lfs="1.0")', "Lfs"),
    ("", "DiskTilt(-8.0)", "positional"),
    ("", "DiskTilt().Lfs = 1.0", "Lfs"),
]


USE = """
from typing import assert_type

import numpy as np

from casid import (
    BlackBox, Derivid, DerividNotes, Estimator, Fit, FrequencyResponse, Match, MatchNotes,
    OutputError, OutputErrorNotes, Record, derivid, match, output_error,
)
from models.six_dof import SixDof


def use(box: BlackBox, response: FrequencyResponse, record: Record, other: Estimator) -> None:
    assert_type(match(SixDof(), box), Fit[SixDof, MatchNotes])
    assert_type(derivid(SixDof(), response), Fit[SixDof, DerividNotes])
    assert_type(output_error(SixDof(), record), Fit[SixDof, OutputErrorNotes])
    fit = match(SixDof(), [box, response])
    print(fit.model.Lp, fit.notes.peak.omega, Match(norm="hinf").fit(fit.model, box).model.Mq)
    print(OutputError().fit(fit.model, [record], near=fit).notes.rounds)
    print(derivid(fit.model, response).notes.pairs[0].J)
    print(other.fit(SixDof(), [record], bounds={"Lp": (-9.0, 0.0)}).model.Lp)
    estimators: list[Estimator] = [Match(), OutputError(), Derivid()]
    print(estimators, np.sqrt(other.fit(SixDof(), record).cost))
"""
MISUSE = [  # a line in the function above, and what the one complaint names
    ("match(SixDof(), box).model.Lq2", "Lq2"),
    ("match(SixDof(), box).notes.rounds", "rounds"),
    ("OutputError(intervall=1.0)", "intervall"),
    ("match(SixDof(), box).cost = 1.0", "cost"),
    ('Match(solver="quick")', "solver"),
]


def complaints(checker, *files):
    """Lines of errors of a checker."""
    program = Path(sys.executable).with_name(CHECKERS[checker][0])
    run = subprocess.run(
        [program, *CHECKERS[checker][1:], *files], capture_output=True, text=True, cwd=ROOT,
        check=False,
    )  # fmt: skip
    return [line for line in run.stdout.splitlines() if re.search(r"\berror: |- error: ", line)]


@pytest.mark.slow
@pytest.mark.parametrize("checker", [pytest.param("mypy", marks=pytest.mark.campaign), "pyright"])
def test_checkers_accept_the_gallery_and_point_at_every_slip(checker, tmp_path):
    if checker == "pyright" and shutil.which("node") is None:
        pytest.skip("pyright runs on node")
    files = sorted((ROOT / "models").glob("*.py"))
    for number, (old, new, _) in enumerate(SLIPS):
        text = FILE.replace(old, new, 1) if old else f"{FILE}\n\n{new}\n"
        files.append(tmp_path / f"slip{number}.py")
        files[-1].write_text(text, encoding="utf-8")
    lines = complaints(checker, *files)
    for number, (_, _, word) in enumerate(SLIPS):
        own = [line for line in lines if f"slip{number}.py" in line]
        assert len(own) == bool(word), own
        assert word in "".join(own)
    assert not [line for line in lines if "slip" not in line]


@pytest.mark.slow
@pytest.mark.parametrize("checker", [pytest.param("mypy", marks=pytest.mark.campaign), "pyright"])
def test_checkers_know_the_model_and_the_notes_of_a_fit(checker, tmp_path):
    if checker == "pyright" and shutil.which("node") is None:
        pytest.skip("pyright runs on node")
    files = []
    for number, (line, _) in enumerate([("", ""), *MISUSE]):
        files.append(tmp_path / f"use{number}.py")
        files[-1].write_text(f"{USE}    {line}\n", encoding="utf-8")
    lines = complaints(checker, *files)
    for number, (_, word) in enumerate([("", ""), *MISUSE]):
        own = [each for each in lines if f"use{number}.py" in each]
        assert len(own) == bool(word), own
        assert word in "".join(own)
