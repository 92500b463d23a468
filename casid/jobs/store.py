"""Results of a study's stages on disk, so that an interrupted study goes on where it stopped.

Every stage has a file and a key; the key is a digest of all the stage depends on, so a result is
taken again only if nothing it rests on has changed. `casid.files.write_text` replaces files whole,
and the index is written after the result: a crash leaves the stage as not done.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from casid.files import read_json, write_json
from casid.fit import Fit
from casid.frequency.estimation import FrequencyResponse
from casid.linear import StateSpace
from casid.model import Model
from casid.record import Record
from casid.subspace.columns import Segment
from casid.subspace.modal import Modal
from casid.subspace.pbsid import BlackBox
from casid.subspace.prediction import SampledUncertainty
from casid.subspace.refinement import ResponseUncertainty
from casid.subspace.settings import Candidate, OrderSelection

SHOWING = (
    "cli.py",
    "commands",
    "jobs",
    "report",
    "studies",
)  # code that changes no result of a stage

VALUES: Mapping[str, Callable[..., Any]] = {  # what a file of results may make, and nothing else
    kind.__name__: kind
    for kind in (
        BlackBox,
        Candidate,
        FrequencyResponse,
        OrderSelection,
        ResponseUncertainty,
        SampledUncertainty,
        Segment,
        Modal,
        StateSpace,
    )
}
Result = Fit | BlackBox | FrequencyResponse


@dataclasses.dataclass(frozen=True)
class Entry:
    """What the index says of a finished stage; ``warnings`` are those it gave."""

    key: str
    seconds: float
    warnings: tuple[str, ...] = ()


class Store:
    """Finished stages of one study in one folder."""

    def __init__(self, folder: str | Path, model: type[Model]) -> None:
        self.folder = Path(folder)
        self._model = model

    def get(self, stage: str, key: str) -> tuple[Result, Entry] | None:
        """Result and entry of a stage; None unless it was finished with the same key."""
        entry = self._index().get(stage)
        if entry is None or entry.key != key:
            return None
        try:
            return self._read(stage), entry
        except (
            ValueError,
            TypeError,
            LookupError,
            AttributeError,
            RecursionError,
        ):  # another version's file: compute it again
            return None

    def put(self, stage: str, result: Result, entry: Entry) -> None:
        """Keep a finished stage."""
        if isinstance(result, Fit):
            result.save(self.path(stage))
        else:
            write_json(self.path(stage), {"casid": "stage", "result": encode(result)})
        index = self._index() | {stage: entry}
        write_json(self.folder / "index.json", {k: dataclasses.asdict(v) for k, v in index.items()})

    def path(self, stage: str) -> Path:
        """File of a stage's result."""
        return self.folder / f"{stage}.json"

    def _read(self, stage: str) -> Result:
        content = read_json(self.path(stage))
        if content.get("casid") == "fit":
            return Fit.load(self.path(stage), model=self._model)
        result = decode(content["result"])
        if not isinstance(result, BlackBox | FrequencyResponse):
            raise ValueError(f"{self.path(stage)} holds no result of a stage")  # noqa: TRY004
        return result

    def _index(self) -> dict[str, Entry]:
        try:
            content = read_json(self.folder / "index.json")
            return {
                stage: Entry(e["key"], e["seconds"], tuple(e["warnings"]))
                for stage, e in content.items()
            }
        except (ValueError, TypeError, KeyError):
            return {}


def digest(*parts: Any) -> str:  # noqa: ANN401 - anything the encoder knows
    """Digest of values, records and arrays that a result depends on."""
    sha = hashlib.sha256()
    for part in parts:
        sha.update(json.dumps(encode(part), sort_keys=True, default=repr).encode())
    return sha.hexdigest()


def source_digest() -> str:
    """Digest of the code that computes results: a result of another version is not taken."""
    folder = Path(__file__).parents[1]
    sha = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        place = file.relative_to(folder)
        if place.parts[0] not in SHOWING:
            sha.update(place.as_posix().encode() + file.read_bytes())
    return sha.hexdigest()


def record_digest(records: Iterable[Record]) -> str:
    """Digest of records: samples, names and hold."""
    sha = hashlib.sha256()
    for record in records:
        for array in (record.t, record.u, record.y):
            sha.update(np.ascontiguousarray(array).tobytes())
        names = (record.inputs, record.outputs, record.name, record.hold)
        sha.update(json.dumps(names).encode())
    return sha.hexdigest()


def encode(value: Any) -> Any:  # noqa: ANN401 - JSON is any
    """Plain JSON of numbers, arrays, tuples, mappings and casid's frozen values."""
    if isinstance(value, list):
        return [encode(item) for item in value]
    if isinstance(value, np.ndarray):
        complex_ = value.dtype.kind == "c"
        parts = [value.real.tolist(), value.imag.tolist()] if complex_ else value.tolist()
        return {"array": parts, "kind": value.dtype.kind, "shape": list(value.shape)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        content = {f.name: encode(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"value": type(value).__name__, "fields": content}
    if isinstance(value, tuple | Mapping):
        return _encode_container(value)
    return _encode_scalar(value)


def _encode_container(value: tuple[Any, ...] | Mapping[str, Any]) -> dict[str, Any]:
    if isinstance(value, tuple):
        return {"tuple": [encode(item) for item in value]}
    return {"mapping": {str(key): encode(item) for key, item in value.items()}}


def _encode_scalar(value: Any) -> Any:  # noqa: ANN401
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not np.isfinite(value):
        return {"float": str(value)}
    return value


def decode(content: Any) -> Any:  # noqa: ANN401 - JSON is any
    """Invert `encode`.

    Raises
    ------
    ValueError, TypeError, LookupError, AttributeError
        A value this version of casid does not know.
    """
    if isinstance(content, list):
        return [decode(item) for item in content]
    if not isinstance(content, dict):
        return content
    kind = next(iter(content), "")
    return DECODERS[kind](content)


def _array(content: Mapping[str, Any]) -> Any:  # noqa: ANN401 - of any kind
    if content["kind"] == "c":
        re, im = (np.array(part, dtype=float) for part in content["array"])
        return (re + 1j * im).reshape(content["shape"])
    kinds = {"f": float, "b": bool, "i": int}
    return np.array(content["array"], dtype=kinds[content["kind"]]).reshape(content["shape"])


def _value(content: Mapping[str, Any]) -> Any:  # noqa: ANN401 - a frozen value of casid
    made = VALUES[content["value"]]
    return made(**{key: decode(item) for key, item in content["fields"].items()})


DECODERS: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    "array": _array,
    "value": _value,
    "tuple": lambda content: tuple(decode(item) for item in content["tuple"]),
    "mapping": lambda content: {key: decode(item) for key, item in content["mapping"].items()},
    "float": lambda content: float(content["float"]),
}
