"""Work in a process beside this one."""

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

T = TypeVar("T")

FORKS = sys.platform.startswith("linux")  # elsewhere libraries of the system do not survive them


@contextmanager
def beside(work: Callable[[], T]) -> Iterator[Callable[[], T]]:
    """Begin work in a process beside this one; what is yielded waits for its result.

    The process is a fork, which has all that is loaded and costs a hundredth of a second: a new one
    would import for longer than the work takes. Where there is one processor, where forks are not
    safe, and if the fork fails at its work, the work is done here when its result is asked for.
    """
    if not FORKS or len(os.sched_getaffinity(0)) < 2:
        yield work
        return
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(here, there, work), daemon=True)
    with forking():
        process.start()
    there.close()
    try:
        yield lambda: _receive(here, work)
    finally:
        here.close()
        process.terminate()
        process.join()
        process.close()


@contextmanager
def forking() -> Iterator[None]:
    """A context in which processes are forked, whatever threads there are."""
    with warnings.catch_warnings():  # the thread that draws the progress takes no lock of figures
        warnings.simplefilter("ignore", DeprecationWarning)
        yield


def _send(other: Connection, end: Connection, work: Callable[[], Any]) -> None:
    """Send the result of the work, nothing if it fails; terminated, leave no file half written."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever began this ends it
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    other.close()
    end_alike()
    with end, suppress(Exception):
        end.send(work())


def end_alike() -> None:
    """Let this process terminate when the one that began it is gone, however that ended."""
    threading.Thread(target=_terminate_alike, daemon=True).start()


def _terminate_alike() -> None:
    began = multiprocessing.parent_process()
    if began is not None:
        wait([began.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


def _receive(end: Connection, work: Callable[[], T]) -> T:
    try:
        found: T = end.recv()
    except EOFError:  # told by the exception that the same work raises here, if it does
        return work()
    return found
