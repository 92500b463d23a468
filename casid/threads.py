"""Threads: one of linear algebra, whatever the environment says, and one a core where work splits.

Matrices of identification have tens of rows. OpenBLAS hands even those to all processors, where
threads that wait for each other cost more than the arithmetic.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar, copy_context
from functools import cache, wraps
from multiprocessing import parent_process
from typing import ParamSpec, TypeVar

import scipy.linalg  # noqa: F401 - loads the libraries that are to be limited
from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
T = TypeVar("T")
U = TypeVar("U")

_ALONE: ContextVar[bool] = ContextVar("alone", default=False)


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """A function during which linear algebra has one thread; afterwards, as many as before."""

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        with limited():
            return function(*args, **kwargs)

    return alone


def limited() -> AbstractContextManager[object]:
    """A context in which linear algebra has one thread."""
    context: AbstractContextManager[object] = _libraries().limit(limits=1, user_api="blas")
    return context


def cores() -> int:
    """Processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def alone(told: bool) -> Iterator[None]:
    """A context in which a process of many is told whether the others have work."""
    before = _ALONE.set(told)
    try:
        yield
    finally:
        _ALONE.reset(before)


def on_all_cores(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
    """Values of a function in the order of the items, computed by a thread for every core.

    By this thread alone in a process of many that share the work, which have the cores already
    unless it works `alone`.
    """
    each = list(items)
    shared = parent_process() is not None and not _ALONE.get()
    threads = 1 if shared else min(cores(), len(each))
    if threads <= 1:
        yield from map(function, each)
        return
    contexts = [copy_context() for _ in each]  # of NumPy's errstate
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(lambda context, item: context.run(function, item), contexts, each)
