"""Settings from the tables of a study: each table becomes a frozen value, by its fields' types."""

from collections.abc import Callable, Collection
from dataclasses import fields, is_dataclass, replace
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from casid.arrays import Array
from casid.checks import fits, words
from casid.tables import Table, placed

S = TypeVar("S")

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
    with placed(table.place):
        return replace(defaults, **values)  # type: ignore[type-var]


def _value(table: Table, key: str, kind: Any, default: Any) -> Any:  # noqa: ANN401 - any field's
    """A key's value as its field wants it."""
    if is_dataclass(default) and not isinstance(default, type):
        return read_settings(table.table(key), default)
    value = table.content[key]
    if np.ndarray in _kinds(kind) and (isinstance(value, dict) or key == "omega"):
        return _grid(table, key, value)
    if not fits(value, kind):
        raise ValueError(f"{table.place} {key} = {value!r}, expected {words(kind)}")
    return _frozen(value)


def _kinds(kind: Any) -> set[Any]:  # noqa: ANN401 - any annotation
    """The classes a field takes, without their parameters."""
    members = get_args(kind) if get_origin(kind) in {Union, UnionType} else (kind,)
    return {get_origin(member) or member for member in members}


def _frozen(value: Any) -> Any:  # noqa: ANN401
    """Lists as tuples, in tables too; a list of rows of numbers as an array."""
    if isinstance(value, dict):
        return {key: _frozen(each) for key, each in value.items()}
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
    numeric = isinstance(value, list) and all(isinstance(x, int | float) for x in value)
    grid = np.asarray(value if numeric else [], dtype=float)
    if not len(grid) or not ((grid > 0) & np.isfinite(grid)).all():
        raise ValueError(
            f"{table.place} {key} = {value!r}, expected frequencies > 0 in a list or "
            "{from = 0.5, to = 12, points = 40}"
        )
    return grid
