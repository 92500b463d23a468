"""Smooth functions of data: a natural cubic spline that takes numbers and symbols."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError

MOST = 200  # knots: truncated powers lose half the digits there
Noted: TypeAlias = list[tuple[ca.SX, float, float]]  # a table's argument, its first and last knot
_NOTED: ContextVar[Noted | None] = ContextVar("noted", default=None)


@contextmanager
def noted() -> Iterator[Noted]:
    """The tables of symbols that are used within, to tell what they cover."""
    found: Noted = []
    token = _NOTED.set(found)
    try:
        yield found
    finally:
        _NOTED.reset(token)


def spline(x: Any, knots: Sequence[float], values: Sequence[Any]) -> Any:  # noqa: ANN401 - SX or float
    """The natural cubic spline through values at knots, a straight line beyond them.

    Parameters
    ----------
    x : float or SX
        Where it is wanted.
    knots : sequence of float
        Abscissae, increasing, two or more.
    values : sequence of float or SX
        Ordinates: data, or parameters of a structure.

    Raises
    ------
    ModelError
        Knots that do not increase, not as many values, more than 200 knots (which lose digits).
    """
    t = np.asarray(knots, dtype=float)
    if t.ndim != 1 or len(t) < 2 or not (np.diff(t) > 0).all():
        raise ModelError(f"spline: knots {list(knots)}, expected two or more, increasing")
    if len(t) > MOST:
        raise ModelError(
            f"spline: {len(t)} knots, expected {MOST} at most: what is smooth needs fewer, and "
            "more lose digits"
        )
    if len(values) != len(t):
        raise ModelError(f"spline: {len(values)} values at {len(t)} knots")
    if (tables := _NOTED.get()) is not None and isinstance(x, ca.SX):
        tables.append((x, float(t[0]), float(t[-1])))
    # Truncated powers: s = a + b z + Σ d_i (z - z_i)₊³ has no curvature before the first knot, and
    # none behind the last one, since natural splines have none there.
    span = float(t[-1] - t[0])
    z = (x - float(t[0])) / span
    ramp = (lambda x: ca.fmax(x, 0)) if isinstance(z, ca.SX) else (lambda x: max(x, 0.0))
    basis = [1.0, z, *(ramp(z - float(knot)) ** 3 for knot in (t - t[0]) / span)]
    weights = _powers((t - t[0]) / span) @ np.eye(len(t))
    total: Any = 0.0
    for i, value in enumerate(values):
        total += value * sum(float(w) * b for w, b in zip(weights[:, i], basis, strict=True))
    return total


def _powers(z: Array) -> Array:
    """Coefficients of truncated powers (2 + n, n) for ordinates of unit size at knots z (n,)."""
    n = len(z)
    basis = np.column_stack([np.ones(n), z, np.maximum(z[:, None] - z, 0.0) ** 3])
    # Natural: neither quadratic nor cubic part is left behind the last knot.
    ends = np.array([np.r_[0.0, 0.0, np.ones(n)], np.r_[0.0, 0.0, z]])
    right = np.vstack([np.eye(n), np.zeros((2, n))])
    return np.asarray(np.linalg.solve(np.vstack([basis, ends]), right))
