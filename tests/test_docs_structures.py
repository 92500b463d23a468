"""The page that tells how to declare a structure says what the code does."""

import re
import runpy
from pathlib import Path

import pytest

from casid import ModelError

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "structures.md").read_text(encoding="utf-8")
EXAMPLE = (ROOT / "examples" / "new_structure.py").read_text(encoding="utf-8")
HEAD = "from casid import Model, Rows, Scalar, parameter\n\n\n"


def declare(old="", new=""):
    """The page's own class, with one slip."""
    code = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)[0]
    assert old in code
    values = {"__name__": "page"}
    exec(compile(HEAD + code.replace(old, new, 1), "structures.md", "exec"), values)
    return values["DiskTilt"]


def test_every_python_block_is_in_the_example_that_is_run():
    blocks = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        assert block.strip() in EXAMPLE


def test_the_structure_takes_forty_lines():
    code = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 40


def test_every_model_file_is_in_the_gallery():
    for path in (ROOT / "models").glob("*.py"):
        assert f"`{path.name}`" in PAGE


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
def test_the_figures_of_the_page_are_those_of_the_example(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "examples" / "new_structure.py"), run_name="__main__")
    found = re.findall(r"J = (\d+), six degrees of freedom (\d+)", capsys.readouterr().out)
    own, rigid = re.search(r"has J = ([\d, and]+) for", PAGE), re.search(r"have (161[^.]*)\.", PAGE)
    for k, written in enumerate((own[1], rigid[1])):
        numbers = [int(value) for value in re.findall(r"\d+", written)]
        for value, pair in zip(numbers, found, strict=True):
            assert int(pair[k]) == pytest.approx(value, rel=0.1, abs=2)  # optima of other libraries
