"""Settings from the tables of a study: each table becomes a frozen value, by its fields' types."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.tables import Table

S = TypeVar("S")

LISTS = {tuple, list, Sequence, Collection, np.ndarray}
TAKEN: Mapping[type, set[Any]] = {  # the fields that take a value of TOML, by its class
    bool: {bool},
    int: {int, float},
    float: {float},
    str: {str, Literal},
    list: LISTS,
    dict: {dict, Mapping},
    object: set(),
}
MOST_POINTS = 10_000  # of a grid: a matching problem of millions of unknowns


def read_settings(table: Table, defaults: S, given: Collection[str] = ()) -> S:
    """The settings that a table makes of the defaults, but for fields ``given`` elsewhere.

    ValueError: an unknown key, with the nearest one; a value of another kind than the field's; what
    the settings themselves refuse.
    """
    kinds = {
        name: kind
        for name, kind in get_type_hints(type(defaults)).items()
        if name not in given and not _kinds(kind) <= {NoneType, Callable}
    }
    known = [f.name for f in fields(defaults) if f.name in kinds]  # type: ignore[arg-type]
    table.only(known)
    values = {key: _value(table, key, kinds[key], getattr(defaults, key)) for key in table.content}
    try:
        return replace(defaults, **values)  # type: ignore[type-var]
    except ModelError as error:
        raise ModelError(f"{table.place} {error}") from error
    except ValueError as error:
        raise ValueError(f"{table.place} {error}") from error


def _value(table: Table, key: str, kind: Any, default: Any) -> Any:  # noqa: ANN401 - any field's
    """A key's value as its field wants it."""
    if is_dataclass(default) and not isinstance(default, type):
        return read_settings(table.table(key), default)
    kinds, words, value = _kinds(kind), _words(kind), table.content[key]
    if np.ndarray in kinds and (isinstance(value, dict) or key == "omega"):
        return _grid(table, key, value)
    fitting = kinds & next(wanted for each, wanted in TAKEN.items() if isinstance(value, each))
    if not fitting or (fitting == {Literal} and value not in words):
        wanted = [repr(word) for word in words] + sorted(_name(each) for each in kinds - {Literal})
        raise ValueError(f"{table.place} {key} = {value!r}, expected {' or '.join(wanted)}")
    if isinstance(value, list) and not any(_holds(member, value) for member in _members(kind)):
        told = str(kind).replace("collections.abc.", "").replace(" | None", "")
        raise ValueError(f"{table.place} {key} = {value!r}, expected {told}")
    return _frozen(value)


def _holds(kind: Any, value: list[Any]) -> bool:  # noqa: ANN401 - one member of a union
    """Whether a list is as long as a tuple wants it, and of plain elements as wanted."""
    elements = [each for each in get_args(kind) if each is not Ellipsis]
    origin = get_origin(kind) or kind
    if origin not in LISTS or origin is np.ndarray or not elements:
        return origin is np.ndarray
    if origin is not tuple or Ellipsis in get_args(kind):
        elements = elements[:1] * len(value)
    fitting = zip(value, elements, strict=False)
    return len(value) == len(elements) and all(_plain(*pair) for pair in fitting)


def _plain(item: Any, kind: Any) -> bool:  # noqa: ANN401
    """Whether an element is of its kind, if that is a plain one."""
    if kind is float:
        return isinstance(item, int | float) and not isinstance(item, bool)
    return kind not in {int, str, bool} or type(item) is kind


def _name(kind: Any) -> str:  # noqa: ANN401 - a class
    """What a user calls a class of values."""
    usual = {np.ndarray: "numbers", NoneType: "nothing"}
    return usual.get(kind, str(kind.__name__))


def _members(kind: Any) -> tuple[Any, ...]:  # noqa: ANN401 - of a union, or the one
    return get_args(kind) if get_origin(kind) in {Union, UnionType} else (kind,)


def _kinds(kind: Any) -> set[Any]:  # noqa: ANN401
    """The classes a field takes, without their parameters."""
    return {get_origin(member) or member for member in _members(kind)}


def _words(kind: Any) -> tuple[str, ...]:  # noqa: ANN401
    literals = [member for member in _members(kind) if get_origin(member) is Literal]
    return tuple(word for each in literals for word in get_args(each))


def _frozen(value: Any) -> Any:  # noqa: ANN401
    """Lists as tuples; a table of numbers as an array."""
    if not isinstance(value, list):
        return value
    rows = [row for row in value if isinstance(row, list)]
    if rows and all(isinstance(x, int | float) for row in rows for x in row):
        return np.asarray(value, dtype=float)
    return tuple(_frozen(item) for item in value)


def _grid(table: Table, key: str, value: Any) -> Array:  # noqa: ANN401
    """Frequencies [rad/s]: a list, or {from, to, points} spaced logarithmically."""
    if isinstance(value, dict):
        inner = table.table(key)
        inner.only(("from", "to", "points"))
        low, high = (inner.take(end, (int, float)) for end in ("from", "to"))
        points = inner.take("points", int, 40)
        if low is None or high is None or not 0 < low < high < np.inf:
            raise ValueError(f"{table.place} {key} = {value!r}, expected 0 < from < to")
        if not 2 <= points <= MOST_POINTS:
            raise ValueError(f"{table.place} points = {points}, expected 2, at most {MOST_POINTS}")
        return np.geomspace(low, high, points)
    numeric = isinstance(value, Sequence) and all(isinstance(x, int | float) for x in value)
    grid = np.asarray(value if numeric else [], dtype=float)
    if not len(grid) or not ((grid > 0) & np.isfinite(grid)).all():
        raise ValueError(
            f"{table.place} {key} = {value!r}, expected frequencies > 0 in a list or "
            "{from = 0.5, to = 12, points = 40}"
        )
    return grid
