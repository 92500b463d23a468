"""Files written whole or not at all, and folders that one run at a time writes to."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

LOCK = ".lock"  # kept when a run ends: the lock is the system's, and ends with the process
PARTIAL = ".partial"


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
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        descriptor, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name[:200]}.", suffix=PARTIAL
        )
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    os.close(descriptor)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def claimed(folder: str | Path) -> Iterator[Path]:
    """A folder made if need be and held against other runs; what a killed run left is cleared.

    The lock is released by the system however the process ends. Windows has none: there, two runs
    in one folder replace each other's files, each of them whole. ValueError: the folder cannot be
    made or written to, or another run holds it.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("a+", encoding="ascii")
    except (OSError, ValueError) as error:
        remedy = "name a folder that can be written to, in the study or by --output"
        raise _unwritable(f"output {folder}", error, remedy) from error
    with lock:
        if not _taken(lock):
            lock.seek(0)
            holder = lock.read(100) or "process unknown"
            raise ValueError(
                f"output {folder}: another run is writing there ({holder}); wait for its "
                "end, or name another folder by --output"
            )
        for left in [*folder.glob(f".*{PARTIAL}"), *folder.glob(f"*/.*{PARTIAL}")]:
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
