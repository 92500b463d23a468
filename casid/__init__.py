"""Rotorcraft system identification in the time and frequency domains.

Public names stand in ``__init__.pyi``; each is imported when it is first used. A function is
handed out with its arguments checked, so that what stands below need not doubt them.
"""

from types import FunctionType
from typing import Any

from lazy_loader import attach_stub

_import, __dir__, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any public name
    found = _import(name)
    if not isinstance(found, FunctionType) or name in {"parameter", "matrix", "spline"}:
        return found  # those three are the words of a structure, which is checked as a whole
    from casid.checks import checked  # noqa: PLC0415 - importing casid imports nothing else

    careful = globals()[name] = checked(found)
    careful.__module__, careful.__qualname__ = __name__, name  # where pickle finds it
    return careful
