"""The errors of a fit carried on: to first order, and by models drawn from them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.display import listed
from casid.embedding import StructureError
from casid.errors import warn
from casid.fit import AnyFit
from casid.model import M, Model
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import warn_unbalanced

STEP = 1e-3  # of a standard error
NEAR = 1e-3  # of the way from its start: what is on a bound and not held elsewhere


def sample_models(fit: "AnyFit", count: int, *, seed: int = 0) -> tuple[Model, ...]:
    """Models drawn from the normal distribution of a fit's errors, each within its bounds.

    Parameters on a bound do not move. Models of a nonlinear structure's fit are nonlinear: what
    takes linear ones, as `cover` does, sees each at its reference condition unless given
    ``model.at(trim)`` of each.

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
    drawn = rng.multivariate_normal(center, C, size=count, method="eigh")
    return tuple(_with(fit.model, names, each) for each in np.clip(drawn, low, high))


def spread(
    fit: AnyFit, function: Callable[[Model], Array], error: StructureError | None = None
) -> Array:
    """Standard deviation of each entry of a function of the model, to first order.

    The covariance of the parameters that ``error`` has is added. ValueError: a fit without one.
    """
    return first_order(fit, function, *known_errors(fit, error))


def known_errors(fit: AnyFit, error: StructureError | None) -> tuple[tuple[str, ...], Array]:
    """Free parameters and their covariance with that of ``error``; warns of what it is about."""
    names, C = _covariance(fit)
    if isinstance(fit.model, NonlinearModel):
        warn_unbalanced(fit.model, "these are bands of its linearisation there")
    if error is not None:
        held = np.array([fit[name].active for name in names], dtype=bool)
        C = C + np.where(held[:, None] | held, 0.0, error.of(fit).covariance)
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
    """Free parameters and their covariance; those on a bound do not move.

    A `DataWarning` names those that have none because nothing determines them, and those that the
    structure's own bounds hold.
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
            "count as known here: what depends on them lacks their part of its error; fix some"
        )
    if said := known_by_bounds(fit):
        warn(said)
    C = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
    C[held], C[:, held] = 0.0, 0.0
    return fit.free_names, C


def known_by_bounds(fit: AnyFit) -> str:
    """What to say of free parameters that bounds of the structure hold; empty without any.

    Bounds that were asked for of a fit are hypotheses, under which what they hold is known.
    """
    infos, held = type(fit.model).infos(), []
    for row in (fit[name] for name in fit.free_names if fit[name].active):
        side = "lower" if row.value - row.lower < row.upper - row.value else "upper"
        bound = getattr(row, side)
        away = max(abs(row.guess - bound), abs(bound))  # ties hold others, away from their bounds
        near = abs(row.value - bound) <= np.fmax(NEAR * away, row.insensitivity)
        if near and bound == getattr(infos[row.name], side):
            held.append(f"{row.name} = {row.value:.3g}")
    counts = "counts as known exactly" if len(held) == 1 else "count as known exactly"
    return (
        f"{listed(held)}, on a bound of the structure, {counts}: what depends on it lacks what the "
        "data allow within the bound; fits with it fixed there (fixed) and their costs tell"
    ) * bool(held)


def _with(model: M, names: Sequence[str], values: Array) -> M:
    return replace(model, **dict(zip(names, values.tolist(), strict=True)))
