"""What a result rests on beside data and settings: code of casid, of the user, of libraries."""

import ast
import hashlib
import importlib.util
import inspect
import sys
import sysconfig
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.metadata import version
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from casid.model import Model
from casid.nonlinear.model import NonlinearModel
from casid.values import digest

PACKAGE = Path(__file__).parents[1]
SHOWING = ("cli.py", "commands", "jobs", "report", "studies")  # change no result of a stage
LIBRARIES = ("casadi", "numpy", "scipy")  # whose versions change results


@lru_cache(maxsize=2)
def source_digest(*, shown: bool = False) -> str:
    """Digest of the code that computes results, and of the libraries it computes with.

    With ``shown`` of all code and templates of the package: of what shows results, too.
    """
    sha = hashlib.sha256(repr([(name, version(name)) for name in LIBRARIES]).encode())
    for file in sorted(PACKAGE.rglob("*.*" if shown else "*.py")):
        place = file.relative_to(PACKAGE)
        if place.suffix != ".pyc" and (shown or place.parts[0] not in SHOWING):
            sha.update(place.as_posix().encode() + file.read_bytes())
    return sha.hexdigest()


def structure_digest(path: str | Path) -> str:
    """Digest of a model file and of all modules of the user's that it imports, however deep."""
    return digest(sorted(structure_files(path).values()))


def structure_files(path: str | Path) -> dict[Path, bytes]:
    """Content of a model file and of all modules of the user's that it imports, however deep."""
    # Modules of Python's own library, of installed packages and of casid do not count.
    seen: dict[Path, bytes] = {}
    waiting = [(Path(path).resolve(), "")]
    while waiting:
        file, package = waiting.pop()
        if file not in seen:
            seen[file] = file.read_bytes()
            others = _libraries()  # not the user's
            waiting += [
                (each, parent)
                for each, parent in imported_files(file, package)
                if not any(map(each.is_relative_to, others))
            ]
    return seen


def own_source(function: Callable[..., Any]) -> bytes:
    """The file of a function that is no part of casid; nothing of one that is."""
    file = Path(inspect.getsourcefile(function) or __file__)
    return b"" if file.is_relative_to(PACKAGE) else file.read_bytes()


def equations_digest(model: Model) -> str:
    """Digest of what a structure's code builds and declares, whatever that reads on the way."""
    # Numbers from a data file, a time or an environment stand in expressions, bounds and names.
    built: list[Any] = [model.matrices().serialize(), model.states, model.inputs, model.outputs]
    built += [[(name, repr(info)) for name, info in model.infos().items()]]
    built += [[(each.name, each.lower, each.upper) for each in model.constraints()]]
    if isinstance(model, NonlinearModel):
        return digest(built, model.equations().serialize(), model.operating_point())
    return digest(built)


def imported_files(file: Path, package: str = "") -> Iterator[tuple[Path, str]]:
    """Files that the import statements of a module name, wherever they stand, and their packages.

    ``package`` is the module's own, from which relative imports count.
    """
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):  # it is no Python: there is nothing to follow
        return
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            try:
                name = resolve_name("." * node.level + (node.module or ""), package)
            except ImportError:  # outside of any package: Python refuses that line, too
                continue
            names = [name, *(f"{name}.{each.name}" for each in node.names)]
        for name in names:
            yield from _files_of(name)


def _files_of(name: str) -> Iterator[tuple[Path, str]]:
    """Source file of a module and its package, those of the packages around it before."""
    parts = name.split(".")
    for count in range(1, len(parts) + 1):
        whole = ".".join(parts[:count])
        try:
            known = getattr(sys.modules.get(whole), "__spec__", None)
            spec = known or importlib.util.find_spec(whole)
        except (ImportError, AttributeError, ValueError):  # no package, or half a module
            return
        if spec is None:
            return
        if spec.origin and spec.origin.endswith(".py"):  # a folder without __init__.py has no file
            yield Path(spec.origin).resolve(), spec.parent or ""


@lru_cache(maxsize=1)
def _libraries() -> tuple[Path, ...]:
    places = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    return (*(Path(place).resolve() for place in places), PACKAGE.resolve())
