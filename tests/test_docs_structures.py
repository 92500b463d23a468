"""The page that tells how to declare a structure says what the code does."""

import re
import runpy
from pathlib import Path

import pytest

from casid import ModelError

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "how-to" / "structure.md").read_text(encoding="utf-8")
GALLERY = (ROOT / "docs" / "structures.md").read_text(encoding="utf-8")
EXAMPLE = (ROOT / "examples" / "new_structure.py").read_text(encoding="utf-8")
FILE = re.search(r'```python title="disk_tilt.py"\n(.*?)```', PAGE, flags=re.DOTALL)[1]


def declare(old="", new=""):
    """The page's own class, with one slip."""
    assert old in FILE
    values = {"__name__": "page"}
    exec(compile(FILE.replace(old, new, 1), "disk_tilt.py", "exec"), values)
    return values["DiskTilt"]


def test_the_structure_is_that_of_the_example():
    assert FILE[FILE.index("class DiskTilt") :].strip() in EXAMPLE


def test_the_structure_takes_forty_lines():
    assert len([line for line in FILE.splitlines() if line.strip()]) <= 40


def test_every_model_file_is_in_the_gallery():
    for path in (ROOT / "models").glob("*.py"):
        assert f"`{path.name}`" in GALLERY


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("self.Lfc, self.Lfs]", "self.Lfc, self.Lfs1]"),
        ("[self.Mflat, self.Mflon]", "[self.Mflat, self.Mflon, 0]"),
        ("[0, -1, self.Mfc, self.Mfs]", "[0, 0, 0, 0]"),
        ("    def B", "    def C(self): return [[1, 0, 0, 0], [0, 0, 0, 0]]\n\n    def B"),
        ('lower=-40.0, upper=0.0, unit="1/s")\n    Mflat', "lower=-40.0, upper=0.0)\n    Mflat"),
        ("    def B", '    def delays(self): return {"ped": 0.1}\n\n    def B'),
    ],
)
def test_a_slip_is_told_in_the_words_of_the_page(old, new):
    def make():
        if old.startswith("[0, -1"):  # a state without dynamics has no entry in B either
            code = declare(old, new)
            code.B = lambda self: [[self.Llat, 0], [self.Mlat, 0], [0, 0], [self.Lflat, 0]]
            return code().matrices()
        return declare(old, new)().matrices()

    with pytest.raises(ModelError) as caught:
        make()
    assert f"`{caught.value}`" in PAGE


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:derivid. measured responses are farther off")  # they are
def test_the_figures_of_the_page_are_those_of_the_example(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "examples" / "new_structure.py"), run_name="__main__")
    found = re.findall(r"J = (\d+), six degrees of freedom (\d+)", capsys.readouterr().out)
    own = re.findall(r"^[pq]/l\w+: J = (\d+)$", PAGE, flags=re.MULTILINE)
    rigid = re.findall(r"\d+", re.search(r"have J = (151[^.]*) for", PAGE)[1])
    for written, pair in zip(zip(own, rigid, strict=True), found, strict=True):
        for shown, value in zip(written, pair, strict=True):  # optima of other libraries
            assert int(value) == pytest.approx(int(shown), rel=0.1, abs=2)
