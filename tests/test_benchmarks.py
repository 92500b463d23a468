"""Every benchmark finds what it imports of casid, of the gallery and of its neighbours."""

import ast
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "benchmarks").glob("*.py"))
OURS = {"casid", "models", "benchmarks"}


def test_there_are_benchmarks():
    assert len(FILES) > 20


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_what_a_benchmark_imports_is_there(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in OURS:
            module = import_module(node.module)
            for name in (each.name for each in node.names):
                if not hasattr(module, name):
                    import_module(f"{node.module}.{name}")  # a module, or nothing of ours
        elif isinstance(node, ast.ImportFrom):  # run as a program, it finds its neighbours
            beside = ROOT / "benchmarks" / f"{node.module}.py"
            names = ast.parse(beside.read_text(encoding="utf-8")).body if beside.exists() else []
            made = {getattr(each, "name", "") for each in names}
            made |= {t.id for each in names if isinstance(each, ast.Assign)
                     for t in ast.walk(each) if isinstance(t, ast.Name)}  # fmt: skip
            assert not names or {each.name for each in node.names} <= made
