"""Trims of a nonlinear structure at its parameter values."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from casid.arrays import Array
from casid.checks import check_known
from casid.display import listed
from casid.errors import ModelError, warn
from casid.nonlinear.balance import (
    APART,
    DETERMINED,
    balance_function,
    move_sizes,
    scattered,
)
from casid.nonlinear.conditions import BALANCE, Trim
from casid.nonlinear.coverage import warn_beyond
from casid.nonlinear.expressions import resting
from casid.nonlinear.model import NonlinearModel

ASTRAY = 0.1  # of travel, rad or the airspeed, from balance: neither sensors nor parameters err so
OUT_OF_BALANCE = 1e-2  # largest |dx/dt| of a reference condition that still counts as a trim


def imbalance(model: NonlinearModel, x: Array, u: Array) -> tuple[str, float]:
    """The state whose dx/dt is furthest from zero at (x, u), and how far; of those that rest."""
    rate = np.ravel(model.equations()(x, u, model.vector())[0].full())
    rate = np.where(resting(model.equations()), rate, 0.0)
    worst = int(np.argmax(np.where(np.isnan(rate), np.inf, np.abs(rate))))
    return model.states[worst], float(rate[worst])


def warn_unbalanced(model: NonlinearModel, rests: str) -> None:
    """A `DataWarning` where the reference condition, on which something rests, is no trim."""
    state, rate = imbalance(model, *model.operating_point())
    if not abs(rate) <= OUT_OF_BALANCE:
        warn(
            f"{type(model).__name__} is not in balance at its reference condition, where d/dt "
            f"{state} = {rate:.3g}, and {rests}: name a trim in its method reference, as find_trim "
            "finds it, or linearise at one by model.at(trim)"
        )


def warn_astray(model: NonlinearModel, conditions: Sequence[Trim]) -> None:
    """A `DataWarning` of conditions far from any balance of the structure.

    To first order, and by the move of states and inputs that is least in their own sizes.
    """
    said = list(filter(None, (_astray(model, each) for each in conditions)))
    if said:
        warn(
            f"{type(model).__name__} as estimated is far from balance at {listed(said, 3)}: "
            "check these values and to which condition each target belongs, or call unknown what "
            "was not measured"
        )


def _astray(model: NonlinearModel, condition: Trim) -> str:
    """How far a condition is from balance, empty if it is near."""
    names = (*model.states, *model.inputs)
    usual = zip(names, map(float, np.concatenate(model.operating_point())), strict=True)
    at = {name: condition.values.get(name, value) for name, value in usual}
    z, function = np.array(list(at.values())), balance_function(model)[0]
    rows, size = resting(model.equations()), move_sizes(model, at)
    f, J = (part.full()[rows] for part in function(z, model.vector()))
    shares = np.linalg.lstsq(J * size, -f.ravel())[0]
    worst = int(np.argmax(np.abs(shares)))
    if not abs(shares[worst]) > ASTRAY:
        return ""
    state, rate = imbalance(model, *np.split(z, [len(model.states)]))
    return (
        f"{condition.name or 'a trim'} (d/dt {state} = {rate:.3g}, as if {names[worst]} were "
        f"{(shares * size)[worst]:+.2g} from its {at[names[worst]]:.4g})"
    )


def find_trim(
    model: NonlinearModel, known: Mapping[str, float], unknown: Sequence[str], *, name: str = ""
) -> Trim:
    """States and inputs at which dx/dt = 0, but for states that no equation depends on.

    Those, positions and headings, go on changing as the others say.

    Parameters
    ----------
    model : NonlinearModel
        At its parameter values.
    known : mapping
        Total values that are held, and starts of the unknown ones; the reference where not named.
    unknown : sequence of str
        States and inputs to find.
    name : str
        Of the condition.

    Returns
    -------
    Trim
        Its values are those of the model's parameters and held, as measured ones are, wherever it
        is linearised later. A `DataWarning` tells of others nearby, and of a trim beyond the
        structure's tables.

    Raises
    ------
    ModelError
        A name that is no state or input, no balance within reach: the message names the equation.
    """
    names = (*model.states, *model.inputs)
    said = f"find_trim: {type(model).__name__} has no state or input"
    check_known(said, (*known, *unknown), names, ModelError)
    if not unknown:
        raise ModelError("find_trim: nothing is unknown; name the states and inputs to find")
    unknown = tuple(dict.fromkeys(unknown))
    start = dict(zip(names, map(float, np.concatenate(model.operating_point())), strict=True))
    start |= {each: float(value) for each, value in known.items()}
    found = _solutions(model, start, tuple(unknown))
    values = start | dict(zip(unknown, found[0], strict=True))
    at, free = np.array(list(values.values())), np.isin(names, unknown)
    slopes = balance_function(model)[0](at, model.vector())[1].full()
    slopes = slopes[np.ix_(resting(model.equations()), free)]
    size = np.maximum(np.abs(at[free]), 1.0)
    if (rank := np.linalg.matrix_rank(slopes * size, rtol=DETERMINED)) < len(unknown):
        warn(
            f"trim {name!r} of {type(model).__name__} is one of many: its equations determine "
            f"{rank} of {', '.join(unknown)}, not {len(unknown)}; hold one of them as it was flown"
        )
    elif len(found) > 1:
        others = ["; ".join(f"{n} = {v:.4g}" for n, v in zip(unknown, z, strict=True))
                  for z in found[1:]]  # fmt: skip
        warn(
            f"trim {name!r} of {type(model).__name__} is not the only one: also "
            f"{' and '.join(others)}; start nearer to the one that is flown"
        )
    trim = Trim(values=values, name=name)
    warn_beyond(model, f"in trim {name!r}" if name else "in trim", model.reached_at(trim))
    return trim


def _solutions(
    model: NonlinearModel, start: Mapping[str, float], unknown: tuple[str, ...]
) -> list[Array]:
    """Different values of the unknowns that balance the equations, that nearest to the start first.

    ModelError: none.
    """
    rows, values = resting(model.equations()), np.array(list(start.values()))
    places = [list(start).index(name) for name in unknown]
    both, lam = balance_function(model)[0], model.vector()
    size = np.maximum(np.abs(values[places]), 1.0)
    least = np.full(rows.sum(), np.inf)
    found: list[Array] = []

    def at(unknown: Array) -> Array:
        z = values.copy()
        z[places] = unknown
        return z

    def balance(unknown: Array) -> Array:
        return np.asarray(both(at(unknown), lam)[0].full()[rows].ravel())

    def slope(unknown: Array) -> Array:
        return np.asarray(both(at(unknown), lam)[1].full()[rows][:, places])

    moves = size * scattered(len(places))
    starts = list(values[places] + moves)
    for first in starts:  # to which those beside the first that is found are added
        if not np.isfinite(balance(first)).all():
            continue
        end = scipy.optimize.least_squares(
            balance, first, slope,
            x_scale=size, xtol=1e-14, ftol=1e-14, gtol=1e-14,
        )  # fmt: skip
        least = end.fun if np.abs(end.fun).max() < np.abs(least).max() else least
        new = all(np.abs((end.x - each) / size).max() > APART for each in found)
        if np.abs(end.fun).max() < BALANCE and new:
            found.append(np.asarray(end.x))
            starts += list(end.x + moves[1:]) if len(found) == 1 else []
    if not found:
        raise ModelError(_nowhere(model, start, unknown, least))
    return found


def _nowhere(
    model: NonlinearModel, start: Mapping[str, float], unknown: Sequence[str], least: Array
) -> str:
    """Why there is no trim: what stays out of balance of what rests, or has no value at all."""
    if not np.isfinite(least).any():
        at = ", ".join(f"{name} = {value:.4g}" for name, value in start.items())
        return (
            f"{type(model).__name__} has no finite d/dt at {at}, nor nearby; start the unknown "
            "ones, or hold the others, where its equations have a value"
        )
    worst = int(np.argmax(np.abs(least)))
    state = list(itertools.compress(model.states, resting(model.equations())))[worst]
    return (
        f"{type(model).__name__} has no trim here: with {', '.join(unknown)} unknown "
        f"d{state}/dt stays at {least[worst]:.3g}; make another state or input "
        "unknown, or change what is held"
    )
