"""Model structures from files that casid does not know: ``models/six_dof.py:SixDof``."""

import hashlib
import importlib.util
import sys
from dataclasses import MISSING, fields
from pathlib import Path
from types import ModuleType

from casid import limits
from casid.errors import ModelError
from casid.limits import TEXT_BYTES, OutOfTimeError, check_file, time_limit
from casid.model import Model
from casid.structure.imports import check_imports, importable


def load_model(reference: str, folder: str | Path = ".") -> type[Model]:
    """The structure's class that a reference names.

    Parameters
    ----------
    reference : str
        ``"path/to/file.py:ClassName"``.
    folder : path
        What a relative path is relative to.

    Raises
    ------
    ModelError
        No such file or class, a file that does not import, a class that is no `Model`.
    """
    path, name = locate_model(reference, folder)
    module = _execute(path)
    found = getattr(module, name, None)
    if not (isinstance(found, type) and issubclass(found, Model) and found is not Model):
        structures = [
            key
            for key, value in vars(module).items()
            if isinstance(value, type) and issubclass(value, Model) and value is not Model
        ]
        raise ModelError(
            f"{path} has no model class {name!r}; it has {', '.join(structures) or 'none'}"
        )
    required = [
        x.name for x in fields(found) if x.init and x.default is x.default_factory is MISSING
    ]
    if required:
        raise ModelError(
            f"{path}: {name}.{required[0]} has no value; write {required[0]}: Scalar = "
            "parameter(default=...), or a number for a trim"
        )
    return found


def locate_model(reference: str, folder: str | Path = ".") -> tuple[Path, str]:
    """File and class name of a reference, the file known to exist."""
    file, colon, name = reference.rpartition(":")
    if not colon or not file.endswith(".py") or not name.isidentifier():
        raise ModelError(f'model reference {reference!r}: expected "path/to/file.py:ClassName"')
    try:
        path = (Path(folder) / file).resolve()
        check_file(path, TEXT_BYTES, "a model file")
    except ValueError as error:
        raise ModelError(
            f"model reference {reference!r}: there is no file {file!r} ({error})"
        ) from error
    return path, name


def _execute(path: Path) -> ModuleType:
    # Two files of one stem are two modules; dataclasses look their module up by this name.
    unique = hashlib.sha256(str(path).encode()).hexdigest()[:8]
    name = f"casid_model_{path.stem}_{unique}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ModelError(f"{path}: Python cannot import it")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with time_limit(limits.USER_SECONDS), importable(path.parent):
            spec.loader.exec_module(module)
    except OutOfTimeError as error:
        del sys.modules[name]
        raise ModelError(
            f"model file {path}{_line(error, path)} does not import: {error}; "
            "does a loop never end? A model file only declares"
        ) from error
    except (Exception, SystemExit) as error:  # the user's file may raise anything
        del sys.modules[name]
        line = _line(error, path)
        raise ModelError(
            f"model file {path}{line} does not import: {type(error).__name__}: {error}"
        ) from error
    check_imports(path)
    return module


def _line(error: BaseException, path: Path) -> str:
    if isinstance(error, SyntaxError):
        return f", line {error.lineno}"
    lines = []
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            lines.append(trace.tb_lineno)
        trace = trace.tb_next
    return f", line {lines[-1]}" if lines else ""
