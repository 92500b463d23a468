"""What a model file rests on, and Python's own memory of it."""

import importlib
import sys

import pytest

from casid import DataWarning, ModelError
from casid.jobs.digests import structure_digest
from casid.structure.imports import imported_files, structure_files
from casid.structure.modelfile import load_model

MODEL = """
import math
import numpy as np
import formulas
from casid import Model


class Roll(Model):
    states, inputs, outputs = ("p",), ("lat",), ("p",)

    def A(self):
        from parts.damping import Lp  # where it is needed
        return [[Lp]]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "roll.py").write_text(MODEL, encoding="utf-8")
    (tmp_path / "formulas.py").write_text("import deeper\n", encoding="utf-8")
    (tmp_path / "deeper.py").write_text("g = 9.81\n", encoding="utf-8")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/__init__.py").write_text("from . import limits\n", encoding="utf-8")
    (tmp_path / "parts/limits.py").write_text("from .far.away import k\n", encoding="utf-8")
    (tmp_path / "parts/far").mkdir()  # a folder without __init__.py is a package, too
    (tmp_path / "parts/far/away.py").write_text("from ..near import k\n", encoding="utf-8")
    (tmp_path / "parts/near.py").write_text("k = 2.0\n", encoding="utf-8")
    (tmp_path / "parts/damping.py").write_text("Lp = -3.0\n", encoding="utf-8")
    (tmp_path / "stranger.py").write_text("", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield tmp_path
    for name in [n for n in sys.modules if n.split(".")[0] in {"formulas", "deeper", "parts"}]:
        del sys.modules[name]


@pytest.mark.parametrize(
    "file",
    ["roll.py", "formulas.py", "deeper.py", "parts/__init__.py", "parts/damping.py",
     "parts/limits.py", "parts/far/away.py", "parts/near.py"],
)  # fmt: skip
def test_whatever_of_the_users_a_model_imports_changes_its_digest(file, folder):
    before = structure_digest(folder / "roll.py")
    assert structure_digest(folder / "roll.py") == before
    with (folder / file).open("a", encoding="utf-8") as changed:
        changed.write("x = 1\n")
    assert structure_digest(folder / "roll.py") != before


def test_what_a_model_does_not_import_and_libraries_do_not_count(folder):
    before = structure_digest(folder / "roll.py")
    (folder / "stranger.py").write_text("x = 1\n", encoding="utf-8")
    assert structure_digest(folder / "roll.py") == before
    used = {path.name for path, _ in imported_files(folder / "roll.py")}
    assert {"math.py", "formulas.py", "damping.py"} & used == {"formulas.py", "damping.py"}


GAINED = """
from casid import Model, Scalar, parameter
from {name} import G


class Roll(Model):
    states, inputs, outputs = ("p",), ("lat",), ("p",)
    Lp: Scalar = parameter(default=-5.0, lower=-25.0, upper=0.0, unit="1/s")

    def A(self):
        return [[self.Lp]]

    def B(self):
        return [[G]]
"""


def gained(folder, G, name="gains_of_roll"):
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(f"G = {G}\n", encoding="utf-8")
    (folder / "roll.py").write_text(GAINED.format(name=name), encoding="utf-8")
    return folder


@pytest.fixture
def path(monkeypatch):
    yield lambda folder: (monkeypatch.syspath_prepend(folder), importlib.invalidate_caches())
    sys.modules.pop("gains_of_roll", None)


def test_modules_beside_a_model_file_are_found_from_elsewhere(tmp_path, monkeypatch):
    folder, before = gained(tmp_path / "beside", 3.0, "gains_beside"), list(sys.path)
    late = folder / "roll.py"
    late.write_text(late.read_text(encoding="utf-8") + "\n    def C(self):\n        import later\n")
    (folder / "later.py").touch()
    monkeypatch.chdir(tmp_path)
    assert load_model("beside/roll.py:Roll").states == ("p",)
    assert {"gains_beside.py", "later.py"} <= {each.name for each in structure_files(late)}
    assert sys.path == before


def test_a_module_of_the_same_name_of_another_folder_is_refused(tmp_path, path):
    one, other = gained(tmp_path / "one", 1.0), gained(tmp_path / "other", 4.0)
    path(one)
    assert load_model("roll.py:Roll", one)().system().B == 1.0
    path(other)
    with pytest.raises(ModelError, match=r"imports gains_of_roll, which Python has from .*one"):
        load_model("roll.py:Roll", other)


@pytest.mark.second
def test_a_module_that_changed_since_it_was_imported_is_told_until_it_is_read_anew(tmp_path, path):
    path(gained(tmp_path, 1.0))
    assert load_model("roll.py:Roll", tmp_path)().system().B == 1.0
    gained(tmp_path, 25.0)
    with pytest.warns(DataWarning, match=r"gains_of_roll\.py has changed since Python imported it"):
        assert load_model("roll.py:Roll", tmp_path)().system().B == 1.0
    importlib.reload(sys.modules["gains_of_roll"])
    assert load_model("roll.py:Roll", tmp_path)().system().B == 25.0
