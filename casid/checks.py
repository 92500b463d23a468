"""Arguments of public functions, checked where users hand them over: kind, order, range.

What an argument may be its annotation says, and what its numbers may be its name, which means one
thing everywhere.
"""

import difflib
import importlib
import inspect
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cache, wraps
from numbers import Integral, Real
from types import FunctionType, NoneType, UnionType
from typing import (
    Any,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")

LONGEST = 60  # characters of a value in a message

# What the numbers of an argument of that name must be, in words and as a test of all of them, where
# what takes it has no better words.
RANGES: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    **dict.fromkeys(("horizon", "poles"), ("numbers > 0", lambda x: x.size and (x > 0).all())),
    **dict.fromkeys(
        ("regularisation", "regularisations", "noise", "seed", "order"),
        ("0 or more", lambda x: (x >= 0).all()),
    ),
    **dict.fromkeys(
        ("orders", "pasts"), ("whole numbers, 1 or more", lambda x: x.size and (x >= 1).all())
    ),
    "omega": ("one frequency at least", lambda x: x.size),
    "band": ("(lowest, highest) in rad/s, 0 <= lowest < highest", lambda x: 0 <= x[0] < x[1]),
}

# How an argument of that name is written that is a mapping of several things.
EXAMPLES: Mapping[str, str] = {
    "pairs": 'write (output, input): (gain, phase, ...), the columns of every pair, as in {("p", '
    '"lat"): ("p_lat_dB", "p_lat_deg")}; pairs_of(response) has those that write_frequency writes',
}


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """A function that refuses arguments of another kind or range than it wants, by ValueError."""
    signature = inspect.signature(function)

    @wraps(function)
    def careful(*args: P.args, **kwargs: P.kwargs) -> T:
        hints, owner = _hints(function), function.__qualname__
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            raise TypeError(f"{owner}: {error}; it takes {signature}") from error
        _check_kinds(owner, given, hints)
        _check_ranges(owner, given)
        return function(*args, **kwargs)

    return careful


def checked_methods(cls: type[T]) -> type[T]:
    """A class whose public methods are `checked`."""
    for name, method in list(vars(cls).items()):
        if isinstance(method, FunctionType) and not name.startswith("_"):
            setattr(cls, name, checked(method))
    return cls


def checked_fields(cls: type[T]) -> type[T]:
    """A frozen dataclass that refuses fields of another kind or range than they are declared."""
    make = cls.__init__

    @wraps(make)
    def careful(self: T, /, **given: Any) -> None:  # noqa: ANN401 - what the class declares
        _check_kinds(cls.__name__, given, _hints(cast("Hashable", cls)))
        make(self, **given)  # which may know better words for a range
        _check_ranges(cls.__name__, given)

    cls.__init__ = careful  # type: ignore[assignment] # mypy: it may be a subclass's
    return cls


def check_fields(value: object) -> None:
    """Refuse a dataclass one of whose fields is of another kind than declared: ValueError."""
    cls = type(value)
    _check_kinds(cls.__name__, vars(value), _hints(cast("Hashable", cls)))


def check_known(
    said: str, names: Iterable[str], known: Iterable[str], error: type[ValueError] = ValueError
) -> None:
    """Refuse the first name that is none of those known, ``said`` of it, and tell the nearest."""
    known = tuple(known)
    for name in names:
        if name not in known:
            raise error(f"{said} {name!r}; {hint(name, known)}")


def check_asked(band: tuple[float, float] | None, level: float) -> None:
    """Refuse a band or a chance of error that makes no sense: ValueError."""
    if band is not None and not 0 < band[0] < band[1] < np.inf:
        raise ValueError(
            f"band=({band[0]:g}, {band[1]:g}) rad/s: expected 0 < lowest < highest, frequencies "
            "above 0 rad/s"
        )
    if not 0 < level <= 1 / 2:
        raise ValueError(
            f"level={level:g}: expected the chance of a false alarm, above 0 and at most 0.5, such "
            "as 0.01"
        )


def check_level(level: float, what: str, usual: float = 0.95) -> None:
    """Refuse a level that is no share between 0 and 1: ValueError."""
    if not 0 < level < 1:
        raise ValueError(f"level={level:g}: expected a {what} between 0 and 1, such as {usual:g}")


def hint(name: str, known: Iterable[str]) -> str:
    """What was meant by a name that is not known, or all names that are."""
    known = tuple(known)
    meant = nearest_name(name, known)
    others = f"known are {', '.join(dict.fromkeys(known))}" if known else "there are none"
    return f"did you mean {meant!r}? {others[0].upper()}{others[1:]}" if meant else others


def nearest_name(name: str, known: Iterable[str]) -> str:
    """The one of the known names that is most alike, whatever the case; "" if none is."""
    known = tuple(known)
    small = {each.lower(): each for each in known}
    near = difflib.get_close_matches(name, known, n=1)
    near = near or [small[x] for x in difflib.get_close_matches(name.lower(), small, n=1)]
    return near[0] if near else ""


def spelling(name: str, known: Iterable[str]) -> str:
    """The end of a message that asks for the nearest of the known names; "" if none is near."""
    meant = nearest_name(name, known)
    return f"; did you mean {meant!r}?" * bool(meant)


def optional(module: str, what: str, *, extra: str = "tables") -> Any:  # noqa: ANN401 - a module
    """Import a package that casid does not depend on; ValueError where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ValueError(
            f"{what} needs {module}, which is not installed: pip install 'casid[{extra}]'"
        ) from error


@cache
def _hints(owner: Hashable) -> Mapping[str, Any]:
    return get_type_hints(owner)  # of a function or a class


def _check_kinds(owner: str, given: Mapping[str, Any], hints: Mapping[str, Any]) -> None:
    """Refuse the first value that is of no kind its hint names."""
    for name, value in given.items():
        if name in hints and not fits(value, hints[name]):
            raise ValueError(
                f"{owner}: {name} = {_short(value)}, expected {words(hints[name])}"
                f"{_example(name, hints[name]) or _remedy(name, given, hints)}"
            )


def _check_ranges(owner: str, given: Mapping[str, Any]) -> None:
    """Refuse the first value with numbers out of its name's range."""
    for name in given.keys() & RANGES.keys():
        numbers, (wanted, holds) = _numbers(given[name]), RANGES[name]
        if numbers is not None and not holds(numbers):
            raise ValueError(f"{owner}: {name} = {_short(given[name])}, expected {wanted}")


def _example(name: str, hint: Any) -> str:  # noqa: ANN401 - any annotation
    """How an argument is written whose kind does not say it."""
    return f"; {EXAMPLES[name]}" if name in EXAMPLES and get_origin(hint) is Mapping else ""


def _remedy(name: str, given: Mapping[str, Any], hints: Mapping[str, Any]) -> str:
    """What to do about an argument that does not fit."""
    value, hint = given[name], hints[name]
    for other in (each for each in given if each != name and each in hints):
        if fits(value, hints[other]) and not fits(given[other], hints[other]):
            return f"; swap {name} and {other}"
    if isinstance(value, type):
        return f"; make one: {value.__name__}()"
    if get_origin(hint) is type and fits(type(value), hint):
        return f"; pass {type(value).__name__} itself"
    members = get_args(hint) if get_origin(hint) in {Union, UnionType} else (hint,)
    for kind, inner in ((get_origin(each), get_args(each)) for each in members):
        if kind in {Sequence, Collection} and fits(value, inner[0]):
            return f"; write [{_short(value)}]"
        if kind is Mapping and fits(value, inner[1]):
            return '; give it a name: {"name": ...}'
    return _spelling(value, members)


def _spelling(value: Any, members: tuple[Any, ...]) -> str:  # noqa: ANN401
    """Which of the words that are expected was meant, if one is alike."""
    known = [word for each in members if get_origin(each) is Literal for word in get_args(each)]
    return spelling(value, map(str, known)) if isinstance(value, str) else ""


def fits(value: Any, hint: Any) -> bool:  # noqa: ANN401 - anything a user may hand over
    """Whether a value is what an annotation says; NaN is no number."""
    hint = hint.__bound__ if isinstance(hint, TypeVar) else hint
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in _PLAIN or kind in _GENERIC:
        return _PLAIN[kind](value) if kind in _PLAIN else _GENERIC[kind](value, inner)
    if kind is Any or not isinstance(kind, type):
        return True
    if issubclass(kind, Mapping):
        pairs = list(value.items()) if isinstance(value, Mapping) else [()]
        return all(len(pair) == 2 and all(map(fits, pair, inner or (Any, Any))) for pair in pairs)
    if issubclass(kind, Collection) and kind is not str and inner:
        return _holds(value, kind, inner)
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    return isinstance(value, kind)


def _is_class(value: Any, inner: tuple[Any, ...]) -> bool:  # noqa: ANN401
    """Whether a value is one of the classes in brackets."""
    bounds = [each.__bound__ if isinstance(each, TypeVar) else each for each in inner]
    return isinstance(value, type) and all(
        not isinstance(bound, type) or issubclass(value, bound) for bound in bounds
    )


def _holds(value: Any, kind: type, inner: tuple[Any, ...]) -> bool:  # noqa: ANN401
    """Whether a collection holds what it is to hold; text is none, a mapping no sequence."""
    if isinstance(value, Iterator):
        return kind is not tuple
    if isinstance(value, str | Mapping) or not isinstance(value, Collection):
        return False
    if kind is tuple and Ellipsis not in inner:
        return len(value) == len(inner) and all(map(fits, value, inner))
    return all(fits(each, inner[0]) for each in value)


def _numbers(value: Any) -> Any:  # noqa: ANN401
    """The real numbers of an argument as an array; None if it has others."""
    value = list(value.values()) if isinstance(value, Mapping) else value
    if isinstance(value, Collection) and not len(value):
        return np.zeros(0)
    if value is None or isinstance(value, str | Iterator) or not _is_array(np.atleast_1d(value)):
        return None
    found = np.atleast_1d(np.asarray(value))
    return None if found.dtype.kind in "bc" else found


def _is_array(value: Any) -> bool:  # noqa: ANN401
    """Whether a value is an array of numbers, or lists of them."""
    if isinstance(value, str | Mapping) or not isinstance(value, Collection):
        return False
    try:
        return np.asarray(value).dtype.kind in "biufc"
    except ValueError:  # rows of several lengths
        return False


def _is_number(value: Any) -> bool:  # noqa: ANN401
    if isinstance(value, bool | np.bool_):
        return False
    return isinstance(value, Real) and not np.isnan(float(value))


def _fits_any(value: Any, inner: tuple[Any, ...]) -> bool:  # noqa: ANN401
    return any(fits(value, each) for each in inner)


_PLAIN: Mapping[Any, Callable[[Any], bool]] = {
    NoneType: lambda value: value is None,
    np.ndarray: _is_array,
    Callable: callable,
    bool: lambda value: isinstance(value, bool | np.bool_),
    int: lambda x: isinstance(x, Integral) and not isinstance(x, bool | np.bool_),
    float: _is_number,
}
_GENERIC: Mapping[Any, Callable[[Any, tuple[Any, ...]], bool]] = {
    Union: _fits_any,
    UnionType: _fits_any,
    Literal: lambda value, inner: isinstance(value, str | int) and value in inner,
    type: _is_class,
    tuple: lambda value, inner: _holds(value, tuple, inner),
}


def words(hint: Any) -> str:  # noqa: ANN401 - an annotation
    """An annotation as a reader wants it."""
    hint = hint.__bound__ if isinstance(hint, TypeVar) else hint
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in _PHRASES:
        return _PHRASES[kind](inner)
    name = _NAMES.get(kind, str(getattr(kind, "__name__", kind)))
    if kind in _NAMES or not (isinstance(kind, type) and issubclass(kind, Collection) and inner):
        return name
    if issubclass(kind, Mapping):
        return f"a mapping {{{words(inner[0])}: {words(inner[1])}}}"
    return _several(inner[0])


def _several(hint: Any) -> str:  # noqa: ANN401 - an annotation
    many = {int: "whole numbers", float: "numbers", str: "texts"}
    return many.get(hint, f"several {words(hint)}")


def _one_of(inner: tuple[Any, ...]) -> str:
    return " or ".join(dict.fromkeys(words(each) for each in inner if each is not NoneType))


_NAMES: Mapping[Any, str] = {
    Any: "anything",
    np.ndarray: "an array of numbers",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
}
_PHRASES: Mapping[Any, Callable[[tuple[Any, ...]], str]] = {
    Union: _one_of,
    UnionType: _one_of,
    Literal: lambda inner: " or ".join(f'"{each}"' for each in inner),
    type: lambda _: "a class",
    tuple: lambda inner: (
        _several(inner[0]) if Ellipsis in inner else f"({', '.join(map(words, inner))})"
    ),
}


def _short(value: Any) -> str:  # noqa: ANN401
    """A value as a message shows it: a number or a text itself, of others their class."""
    if value is None or isinstance(value, str | int | float | np.number):
        text = repr(value.item() if isinstance(value, np.generic) else value)
    elif isinstance(value, type):
        text = f"the class {value.__name__}"
    elif isinstance(value, list | tuple | dict | set) and len(repr(value)) <= LONGEST:
        text = repr(value)
    elif isinstance(value, np.ndarray):
        text = f"an array {value.shape} of {value.dtype}"
    else:
        name = type(value).__name__
        text = f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
