"""Files written whole or not at all, and folders that one run at a time writes to."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from errno import EISDIR
from pathlib import Path
from typing import IO, TypeAlias

LOCK = ".lock"  # kept when a run ends: the lock is the system's, and ends with the process
PARTIAL = ".partial"

Place: TypeAlias = Callable[[str | Path], Path]  # where to write what is to stand at a path


def check_target(target: str | Path, *sources: str | Path) -> None:
    """Refuse what `spare` does, and a file in a folder that is not there: ValueError."""
    spare(target, *sources)
    if not Path(target).parent.is_dir():
        raise ValueError(f"{target}: there is no folder {Path(target).parent}; make it first")


def spare(target: str | Path, *sources: str | Path) -> None:
    """Refuse to write a file, by whatever name it goes, that holds what is read: ValueError."""
    place = Path(target)
    for source in map(Path, sources):
        if place.exists() and source.exists() and place.samefile(source):
            raise ValueError(
                f"{target} is what this is made from ({source}) and would be lost; name another "
                "file to write"
            )


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary file beside a path, which takes its place when the block ends without an error.

    Whatever ends the process earlier leaves the old file as it was. An OSError names the path.
    """
    temporary = _beside(path := Path(path))
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def at_once(*stale: str | Path) -> Iterator[Place]:
    """Files of one result: what is written where ``place(path)`` says takes its path at the end.

    All are whole by then, or none is moved. They are moved in turn, the first once the ``stale``
    ones are gone, former files that belong to the first as it was: whatever ends the process, what
    stands beside it was made with it. An OSError names the path.
    """
    staged: dict[Path, Path] = {}

    def place(path: str | Path) -> Path:
        staged[Path(path)] = _beside(Path(path))
        return staged[Path(path)]

    try:
        yield place
        _move(staged, stale)
    except OSError as error:
        wanted = {str(temporary): str(path) for path, temporary in staged.items()}
        if (name := wanted.get(str(error.filename))) is None:
            raise
        raise OSError(error.errno, error.strerror, name) from error
    finally:
        for temporary in staged.values():
            temporary.unlink(missing_ok=True)


def _move(staged: Mapping[Path, Path], stale: Iterable[str | Path]) -> None:
    """Put temporary files into their places, after removing what is stale."""
    for path in staged:
        if path.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(path))
    for each in stale:
        Path(each).unlink(missing_ok=True)
    for path, temporary in staged.items():
        temporary.replace(path)


def _beside(path: Path) -> Path:
    """An empty temporary file beside a path; an OSError names the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        descriptor, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name[:200]}.", suffix=PARTIAL
        )
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    os.close(descriptor)
    return Path(name)


@contextmanager
def claimed(
    folder: str | Path, remedy: str = "wait for its end, or name another folder by --output"
) -> Iterator[Path]:
    """A folder made if need be and held against other runs; what a killed run left is cleared.

    The lock is released by the system however the process ends. Windows has none: there, two runs
    in one folder replace each other's files, each of them whole. ValueError: the folder cannot be
    made or written to, or another run holds it, with the ``remedy`` for that.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("a+", encoding="ascii")
    except (OSError, ValueError) as error:
        other = "name a folder that can be written to, in the study or by --output"
        raise _unwritable(f"output {folder}", error, other) from error
    with lock:
        if not _taken(lock):
            lock.seek(0)
            holder = lock.read(100) or "process unknown"
            raise ValueError(f"output {folder}: another run is writing there ({holder}); {remedy}")
        for depth in ("", "*/", "*/*/"):
            for left in folder.glob(f"{depth}.*{PARTIAL}"):
                left.unlink(missing_ok=True)
        yield folder


def check_folder(folder: str | Path) -> None:
    """Make a folder to keep results in, before these take long: ValueError if none can be."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        raise _unwritable(f"folder {folder}", error, "name one that can be written to") from error


def _unwritable(what: str, error: OSError | ValueError, remedy: str) -> ValueError:
    reason = getattr(error, "strerror", None) or str(error)
    printable = what.replace("\0", "\\0")  # for which it is a ValueError
    return ValueError(f"{printable}: cannot write results there ({reason}); {remedy}")


def _taken(lock: IO[str]) -> bool:
    if sys.platform == "win32":
        return True
    import fcntl  # noqa: PLC0415 - not on Windows
    from multiprocessing.util import register_after_fork  # noqa: PLC0415 - by runs that write

    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    register_after_fork(lock, lambda file: file.close())  # or a fork would hold it beyond our end
    lock.truncate(0)
    lock.write(f"process {os.getpid()}")
    lock.flush()
    return True
