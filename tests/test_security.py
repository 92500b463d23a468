"""What casid executes, what its files may make, and what it depends on."""

import ast
import json
import re
import tomllib
from importlib.metadata import distribution, metadata
from pathlib import Path

import pytest
from truths.bad_inputs import CORPUS
from truths.roll_study import Truth

import casid
from casid import files, limits
from casid.jobs.store import Done, Store
from casid.studies import settings
from casid.values import content_digest

ROOT = Path(__file__).parents[1]
SOURCES = sorted(Path(casid.__file__).parent.rglob("*.py"))
PAGE = (ROOT / "docs/reliability.md").read_text(encoding="utf-8")

MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "code",
           "codeop", "runpy", "subprocess", "ctypes", "yaml"}  # fmt: skip
BUILTINS = {"eval", "exec", "compile", "__import__"}
METHODS = {"system", "popen", "loads_pickle", "read_pickle", "to_pickle", "exec_module"}


@pytest.mark.second
def test_nothing_in_casid_unpickles_evaluates_or_executes():
    executing = []
    for source in SOURCES:
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            names = set()
            if isinstance(node, ast.Import):
                names = {each.name.split(".")[0] for each in node.names} & MODULES
            elif isinstance(node, ast.ImportFrom):
                names = {str(node.module).split(".")[0]} & MODULES
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                names = {node.func.id} & BUILTINS
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                owner = node.func.value
                mine = METHODS - ({"system"} if not _is_os(owner) else set())
                names = {node.func.attr} & mine
                assert not any(key.arg == "allow_pickle" for key in node.keywords), source
            executing += [(source.name, name) for name in names]
    assert sorted(executing) == [
        ("modelfile.py", "exec_module"),
        ("transport.py", "cloudpickle"),  # between casid's own processes
        ("transport.py", "pickle"),
    ]


def _is_os(owner):
    return isinstance(owner, ast.Name) and owner.id in {"os", "subprocess"}


@pytest.mark.parametrize(
    "value", ["casid.textfile:write_text", "write_text", "os:system", "Path", "Model"]
)
def test_a_stored_result_makes_nothing_but_results(value, tmp_path):
    target = tmp_path / "owned.txt"
    fields = {"path": str(target), "text": "owned", "command": f"touch {target}"}
    store = Store(tmp_path, (Truth,))
    store.put("pbsid", "k", Done(result=1.0))
    assert store.get("pbsid", "k").result == 1.0
    content = json.loads((tmp_path / "pbsid.json").read_text(encoding="utf-8"))
    content["result"] = {"value": value, "fields": fields}
    content["digest"] = content_digest(content)
    (tmp_path / "pbsid.json").write_text(json.dumps(content), encoding="utf-8")
    assert store.get("pbsid", "k") is None
    assert not target.exists()


# ---- what the documentation says ---------------------------------------------------------------


def rows(heading):
    """Cells of the tables under a heading of the page, without their own headings."""
    part = PAGE.split(f"{heading}\n", maxsplit=1)[1].split("\n#")[0]
    lines = [[cell.strip() for cell in line.strip("|").split("|")]
             for line in part.splitlines() if line.startswith("|")]  # fmt: skip
    return [line for line in lines
            if not set(line[0]) <= {"-"} and line[0] not in {"package", "what"}]  # fmt: skip


def test_every_dependency_is_listed_with_a_reason_and_the_licence_it_declares():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = [
        *project["dependencies"],
        *(package for kind in ("tables", "logs", "fmu") for package in extras[kind]),
    ]
    table = rows("## Dependencies")
    listed = {name: (reason, said) for name, reason, said in table if "(shipped" not in name}
    assert set(listed) == {re.split(r"[<>=\[ ;]", each)[0] for each in wanted}
    for name, (reason, licence) in listed.items():
        assert reason
        assert re.search(SAID[licence.split()[0]], declared(name)), name


SAID = {  # how packages call the licences
    "BSD-3-Clause": "BSD",
    "BSD-2-Clause": "2-Clause BSD",
    "MIT": "MIT",
    "Apache-2.0": "Apache",
    "LGPL-3.0-only": "LGPL-3.0-only",
    "LGPL-3.0-or-later": "Lesser General Public License v3",
    "PSF-like": "Python Software Foundation|matplotlib",
}


def declared(name):
    found = metadata(name)
    classifiers = [each for each in found.get_all("Classifier") or [] if "License" in each]
    said = (found.get("License-Expression"), found.get("License"), *classifiers)
    files = distribution(name).files or []
    texts = (file.read_text("utf-8") for file in files if file.name in {"LICENSE", "LICENSE.txt"})
    return " ".join(each for each in said if each) or next(texts, "")


def test_the_limits_are_those_of_the_code():
    said = dict(rows("### Size limits"))
    mib = [limits.TABLE_BYTES, limits.JSON_BYTES, limits.TEXT_BYTES]
    assert list(said.values()) == [
        *(f"{size // limits.MIB} MiB" for size in mib),
        f"{files.HEADER_CHARACTERS} characters",
        f"{settings.MOST_POINTS}",
        f"{limits.USER_SECONDS:g} s",
    ]


def test_the_bad_inputs_are_as_many_as_the_page_says():
    assert f"holds {len(CORPUS)} of them" in PAGE
