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


def complaints(checker, *files):
    """Lines of errors of a checker."""
    program = Path(sys.executable).with_name(CHECKERS[checker][0])
    run = subprocess.run(
        [program, *CHECKERS[checker][1:], *files], capture_output=True, text=True, cwd=ROOT,
        check=False,
    )  # fmt: skip
    return [line for line in run.stdout.splitlines() if re.search(r"\berror: |- error: ", line)]


@pytest.mark.slow
@pytest.mark.parametrize("checker", CHECKERS)
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
