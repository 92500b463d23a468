"""What a model file imports of the user's own modules, and whether Python has these as they are.

Python imports a module once in a process, by its name. A file that reads ``consts`` gets what
another of that name was read for first, and what it was then, however often it has changed.
"""

import ast
import hashlib
import importlib.util
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib.util import resolve_name
from pathlib import Path

from casid.errors import ModelError, warn

PACKAGE = Path(__file__).resolve().parents[1]
_READ: dict[Path, tuple[object, str]] = {}  # of modules as they were imported


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """A context in which modules of a folder are found, behind all others."""
    name = str(folder)
    sys.path.append(name)
    try:
        yield
    finally:
        del sys.path[len(sys.path) - 1 - sys.path[::-1].index(name)]


def check_imports(path: Path) -> None:
    """Refuse a module that is another file's, and warn of one that has changed since.

    Of the user's modules that a model file imports, which has just been executed.
    """
    used = structure_files(path)
    if not used.keys() - {path}:
        return  # to find where every module of Python's is takes a while
    by_file = {
        Path(file).resolve(): module
        for module in list(sys.modules.values())
        if (file := getattr(module, "__file__", None))
    }
    for file, held in used.items():
        if (module := by_file.get(file)) is not None and file != path:
            spec, now = getattr(module, "__spec__", None), hashlib.sha256(held).hexdigest()
            known, then = _READ.get(file, (None, now))
            if known is spec and then != now:
                warn(
                    f"{file} has changed since Python imported it, and counts as it was: start "
                    f"Python anew, or importlib.reload({module.__name__}) before the model is read"
                )
            else:
                _READ[file] = spec, now
            beside = path.parent / Path(*module.__name__.split(".")).with_suffix(".py")
            if beside.is_file() and beside.resolve() != file:
                raise ModelError(
                    f"{path} imports {module.__name__}, which Python has from {file} and not from "
                    f"{beside}: rename one of them, or read the models in processes of their own"
                )


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
            with importable(Path(path).resolve().parent):
                waiting += [
                    (each, parent)
                    for each, parent in imported_files(file, package)
                    if not any(map(each.is_relative_to, others))
                ]
    return seen


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
    return (*(Path(place).resolve() for place in places), PACKAGE)
