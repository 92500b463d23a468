"""Model classes on their way to other processes.

A class from a user's file cannot be pickled. What travels instead is where the file is and what
stands in it; the other side reads the file, or a copy of it on a machine that does not have it.
"""

import hashlib
import inspect
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from casid.errors import ModelError
from casid.jobs.origins import structure_digest
from casid.model import Model
from casid.structure.modelfile import load_model

_KNOWN: dict[tuple[str, str], type[Model]] = {}
_LOADING: list[str] = []


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A structure's class: its name, the file it stands in and the text of that file."""

    name: str
    path: str  # empty for a class without a file, which cannot leave its process
    text: str
    digest: str = ""  # of the file and of the user's modules that it imports

    @property
    def key(self) -> tuple[str, str]:
        """Name of the class and digest of its file."""
        return self.name, hashlib.sha256((self.path + self.text).encode()).hexdigest()


def refer(cls: type[Model]) -> Reference:
    """The reference of a class; this process will find the class itself by it."""
    try:
        path = inspect.getsourcefile(cls)
    except (TypeError, OSError):  # made at a prompt or in a notebook
        path = None
    text = ""
    if path is not None and Path(path).is_file():
        text = Path(path).read_text(encoding="utf-8")
    place = str(Path(path).resolve()) if path and text else ""
    rest = structure_digest(place) if place else ""
    reference = Reference(name=cls.__qualname__, path=place, text=text, digest=rest)
    _KNOWN[reference.key] = cls
    return reference


def can_travel(cls: type[Model]) -> bool:
    """Whether other processes can read the class, without running the script of this one again."""
    reference = refer(cls)
    return bool(reference.path) and cls.__module__ != "__main__" and cls.__qualname__.isidentifier()


def resolve(reference: Reference) -> type[Model]:
    """The class of a reference; ModelError for one without a file, or not at its top level."""
    if reference.key not in _KNOWN:
        if not reference.path or not reference.name.isidentifier():
            raise ModelError(
                f"{reference.name} stands in no file of its own; other processes can read only "
                "classes at the top level of a file"
            )
        with _loading(reference.name):
            _KNOWN[reference.key] = _load(reference)
    return _KNOWN[reference.key]


def refuse_while_loading() -> None:
    """Stop a script that begins a study while its model is read in another process."""
    if _LOADING:
        raise ModelError(
            f"the file of {_LOADING[-1]} runs a study when other processes read it; put the study "
            'under if __name__ == "__main__": or the model into a file of its own'
        )


@contextmanager
def _loading(name: str) -> Iterator[None]:
    _LOADING.append(name)
    try:
        yield
    finally:
        _LOADING.pop()


def _load(reference: Reference) -> type[Model]:
    path = Path(reference.path)
    if path.is_file() and path.read_text(encoding="utf-8") == reference.text:
        return load_model(f"{path}:{reference.name}", "/")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_text(reference.text, encoding="utf-8")
        return load_model(f"{copy}:{reference.name}", "/")
