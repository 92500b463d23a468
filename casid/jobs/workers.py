"""Where jobs run: in this process, in processes of our own, on the user's executor."""

import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from concurrent.futures import ProcessPoolExecutor as Pool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

from casid.jobs.child_process import FORKS, end_alike, forking
from casid.threads import cores, limited

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Workers:
    """Where jobs run: here in this process, one at a time."""

    slots = 1  # how many to hand over at once

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":  # noqa: ANN401
        """Hand over one."""
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def renew(self) -> bool:
        """Replace processes that died; whether that is possible."""
        return False


class OtherExecutor(Workers):
    """The user's executor; as many jobs as there are."""

    slots = sys.maxsize

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":  # noqa: ANN401
        """Hand over one."""
        try:
            return self._executor.submit(function, *arguments)
        except BrokenExecutor as error:
            future: Future[Any] = Future()
            future.set_exception(error)
            return future


class OwnProcesses(Workers):
    """Processes of our own; new ones when one has died.

    They are forks, which have casid and the user's structure loaded: to load them takes longer than
    many a case. Where forks are not safe, they are new ones.
    """

    def __init__(self, count: int) -> None:
        self.slots, self._count = 2 * count, count
        self._others = set(multiprocessing.active_children())
        self._pool = self._new()

    def _new(self) -> Pool:
        """All processes at once: those without a job yet load casid while the first is done."""
        context = multiprocessing.get_context("fork" if FORKS else "spawn")
        pool = Pool(self._count, mp_context=context, initializer=_begin)
        with _surroundings(), forking():
            for _ in range(self._count):
                pool.submit(cores)
        return pool

    def __enter__(self) -> "OwnProcesses":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:  # interrupted: what still runs is no result
            for process in set(multiprocessing.active_children()) - self._others:
                process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":  # noqa: ANN401
        """Hand over one."""
        with _surroundings():
            return self._pool.submit(function, *arguments)

    def renew(self) -> bool:
        """Replace processes that died; whether that is possible."""
        self._pool.shutdown(cancel_futures=True)
        self._pool = self._new()
        return True


def _begin() -> None:
    """End with the process that began this one, and leave to it what users are told.

    A fork has that one's handlers of signals and logs, and its threads of linear algebra.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    logging.getLogger("casid").disabled = True
    limited()
    end_alike()


@contextmanager
def _surroundings() -> Iterator[None]:
    """What processes started here find: one BLAS thread, no interrupts, no script to run again.

    A new process, unless it is a fork, imports the script it was started from; one without ``if
    __name__ == "__main__"`` would begin its study once more in every process. Jobs need nothing of
    it. An interrupt from the keyboard reaches all processes of a terminal: this ends the others.
    """
    added = [name for name in ONE_THREAD if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    main = vars(sys.modules["__main__"])
    hidden: Mapping[str, Any] = {key: main.pop(key) for key in ("__file__",) if key in main}
    spec, main["__spec__"] = main.get("__spec__"), None
    mask = _block_interrupts()
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        main.update(hidden, __spec__=spec)
        for name in added:
            del os.environ[name]


def _block_interrupts() -> set[signal.Signals | int] | None:
    """Hold interrupts back, as new processes then do for good; what was held back before."""
    if not hasattr(signal, "pthread_sigmask"):  # no POSIX system
        return None
    resource_tracker.ensure_running()  # starting it later would let them through again
    return signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
