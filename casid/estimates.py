"""Tables of a fit: a row for every parameter and constraint, and what holds them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.fit import ConstraintEstimate, ParameterEstimate
from casid.free import Free
from casid.model import Model
from casid.truncated import OnBounds

ACTIVE = 1e-6  # distance to a bound, relative to the parameter's scale, that counts as on it
NEAR = 1e-4  # the same, if the bound has a price
FELT = 0.01  # of what a parameter may move with the others known: nobody could tell
ROUNDING = 1e-9  # of the length of a direction that is free


def on_bounds(
    free: Free, values: Array, multipliers: Array, felt: Callable[[], Array] | None = None
) -> Array:
    """Free values (nf,) as an interior-point solver meant them: within bounds, on those that hold.

    It stops short of a bound, the nearer the larger the bound's multiplier: a parameter nearer than
    that in its own scale is on it, unless the data feel the rest. ``multipliers`` (nf,) are prices
    as in the parameter table; ``felt`` returns what a parameter may move with the others known, and
    is asked only where one may be on its bound.
    """
    lower, upper, scale = (each[free.index] for each in (free.lower, free.upper, free.scale))
    values = moved = np.clip(values, lower, upper)
    for bound, price in ((lower, multipliers * scale), (upper, -multipliers * scale)):
        gap = np.abs(values - bound) / scale
        moved = np.where((gap <= NEAR) & (gap < price), bound, moved)
    if felt is not None and (moved != values).any():
        moved = np.where(np.abs(moved - values) <= FELT * felt(), moved, values)
    return np.asarray(moved)


def at_bounds(free: Free, values: Array, felt: Array | None = None) -> BoolArray:
    """Which free values (nf,) are on a bound, as far as rounding and the data tell.

    Bounds may be so wide that hardly anything is far in the scale that they give: what the data
    feel of the way, with ``felt`` (nf,) what a parameter may move, is none.
    """
    lower, upper, scale = (each[free.index] for each in (free.lower, free.upper, free.scale))
    gap = np.minimum(values - lower, upper - values)
    near = gap <= ACTIVE * scale
    if felt is not None:
        near &= ~(gap > FELT * felt)
    return np.asarray(near)


def parameter_table(
    free: Free,
    values: Array,
    multipliers: Array,
    std_error: Array | None = None,
    insensitivity: Array | None = None,
    cramer_rao: Array | None = None,
    guess: Model | None = None,
) -> tuple[ParameterEstimate, ...]:
    """Rows of the parameter table from free values, multipliers, errors: (nf,), in physical units.

    What is missing is NaN, as the errors of what bounds and ties hold; ``guess`` is what the
    estimator started from, the model of ``free`` unless given.
    """
    model, full = free.model, free.full(np.asarray(values, dtype=float))
    moving = np.isin(np.arange(len(full)), free.index)
    active = np.zeros(len(full), dtype=bool)
    active[free.index] = at_bounds(free, full[free.index], insensitivity)
    held = active.copy()
    held[free.index] |= _without_room(free, full[free.index], active[free.index])

    def column(values: Array | None, fixed: float) -> Array:
        """Free values (nf,) among those of all parameters (n,); NaN if None."""
        every = np.full(len(full), fixed)
        every[free.index] = np.nan if values is None else values
        return every

    columns = {
        "value": full,
        "guess": (guess or model).vector(),
        "lower": free.lower,
        "upper": free.upper,
        "multiplier": np.where(active, column(multipliers, 0.0), 0.0),
        "std_error": np.where(held, np.nan, column(std_error, 0.0)),
        "insensitivity": column(insensitivity, np.nan),
        "cramer_rao": np.where(held, np.nan, column(cramer_rao, np.nan)),
    }
    rows = []
    for i, (name, info) in enumerate(model.infos().items()):
        numbers: Any = {key: float(values[i]) for key, values in columns.items()}
        prior, std = map(float, free.priors.get(name, (np.nan, np.nan)))
        told: Any = {"name": name, "unit": info.unit, "prior": prior, "prior_std": std}
        state: Any = {"active": bool(active[i]), "fixed": not moving[i]}
        rows.append(ParameterEstimate(**told, **numbers, **state))
    return tuple(rows)


def constraint_table(model: Model, prices: Array, sizes: Array) -> tuple[ConstraintEstimate, ...]:
    """Rows of the constraints at the estimates; prices (m,): slopes of the cost by their values.

    ``sizes`` (m,) are what counts as one of each, `Free.constraint_sizes`.
    """
    rows = []
    for item, price, size in zip(model.constraints(), prices, sizes.tolist(), strict=True):
        value, lower, upper = (float(each) for each in (item.value, item.lower, item.upper))
        active = lower == upper or min(value - lower, upper - value) <= ACTIVE * size
        told: Any = {"name": item.name, "value": value, "lower": lower, "upper": upper}
        slope = float(price) if active else 0.0
        rows.append(ConstraintEstimate(**told, active=active, multiplier=slope))
    return tuple(rows)


def holding(free: Free, values: Array, active: BoolArray) -> Array:
    """Gradients by the free parameters of all that holds them at these values, (m, nf).

    First the bounds of those ``active`` (nf,), then ties and inequalities with no room left.
    """
    bounds = np.eye(len(free.index))[active]
    if not free.model.constraints():
        return bounds
    model = free.model.with_vector(free.full(values))
    rows = constraint_table(model, np.zeros(len(model.constraints())), free.constraint_sizes)
    held = np.array([row.active for row in rows])
    return np.vstack([bounds, free.constraint_slopes(values)[held]])


def within(
    free: Free, values: Array, active: BoolArray, multipliers: Array, prices: Array
) -> tuple[OnBounds, Array]:
    """What lies within bounds: those ``active`` (nf,), inequalities with no room left; and ties.

    Ties are gradients (m, nf) by the free parameters of what leaves nothing open. ``multipliers``
    (nf,) and ``prices`` are slopes of the cost as the tables have them.
    """
    lower, upper = free.lower[free.index], free.upper[free.index]
    rows, slopes = np.eye(len(values)), free.constraint_slopes(values)
    table = constraint_table(
        free.model.with_vector(free.full(values)), prices, free.constraint_sizes
    )
    held = np.array([row.active for row in table], dtype=bool)
    value, low, high = (
        np.append(own, [getattr(row, name) for row in table])
        for own, name in ((values, "value"), (lower, "lower"), (upper, "upper"))
    )
    rows, on = np.vstack([rows, slopes]), np.append(active, held)
    side, room = np.where(value - low < high - value, 1.0, -1.0), high - low
    open_ = on & (room > 0)
    slope = np.append(multipliers, prices)
    return OnBounds(rows[open_], slope[open_], side[open_], room[open_]), rows[on & ~open_]


def _without_room(free: Free, values: Array, active: BoolArray) -> BoolArray:
    """Which free parameters (nf,) bounds and ties leave no room, their own bound or another's."""
    gradients = holding(free, values, active) * free.scale[free.index]
    if not len(gradients):
        return active
    room = scipy.linalg.null_space(gradients, rcond=ROUNDING)
    return np.asarray(np.linalg.norm(room, axis=1) < ROUNDING)


def held_directions(free: Free, values: Array, rows: tuple[ParameterEstimate, ...]) -> int:
    """Number of directions in which active bounds and constraints hold the free values (nf,)."""
    active = np.array([rows[i].active for i in free.index])
    gradients = holding(free, values, active) * free.scale[free.index]
    return int(np.linalg.matrix_rank(gradients)) if len(gradients) else 0
