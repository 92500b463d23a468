"""Model classes on their way to other processes.

A class from a user's file cannot be pickled. What travels instead is where the file is and what
stands in it; the other side reads the file, or a copy of it on a machine that does not have it. A
class of a notebook, of the script that runs or of a function travels by value (cloudpickle), with
what it uses of its surroundings.
"""

import hashlib
import inspect
import io
import pickle
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import cloudpickle

from casid.errors import ModelError
from casid.jobs.digests import structure_digest
from casid.model import RESTORING, Model
from casid.structure.modelfile import load_model
from casid.values import digest

_KNOWN: dict[tuple[str, str], type[Model]] = {}
_LOADING: list[str] = []


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A structure's class: its name, the file it stands in and the text of that file."""

    name: str
    path: str  # empty for a class that no other process can read from a file
    text: str
    digest: str = ""  # of the file and of the user's modules that it imports, or of the class
    pickled: bytes = b""  # the class itself where there is no file to read

    @property
    def key(self) -> tuple[str, str]:
        """Name of the class and digest of its file."""
        whole = self.path + self.text + (self.digest if not self.path else "")
        return self.name, hashlib.sha256(whole.encode()).hexdigest()


def refer(cls: type[Model]) -> Reference:
    """The reference of a class; this process will find the class itself by it."""
    place = _file(cls)
    if place is None:
        try:
            pickled = _pickled(cls)
        except (TypeError, pickle.PicklingError):  # it uses what cannot leave this process
            pickled = b""
        reference = Reference(
            name=cls.__qualname__, path="", text="", digest=_code_digest(cls), pickled=pickled
        )
    else:
        text, rest = place.read_text(encoding="utf-8"), structure_digest(place)
        reference = Reference(name=cls.__qualname__, path=str(place), text=text, digest=rest)
    _KNOWN[reference.key] = cls
    return reference


def can_travel(cls: type[Model]) -> bool:
    """Whether other processes can read the class, without running the script of this one again."""
    reference = refer(cls)
    return bool(reference.path or reference.pickled)


def resolve(reference: Reference) -> type[Model]:
    """The class of a reference; ModelError for one that cannot leave its process."""
    if reference.key not in _KNOWN:
        if not reference.path and not reference.pickled:
            raise ModelError(
                f"{reference.name} uses what no other process can have (an open file, a lock); put "
                "it into a file of its own, without that"
            )
        with _loading(reference.name):
            _KNOWN[reference.key] = _load(reference) if reference.path else _restore(reference)
    return _KNOWN[reference.key]


def _file(cls: type[Model]) -> Path | None:
    """The file at whose top level other processes find a class."""
    if cls.__module__ == "__main__" or not cls.__qualname__.isidentifier():
        return None
    try:
        path = inspect.getsourcefile(cls)
    except (TypeError, OSError):  # made at a prompt or in a notebook
        path = None
    return Path(path).resolve() if path is not None and Path(path).is_file() else None


def _pickled(cls: type[Model]) -> bytes:
    """A class by value, with what it uses."""
    whole = io.BytesIO()
    _Pickler(whole).dump(cls)
    return whole.getvalue()


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickles structures so that they are not declared once more where they arrive."""

    def reducer_override(self, obj: Any) -> Any:  # noqa: ANN401 - as its base has it
        """See `pickle.Pickler`."""
        how = super().reducer_override(obj)
        if isinstance(obj, type) and issubclass(obj, Model) and isinstance(how, tuple):
            return _skeleton, (how[0], *how[1]), *how[2:]
        return how


def _skeleton(make: Callable[..., type[Model]], *arguments: object) -> type[Model]:
    """A structure's class, still without its contents."""
    token = RESTORING.set(True)
    try:
        return make(*arguments)
    finally:
        RESTORING.reset(token)


def _restore(reference: Reference) -> type[Model]:
    cls: type[Model] = pickle.loads(reference.pickled)
    return cls


def _code_digest(cls: type[Model]) -> str:
    """Digest of the methods and values of a class, of its bases that are the user's, and so on."""
    own = [each for each in cls.__mro__ if not each.__module__.startswith(("casid.", "builtins"))]
    said, seen = [], set[int]()
    for each in own:
        for name, value in sorted(vars(each).items()):
            if isinstance(value, FunctionType):
                said.append((name, *_says(value, seen)))
            elif not name.startswith("__"):
                said.append((name, repr(value)))
    said += [(name, repr(info)) for name, info in cls.infos().items()]
    return digest(said)


def _says(function: FunctionType, seen: set[int]) -> tuple[str, ...]:
    """Bytecode and constants of a function, of those it calls, and values it reads around it."""
    if id(function) in seen:
        return ()
    seen.add(id(function))
    code = function.__code__
    around = [cell.cell_contents for cell in function.__closure__ or ()]
    around += [function.__globals__[n] for n in code.co_names if n in function.__globals__]
    parts = _instructions(code)
    for value in around:
        if isinstance(value, FunctionType):
            parts += _says(value, seen)
        elif isinstance(value, ModuleType | type):
            parts += (value.__name__,)
        else:
            parts += (f"{type(value)} {value.tobytes() if hasattr(value, 'tobytes') else value!r}",)
    return parts


def _instructions(code: CodeType) -> tuple[str, ...]:
    inner = [_instructions(c) if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    return code.co_code.hex(), repr(code.co_names), repr(inner)


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
