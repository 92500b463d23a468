"""Results on disk, so that interrupted work goes on where it stopped.

Stages of a study and the jobs of a campaign are kept alike: a file each, written whole or not at
all, with a key in it, a digest of all the result depends on, and one of the file's content. A
result is taken again only if nothing it rests on has changed, nor the file itself.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from casid.errors import warn
from casid.textfile import read_json, write_text
from casid.values import DAMAGED, content_digest, decode, encode

PLAIN = re.compile(r"[a-z0-9_]{1,40}")  # names that are file names on every system


@dataclass(frozen=True, eq=False, kw_only=True)
class Done:
    """Result of a stage or a job."""

    result: Any  # what it found; of one that failed what it has to show, or None
    reason: str = ""  # why it failed; empty if it did not
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()  # what it warned of
    source: str = ""  # job from whose result it started
    kept: bool = False  # whether it was done in an earlier run


class Store:
    """Results in a folder, made with the first; ``also`` are the user's classes they may hold."""

    def __init__(self, folder: str | Path | None, also: Sequence[type] = ()) -> None:
        self.folder = None if folder is None else Path(folder)
        self.also = also

    def path(self, name: str) -> Path:
        """File of a result."""
        if not PLAIN.fullmatch(name):
            short = re.sub(r"[^A-Za-z0-9.+-]+", "_", name)[:40].strip("_")
            name = f"{short}.{hashlib.sha256(name.encode()).hexdigest()[:8]}"
        return (self.folder or Path()) / f"{name}.json"

    def get(self, name: str, key: str | None) -> Done | None:
        """What is kept under a name; None unless finished with the same key, if one is given.

        A file whose content is not what was written is not taken either: `DataWarning`.
        """
        if self.folder is None or not self.path(name).exists():
            return None
        try:
            content = read_json(self.path(name))
            if content["casid"] != "result" or key not in (None, content["key"]):
                return None
            if content["digest"] != content_digest(content):
                warn(f"{self.path(name)} was changed after casid wrote it; it is computed again")
                return None
            parts = {part: decode(content[part], self.also) for part in PARTS}
            return Done(**parts, kept=True)
        except DAMAGED:  # or another version's file: compute it again
            return None

    def put(self, name: str, key: str, done: Done) -> None:
        """Keep a result."""
        if self.folder is not None:
            content = {"casid": "result", "name": name, "key": key}
            content |= {part: encode(getattr(done, part)) for part in PARTS}
            content["digest"] = content_digest(content)
            # Without lines of its own for each number: those take ten times as long to write.
            write_text(self.path(name), json.dumps(content, allow_nan=False) + "\n")


PARTS = ("reason", "seconds", "warnings", "source", "result")
