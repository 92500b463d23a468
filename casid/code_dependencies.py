"""What a structure's code reads from around it: what is built of it holds as long as that does.

Methods of a class read numbers of their module, of the class and of functions beside it. In a
notebook any of them may change under the class, and its equations change with it.
"""

import dis
from collections.abc import Hashable
from functools import lru_cache
from types import CellType, CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, TypeAlias

from casid.values import digest

PLAIN = (bool, int, float, complex, str, type(None))
READS = "LOAD_GLOBAL", "LOAD_NAME"
OURS = "casid", "builtins", "abc"
EMPTY = CellType()

Surroundings: TypeAlias = frozenset[tuple[Hashable, Hashable]]


class _Same:
    """An object that equals itself alone."""

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


def surroundings(cls: type) -> Surroundings:
    """Names and values of all that methods of a class and of its bases may read.

    That is numbers, text and data of the class, of its module, and of modules that are named there;
    functions and classes beside it are followed. Any other object is what it is.
    """
    found = _Found()
    found.follow_class(cls)
    return frozenset(found.values.items())


class _Found:
    """Values by where they were found, and the modules whose code is followed."""

    def __init__(self) -> None:
        self.values: dict[Hashable, Hashable] = {}
        self.modules: set[str] = set()

    def follow_class(self, cls: type) -> None:
        own = [each for each in cls.__mro__ if each.__module__.split(".")[0] not in OURS]
        self.modules |= {each.__module__ for each in own}
        for base in own:
            if base not in self.values:
                self.values[base] = None
                for name, value in list(vars(base).items()):
                    if not name.startswith("__"):
                        code = getattr(value, "fget", getattr(value, "__func__", value))
                        self.take((base, name), code)

    def follow(self, function: FunctionType) -> None:
        if function in self.values:
            return
        self.values[function] = None
        code, around = function.__code__, function.__globals__
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            if cell != EMPTY:  # else its variable has no value yet
                self.take((function, name), cell.cell_contents)
        if function.__module__ not in self.modules:
            return
        for name in _globals(code) & around.keys():
            value = around[name]
            if isinstance(value, ModuleType):
                for each in _names(code) & vars(value).keys():
                    self.take((name, each), vars(value)[each])
            else:
                self.take((function.__module__, name), value)

    def take(self, key: Hashable, value: Any) -> None:  # noqa: ANN401
        if isinstance(value, PLAIN):
            self.values[key] = type(value), value
        elif isinstance(value, FunctionType):
            self.values[key] = value
            self.follow(value)
        elif isinstance(value, type):
            self.values[key] = value
            if value.__module__ in self.modules:
                self.follow_class(value)
        else:
            self.values[key] = _digest(value)


@lru_cache(maxsize=1024)
def _globals(code: CodeType) -> frozenset[str]:
    """Names that code reads from its module: not x.p where there happens to be a p, too."""
    own = (each.argval for each in dis.get_instructions(code) if each.opname in READS)
    inner = (_globals(each) for each in code.co_consts if isinstance(each, CodeType))
    return frozenset(own).union(*inner)


@lru_cache(maxsize=1024)
def _names(code: CodeType) -> frozenset[str]:
    """Names and attributes that code reads, functions within it too."""
    inner = (_names(each) for each in code.co_consts if isinstance(each, CodeType))
    return frozenset(code.co_names).union(*inner)


def _digest(value: Any) -> Hashable:  # noqa: ANN401
    try:
        return digest(vars(value) if isinstance(value, SimpleNamespace) else value)
    except (TypeError, RecursionError):
        return _Same(value)  # it holds what is no data, or itself
