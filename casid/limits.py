"""Limits on what comes from outside: size of files, time in the user's code."""

import os
import signal
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

MIB = 2**20
TABLE_BYTES = 2048 * MIB  # of a file of samples, and of the numbers in it
JSON_BYTES = 1024 * MIB
USER_SECONDS = 60.0  # that importing a model file or one method of a model may take
TEXT_BYTES = 4 * MIB  # of a study file or a model file


def check_file(path: Path, limit: int, what: str) -> None:
    """Refuse what is no ordinary file, or larger [bytes] than ``what`` it is taken for may be."""
    try:
        found = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        printable = str(path).replace("\0", "\\0")
        raise ValueError(
            f"{printable}: cannot read it as {what} ({reason}); check the path"
        ) from error
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "no ordinary file"
        raise ValueError(f"{path}: cannot read it as {what}: it is {kind}; name a file")
    check_size(path, found.st_size, limit, what)


def check_size(path: Path, size: float, limit: int, what: str) -> None:
    """Refuse a size above its limit [bytes]."""
    if size > limit:
        raise ValueError(
            f"{path}: {size / MIB:.0f} MiB, more than the {limit / MIB:.0f} MiB that are read as "
            f"{what}; is it the right file? Split or decimate a long recording"
        )


class OutOfTimeError(Exception):
    """The user's code took longer than it may; never leaves casid."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Interrupt the user's code that takes longer, by OutOfTimeError, or that ends the process."""

    def told(status: int) -> NoReturn:
        raise SystemExit(f"it called os._exit({status})")

    leave, os._exit = os._exit, told
    try:
        with _alarm(seconds):
            yield
    finally:
        os._exit = leave


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    """Raise `OutOfTimeError` when the time is over."""
    # Only the main thread of a POSIX system can be interrupted; elsewhere there is no limit.
    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return

    def stop(_: int, __: FrameType | None) -> None:
        raise OutOfTimeError(f"it took longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    outer, _ = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, outer)  # what was left of a limit around this one
