"""Results of a study's stages on disk, so that an interrupted study goes on where it stopped.

Every stage has a file and a key; the key is a digest of all the stage depends on, so a result is
taken again only if nothing it rests on has changed. `casid.files.write_text` replaces files whole,
and the index is written after the result: a crash leaves the stage as not done.
"""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

from casid.files import read_json, write_json
from casid.fit import Fit
from casid.model import Model
from casid.values import decode, encode

SHOWING = (
    "cli.py",
    "commands",
    "jobs",
    "report",
    "studies",
)  # code that changes no result of a stage

Result = Any  # a fit, or a frozen value that `storable` marks


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
        if not dataclasses.is_dataclass(result):
            raise ValueError(f"{self.path(stage)} holds no result of a stage")
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


def source_digest() -> str:
    """Digest of the code that computes results: a result of another version is not taken."""
    folder = Path(__file__).parents[1]
    sha = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        place = file.relative_to(folder)
        if place.parts[0] not in SHOWING:
            sha.update(place.as_posix().encode() + file.read_bytes())
    return sha.hexdigest()
