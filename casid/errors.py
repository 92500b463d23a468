"""The typed failures of casid; a bad argument is a plain ``ValueError``."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from inspect import currentframe
from typing import Any

_ASKED = ContextVar("asked", default=True)


class ModelError(ValueError):
    """A model structure is wrong or cannot be identified; the message names the culprit."""


class ConvergenceError(RuntimeError):
    """A solver stopped early; ``best`` holds its last iterate (a `Fit` with ``success=False``)."""

    def __init__(self, message: str, best: Any = None) -> None:  # noqa: ANN401 - Fit lives above
        super().__init__(message)
        self.best = best


class DataWarning(UserWarning):
    """The data make a result less trustworthy than it looks; the message says what to do."""


def warn(message: str) -> None:
    """Issue a `DataWarning` for the line outside casid that led here."""
    frame, level = currentframe(), 1
    while frame is not None and str(frame.f_globals.get("__name__")).startswith("casid."):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, DataWarning, stacklevel=level)


def asked() -> bool:
    """Whether an estimator is to ask its data what costs much and only leads to a warning."""
    return _ASKED.get()


@contextmanager
def unasked(*, when: bool = True) -> Iterator[None]:
    """Within, if ``when`` holds, data are not `asked`: a fit beside has told, or nobody listens."""
    token = _ASKED.set(_ASKED.get() and not when)
    try:
        yield
    finally:
        _ASKED.reset(token)
