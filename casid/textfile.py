"""Text and JSON, written whole or not at all and read back as plain values."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from casid.folder import at_once, replacing
from casid.limits import JSON_BYTES, check_file
from casid.values import content_digest


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole or not at all: a crash leaves the old file as it was."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def write_texts(files: Mapping[Path, str]) -> None:
    """Write text files of one result by path: all of them, or on a full disk none."""
    with at_once() as place:
        for path, text in files.items():
            write_text(place(path), text)


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write JSON atomically; arrays become lists, NaN and infinities become null or strings."""
    write_text(path, json.dumps(plain(content), indent=1, allow_nan=False) + "\n")


def write_result(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write a result as JSON, whole or not at all, with the digest of what is written."""
    held = plain(content)
    write_json(path, held | {"digest": content_digest(held)})


def read_json(path: str | Path) -> dict[str, Any]:
    """Read what `write_json` wrote, as plain lists and numbers."""
    path = Path(path)
    check_file(path, JSON_BYTES, "JSON")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: cannot read it as JSON ({error}); write it again") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected a JSON object, found {type(content).__name__}")  # noqa: TRY004
    return content


def stored_number(value: float | str | None) -> float:
    """The float that `write_json` stored: null is NaN, "inf" and "-inf" are themselves."""
    return np.nan if value is None else float(value)


def plain(value: Any) -> Any:  # noqa: ANN401 - JSON is any
    """A value as `write_json` writes it and `read_json` returns it."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None if np.isnan(value) else str(value)
    return value
