"""Tables of a TOML file that know their place, so that a message can name it."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from casid.checks import check_known
from casid.errors import ModelError
from casid.limits import TEXT_BYTES, check_file


@dataclass(frozen=True)
class Table:
    """A TOML table that knows its place, for messages."""

    content: Mapping[str, Any]
    place: str

    def only(self, known: Iterable[str]) -> None:
        """Refuse keys that nobody reads."""
        check_known(f"{self.place} unknown key", self.content, known)

    def table(self, key: str, *, needed: bool = False) -> "Table":
        """Return a table within this one, empty if it is not there."""
        if needed and key not in self.content:
            raise ValueError(f"{self.place} there is no table [{key}], which a study needs")
        content = self.content.get(key, {})
        if not isinstance(content, dict):
            raise ValueError(f"{self.place} {key} is {content!r}, expected a table [{key}]")  # noqa: TRY004
        return Table(content, f"{self.place.removesuffix(':').rstrip()} [{key}]:")

    def take(self, key: str, kind: type | tuple[type, ...], default: Any = None) -> Any:  # noqa: ANN401
        """Return a value of the kind wanted."""
        value = self.content.get(key, default)
        kinds = kind if isinstance(kind, tuple) else (kind,)
        wrong_bool = isinstance(value, bool) and bool not in kinds
        if value is not default and (wrong_bool or not isinstance(value, kinds)):
            wanted = " or ".join(each.__name__ for each in kinds)
            raise ValueError(f"{self.place} {key} = {value!r}, expected {wanted}")
        return value

    def names(self, key: str, default: Sequence[str] = ()) -> tuple[str, ...]:
        """Return a list of names."""
        value = self.take(key, (list, str), list(default))
        if isinstance(value, str):
            value = [value]
        if any(not isinstance(item, str) for item in value):
            raise ValueError(f"{self.place} {key} = {value!r}, expected a list of names")
        return tuple(value)

    def pair(self, key: str, wanted: str) -> tuple[float, float]:
        """Return two numbers; ``wanted`` says in words which."""
        value = self.take(key, list)
        numeric = all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        if len(value) != 2 or not numeric:
            raise ValueError(f"{self.place} {key} = {value!r}, expected {wanted}")
        return float(value[0]), float(value[1])

    def numbers(self, key: str) -> dict[str, float]:
        """Return a table of numbers."""
        table = self.table(key)
        return {name: float(table.take(name, (int, float))) for name in table.content}


@contextmanager
def placed(place: str) -> Iterator[None]:
    """Put the place before the message of a ValueError or ModelError that is raised within."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"{place} {error}") from error
    except ValueError as error:
        raise ValueError(f"{place} {error}") from error


def read_toml(path: Path) -> Table:
    """Return the top table of a file."""
    check_file(path, TEXT_BYTES, "a study file")
    try:
        return Table(tomllib.loads(path.read_text(encoding="utf-8")), f"{path}:")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: cannot read the study file ({error}); save it as text in UTF-8"
        ) from error
    except OSError as error:
        raise ValueError(f"{path}: cannot read the study file ({error})") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not TOML: {error}") from error
