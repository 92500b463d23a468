"""Threads of linear algebra: one, whatever the environment says.

Matrices of identification have tens of rows. OpenBLAS hands even those to all processors, where
threads that wait for each other cost more than the arithmetic.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import scipy.linalg  # noqa: F401 - loads the libraries that are to be limited
from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
T = TypeVar("T")


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """A function during which linear algebra has one thread; afterwards, as many as before."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
