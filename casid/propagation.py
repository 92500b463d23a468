"""The errors of a fit carried on: to first order, and by models drawn from them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.errors import warn
from casid.fit import AnyFit, ParameterEstimate
from casid.model import M, Model
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import warn_unbalanced
from casid.undermodelling import Undermodelling

STEP = 1e-3  # of a standard error


def sample_models(fit: "AnyFit", count: int, *, seed: int = 0) -> tuple[Model, ...]:
    """Models drawn from the normal distribution of a fit's errors, each within its bounds.

    Parameters on a bound move inward, as far as the data allow, and others with them. Models of a
    nonlinear structure's fit are nonlinear: what takes linear ones, as `cover` does, sees each at
    its reference condition unless given ``model.at(trim)`` of each.

    Parameters
    ----------
    fit : Fit
        With a covariance.
    count : int
        How many, at least 1.
    seed : int
        Of the draws.

    Raises
    ------
    ValueError
        A fit without covariance, a count below 1.
    """
    if count < 1:
        raise ValueError(f"count={count}: expected at least one model")
    return drawn_models(fit, *_covariance(fit), count, seed)


def drawn_models(
    fit: AnyFit, names: Sequence[str], C: Array, count: int, seed: int
) -> tuple[Model, ...]:
    """Models drawn from the normal distribution of parameters of covariance C."""
    rng = np.random.default_rng(seed)
    rows = [fit[name] for name in names]
    center = np.array([row.value for row in rows])
    low, high = ([getattr(row, side) for row in rows] for side in ("lower", "upper"))
    away = rng.multivariate_normal(np.zeros(len(C)), C, size=count, method="eigh")
    drawn = np.clip(center + _inward(away, rows, C), low, high)
    return tuple(_with(fit.model, names, each) for each in drawn)


def _inward(away: Array, rows: Sequence[ParameterEstimate], C: Array) -> Array:
    """Deviations (count, n), each the other way round where what is on a bound would leave it.

    Of several the one that is farthest away of its errors tells.
    """
    at = [k for k, row in enumerate(rows) if row.active and C[k, k] > 0]
    if not at:
        return away
    below = [rows[k].value - rows[k].lower < rows[k].upper - rows[k].value for k in at]
    sized = away[:, at] / np.sqrt(np.diag(C)[at])
    farthest = np.abs(sized).argmax(axis=1)
    inside = np.where(below, 1.0, -1.0)[farthest] * sized[np.arange(len(sized)), farthest]
    return np.where(inside < 0, -1.0, 1.0)[:, None] * away


def spread(
    fit: AnyFit, function: Callable[[Model], Array], error: Undermodelling | None = None
) -> Array:
    """Standard deviation of each entry of a function of the model, to first order.

    The covariance of the parameters that ``error`` has is added. ValueError: a fit without one.
    """
    return first_order(fit, function, *known_errors(fit, error))


def known_errors(fit: AnyFit, error: Undermodelling | None) -> tuple[tuple[str, ...], Array]:
    """Free parameters and their covariance with that of ``error``; warns of what it is about."""
    names, C = _covariance(fit)
    if isinstance(fit.model, NonlinearModel):
        warn_unbalanced(fit.model, "these are bands of its linearisation there")
    if error is not None:
        C = C + error.of(fit).covariance
    return names, C


def first_order(
    fit: AnyFit, function: Callable[[Model], Array], names: tuple[str, ...], C: Array
) -> Array:
    """Standard deviation of each entry of a function of parameters of covariance C."""
    center = np.array([fit[name].value for name in names])
    slopes = []
    for k, std in enumerate(np.sqrt(np.diag(C))):
        row, ends = fit[names[k]], np.array([center, center])
        ends[:, k] += STEP * std * np.array([-1.0, 1.0])
        ends[:, k] = np.clip(ends[:, k], row.lower, row.upper)
        width = float(np.ptp(ends[:, k]))
        if width == 0:  # known exactly, or held
            slopes.append(np.zeros_like(function(fit.model)))
            continue
        below, above = (function(_with(fit.model, names, each)) for each in ends)
        slopes.append((above - below) / width)
    J = np.stack(slopes, axis=-1)
    return np.asarray(np.sqrt(np.maximum(np.einsum("...i,ij,...j->...", J, C, J), 0.0)))


def _covariance(fit: AnyFit) -> tuple[tuple[str, ...], Array]:
    """Free parameters and their covariance.

    A `DataWarning` names those that have none because nothing determines them.
    """
    if fit.covariance is None:
        raise ValueError(
            f"a fit by {fit.method} has no covariance: take that of output_error or derivid"
        )
    held = np.array([fit[name].active for name in fit.free_names], dtype=bool)
    unknown = ~np.isfinite(np.diag(fit.covariance)) & ~held
    if unknown.any():
        warn(
            f"the data do not determine {', '.join(np.array(fit.free_names)[unknown])}, which "
            "count as known here: quantities that depend on them lack that part of their error; "
            "fix some"
        )
    return fit.free_names, np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)


def _with(model: M, names: Sequence[str], values: Array) -> M:
    return replace(model, **dict(zip(names, values.tolist(), strict=True)))
