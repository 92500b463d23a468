"""Tests mirror the package: a module with behaviour has a test file of its own."""

import ast
import statistics
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = sorted((ROOT / "casid").rglob("*.py"))
NAMES = {"__main__.py": "main"}


def behaves(path):
    """Whether a module computes anything: packages' own files only re-export."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    made = any(isinstance(node, ast.FunctionDef | ast.ClassDef) for node in ast.walk(tree))
    return made and path.name != "__init__.py"


def file_of(path):
    """Where its tests are."""
    place = path.relative_to(ROOT / "casid")
    return ROOT / "tests" / place.with_name(f"test_{NAMES.get(path.name, path.stem)}.py")


def test_every_module_with_behaviour_has_tests_of_its_own():
    assert len(MODULES) > 100
    without = [
        str(file_of(path))
        for path in filter(behaves, MODULES)
        if not file_of(path).exists() or "def test_" not in file_of(path).read_text("utf-8")
    ]
    assert without == []


def test_modules_without_behaviour_are_few_and_known():
    still = {path.name for path in MODULES if not behaves(path)}
    assert still == {"__init__.py", "arrays.py", "look.py"}  # names of types, a style


def test_no_test_imports_another():
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = (
                [node.module or ""] if isinstance(node, ast.ImportFrom)
                else [each.name for each in node.names] if isinstance(node, ast.Import) else []
            )  # fmt: skip
            assert not any(part.startswith("test_") for n in names for part in n.split(".")), path


def test_modules_stay_short():
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert {path: n for path, n in lines.items() if n > 400} == {}
    assert statistics.median(lines.values()) <= 150


def test_lines_left_to_the_hand_are_few():
    assert sum(path.read_text(encoding="utf-8").count("# fmt: " + "skip") for path in MODULES) <= 40
