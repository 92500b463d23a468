"""What a result rests on beside data and settings: code of casid, of the user, of libraries."""

import hashlib
import inspect
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from casid.model import Model
from casid.nonlinear.model import NonlinearModel
from casid.structure.imports import structure_files
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
