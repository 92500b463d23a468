"""What a result rests on: the model file, whatever of the user's it imports, casid, libraries."""

import importlib
import sys

import pytest

from casid.jobs import origins
from casid.jobs.origins import imported_files, source_digest, structure_digest

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
    (tmp_path / "parts/__init__.py").write_text("", encoding="utf-8")
    (tmp_path / "parts/damping.py").write_text("Lp = -3.0\n", encoding="utf-8")
    (tmp_path / "stranger.py").write_text("", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield tmp_path
    for name in ("formulas", "deeper", "parts", "parts.damping"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    "file", ["roll.py", "formulas.py", "deeper.py", "parts/__init__.py", "parts/damping.py"]
)
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
    used = {path.name for path in imported_files(folder / "roll.py")}
    assert {"math.py", "formulas.py", "damping.py"} & used == {"formulas.py", "damping.py"}


def test_a_library_of_another_version_makes_other_results(monkeypatch):
    origins.source_digest.cache_clear()
    before = source_digest()
    real = origins.version
    for library in ("numpy", "scipy", "casadi"):
        with monkeypatch.context() as patch:
            patch.setattr(origins, "version", lambda n, one=library: real(n) + "x" * (n == one))
            origins.source_digest.cache_clear()
            assert source_digest() != before
    origins.source_digest.cache_clear()
    assert source_digest() == before
