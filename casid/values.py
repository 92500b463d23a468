"""Frozen values as plain JSON and as digests: the one form in which fits, stages and jobs are kept.

A file may name the classes registered by `storable` and no others.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

# What `decode` raises on a damaged file; overflow where a number has no place in its array.
DAMAGED = (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError)

_STORABLE: dict[str, type] = {}
# Where each storable class is defined: a file may be read before anything has imported it.
_HOMES: Mapping[str, tuple[str, ...]] = {
    "baseline.accuracy": (
        "DerividNotes",
        "Guidelines",
        "PairCost",
        "ParameterAccuracy",
        "StartCost",
    ),
    "design.specification": ("Limits",),
    "design.plan": ("Alternative", "Design"),
    "distances": ("Distance", "Distances"),
    "excitations": ("Excitation",),
    "fit": ("Certificate", "ConstraintEstimate", "Fit", "ParameterEstimate"),
    "frequency.distortion": ("Distortion",),
    "frequency.response": ("FrequencyResponse",),
    "linear": ("StateSpace",),
    "matching.appraisal": ("MatchNotes", "MatchedSource", "Peak"),
    "missing_modes": ("MissingMode",),
    "nonlinear.conditions": ("Trim",),
    "shooting.nonlinear": ("Integration",),
    "shooting.precision": ("OutputErrorNotes",),
    "shooting.spectrum": ("NoiseSpectrum",),
    "shooting.uncertainty": ("Collinearity",),
    "stages.choice": ("StepChoice",),
    "subspace.blackbox": ("BlackBox",),
    "subspace.candidates": ("Candidate", "OrderSelection"),
    "subspace.columns": ("Segment",),
    "subspace.modal": ("Modal",),
    "subspace.pbsid": ("Pbsid",),
    "subspace.prediction": ("SampledUncertainty",),
    "subspace.refinement": ("ResponseUncertainty",),
    "subspace.trust": ("Missed",),
}


def storable(cls: type[T]) -> type[T]:
    """Register a frozen dataclass as one that files may hold; each name once."""
    known = _STORABLE.setdefault(cls.__name__, cls)
    if (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
        raise ValueError(f"files know {cls.__name__!r} as that of {known.__module__}; rename one")
    _STORABLE[cls.__name__] = cls
    return cls


def seal(value: object) -> None:
    """Make the arrays of a frozen dataclass read-only; for its ``__post_init__``."""
    for each in fields(value):  # type: ignore[arg-type] # mypy has no type for any dataclass
        content = getattr(value, each.name)
        if isinstance(content, np.ndarray) and content.flags.writeable:
            sealed = content.copy()
            sealed.setflags(write=False)
            object.__setattr__(value, each.name, sealed)


def encode(value: Any) -> Any:  # noqa: ANN401 - JSON is any
    """Plain JSON of numbers, texts, arrays, tuples, mappings and frozen dataclasses."""
    if isinstance(value, list):
        return [encode(item) for item in value]
    if isinstance(value, np.ndarray):
        complex_ = value.dtype.kind == "c"
        parts = [_numbers(value.real), _numbers(value.imag)] if complex_ else _numbers(value)
        return {"array": parts, "kind": value.dtype.kind, "shape": list(value.shape)}
    if is_dataclass(value) and not isinstance(value, type):
        content = {each.name: encode(getattr(value, each.name)) for each in fields(value)}
        return {"value": type(value).__name__, "fields": content}
    if isinstance(value, tuple):
        return {"tuple": [encode(item) for item in value]}
    return _encode_plain(value)


def _numbers(array: np.ndarray) -> Any:  # noqa: ANN401 - lists as deep as it has axes
    """Nested lists of an array; JSON has no NaN and no infinities, which become null and text."""
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    named = array.astype(object)
    named[np.isnan(array)] = None
    named[np.isinf(array)] = [str(each) for each in array[np.isinf(array)].tolist()]
    return named.tolist()


def _encode_plain(value: Any) -> Any:  # noqa: ANN401 - JSON is any
    if isinstance(value, Mapping):
        return {"mapping": {str(key): encode(item) for key, item in value.items()}}
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not np.isfinite(value):
        return {"float": str(value)}
    return value


def decode(content: Any, also: Sequence[type] = ()) -> Any:  # noqa: ANN401 - JSON is any
    """Invert `encode`, with classes beside the registered ones; raises on a value not known."""
    if isinstance(content, list):
        return [decode(item, also) for item in content]
    if not isinstance(content, dict):
        return content
    kind = next(iter(content), "")
    if kind == "value":
        parts = {key: decode(item, also) for key, item in content["fields"].items()}
        return _known(content["value"], also)(**parts)
    return _DECODERS[kind](content, also)


def _known(name: str, also: Sequence[type]) -> type:
    """The class that a file means by a name, imported from its home where nobody has yet."""
    if allowed := [cls for cls in also if cls.__name__ == name]:
        return allowed[-1]
    for home in [home for home, names in _HOMES.items() if name in names]:
        import_module(f"casid.{home}")
    return _STORABLE[name]


def _array(content: Mapping[str, Any], _: Sequence[type]) -> Any:  # noqa: ANN401 - of any kind
    if content["kind"] == "c":
        re, im = (np.array(part, dtype=float) for part in content["array"])
        return (re + 1j * im).reshape(content["shape"])
    kinds = {"f": float, "b": bool, "i": int}
    found: np.ndarray = np.array(content["array"], dtype=kinds[content["kind"]])
    if found.size and list(found.shape) != content["shape"]:
        raise ValueError(f"an array of shape {list(found.shape)}, expected {content['shape']}")
    return found.reshape(content["shape"])


_DECODERS: Mapping[str, Callable[[Mapping[str, Any], Sequence[type]], Any]] = {
    "array": _array,
    "tuple": lambda content, also: tuple(decode(item, also) for item in content["tuple"]),
    "mapping": lambda content, also: {
        key: decode(item, also) for key, item in content["mapping"].items()
    },
    "float": lambda content, _: float(content["float"]),
}


def content_digest(content: Mapping[str, Any]) -> str:
    """Digest (SHA-256) of all that a stored result's file holds beside it."""
    held = {name: part for name, part in content.items() if name != "digest"}
    return hashlib.sha256(json.dumps(held).encode()).hexdigest()


def check_digest(content: Mapping[str, Any], path: str | Path) -> None:
    """ValueError unless a stored result is what was written.

    What `save` wrote before it kept digests has none; what studies keep always did.
    """
    if "digest" not in content and content.get("casid") != "result":
        return
    if content.get("digest") != content_digest(content):
        raise ValueError(
            f"{path}: changed after casid wrote it, what it holds is no result; estimate again, or "
            "run its study again"
        )


def digest(*parts: Any) -> str:  # noqa: ANN401 - any value casid knows
    """Digest of values that a result depends on: arrays by their bytes.

    Fields that are not compared (``compare=False``) do not count. TypeError: a value without a
    content of its own, such as a function.
    """
    sha = hashlib.sha256()
    _feed(sha.update, parts)
    return sha.hexdigest()


def _feed(update: Callable[[Any], None], value: Any) -> None:  # noqa: ANN401 - of any kind
    """Hand a value's bytes over, each part behind its kind and length."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        update(f"array {value.dtype.str} {value.shape};".encode())
        update(np.ascontiguousarray(value).data if value.size else b"")
        return
    kind, parts = _parts(value)
    if parts is not None:
        update(f"{kind} {len(parts)};".encode())
        for part in parts:
            _feed(update, part)
        return
    value = value.item() if isinstance(value, np.generic) else value
    if not isinstance(value, str | bytes | int | float | complex | PurePath | None):
        raise TypeError(f"{value!r} has no digest")
    text = value if isinstance(value, bytes) else str(value).encode()
    update(f"{type(value).__name__} {len(text)};".encode() + text)


def _parts(value: Any) -> tuple[str, list[Any] | None]:  # noqa: ANN401 - of any kind
    """Kind and parts of what has parts, in an order of their own."""
    if isinstance(value, Mapping):
        return "mapping", [(key, value[key]) for key in sorted(value, key=str)]
    if isinstance(value, list | tuple):
        return "sequence", list(value)
    if isinstance(value, set | frozenset):
        return "set", sorted(value, key=str)
    if is_dataclass(value) and not isinstance(value, type):
        counted = [each.name for each in fields(value) if each.compare]
        return type(value).__name__, [(name, getattr(value, name)) for name in counted]
    return "", None
