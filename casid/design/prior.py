"""What is known before the flight: structure, information, noise, and other possible values."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
import scipy

from casid.arrays import Array
from casid.checks import check_known
from casid.design.criterion import covariance
from casid.design.specification import DesignSettings
from casid.errors import warn
from casid.estimates import ACTIVE
from casid.evaluation import MatrixFunction
from casid.fit import AnyFit
from casid.free import Free
from casid.model import Model
from casid.nonlinear.conditions import Trim, check_named
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import OUT_OF_BALANCE, imbalance

# Relative errors of a guess and of a fit, beside its covariance: what its structure lacks is in no
# covariance (derivatives of `SixDof` fitted to the AH-1S are off its linearisation by some 20 %).
GUESSED = FITTED = 0.2
NOISELESS = 1e-6  # errors over parameters' sizes that no measured record states


def linear_at(model: Model, trim: Trim | Mapping[str, float] | None) -> Model:
    """The structure itself, or a nonlinear one's linearisation at the trim or its reference."""
    if isinstance(model, NonlinearModel):
        return model.at(condition(model, trim))
    if trim is not None:
        raise ValueError(f"{type(model).__name__} is linear, about its own trim: leave trim out")
    return model


def check_balance(model: Model, trim: Trim | Mapping[str, float] | None) -> None:
    """Refuse a condition at which a nonlinear structure is not in balance.

    A trim with unknowns is not looked at: its own constraints balance it.
    """
    if not isinstance(model, NonlinearModel) or (own := condition(model, trim)).unknown:
        return
    values = [own.values[name] for name in (*model.states, *model.inputs)]
    x, u = np.split(np.array(values), [len(model.states)])
    state, rate = imbalance(model, x, u)
    if not abs(rate) <= OUT_OF_BALANCE:
        raise ValueError(
            f"{type(model).__name__} is not in balance at "
            f"{'its reference condition' if trim is None else 'the trim given'}, where d/dt "
            f"{state} = {rate:.3g}: name the condition that is flown, trim=find_trim(model, "
            "{...}, unknown=(...))"
        )


def check_trim(model: Model, names: Collection[str]) -> None:
    """Refuse values of a flight condition that a structure does not have: ValueError."""
    if names and not isinstance(model, NonlinearModel):
        raise ValueError(f"{type(model).__name__} is linear, about its own trim: leave trim out")
    check_known("trim: no state or input is called", names, (*model.states, *model.inputs))


def condition(model: NonlinearModel, trim: Trim | Mapping[str, float] | None) -> Trim:
    """The trim with a value of every state and input; the reference's where it names none."""
    x, u = model.operating_point()
    usual = dict(zip((*model.states, *model.inputs), (*x, *u), strict=True))
    given = trim if isinstance(trim, Trim) else Trim(values=trim or {})
    check_named(model, given.values)
    values = usual | dict(given.values)
    if lost := [name for name, value in values.items() if not np.isfinite(value)]:
        raise ValueError(f"the trim has {lost[0]} = {values[lost[0]]}; expected a finite number")
    return replace(given, values=values)


def as_fitted(settings: DesignSettings, fit: AnyFit | None) -> DesignSettings:
    """Settings with what a fit held fixed and the bounds that it had, where they say nothing."""
    rows = fit.parameters if fit else ()
    free = {row.name: (row.lower, row.upper) for row in rows if not row.fixed}
    fixed = settings.fixed
    if fixed is None:
        fixed = tuple(row.name for row in rows if row.fixed)
    return replace(settings, fixed=fixed, bounds={**free, **settings.bounds})


def inside(free: Free) -> Free:
    """Free parameters as they are; refused if one is outside its bounds, which would move it."""
    values = free.model.vector()
    off = np.maximum(free.lower - values, values - free.upper)[free.index]
    worst = int(np.argmax(off / free.scale[free.index]))
    if off[worst] > ACTIVE * free.scale[k := free.index[worst]]:
        raise ValueError(
            f"{free.names[worst]} = {values[k]:g} is outside its bounds, {free.lower[k]:g} to "
            f"{free.upper[k]:g}: give a value between them, or bounds that it is in, "
            f"DesignSettings(bounds={{{free.names[worst]!r}: (lowest, highest)}})"
        )
    return free


def without_effect(free: Free) -> tuple[str, ...]:
    """Free parameters on which no matrix and no delay depends."""
    at = MatrixFunction(free)(free.guess)
    felt = np.abs(at.slopes).max(axis=(1, 2)) + np.abs(at.dtau).max(axis=1)
    return tuple(name for name, size in zip(free.names, felt, strict=True) if size == 0)


def noise_of(
    model: Model,
    fit: AnyFit | None,
    noise: Mapping[str, float] | None,
    band: tuple[float, float] | None = None,
) -> Array:
    """R (ny, ny) a sample: what is given, else that of a fit's residuals.

    Of a fit in the frequency domain it is the largest that their spectrum is in the band.
    ValueError for a filter error.
    """
    if noise is None:
        if fit is None or fit.R is None:
            raise ValueError(
                "the noise of the outputs is not known: give noise={output: standard deviation}"
            )
        if not tells_noise(fit):
            raise ValueError(
                "the noise of a filter-error fit is that of its predictions one sample ahead, "
                "and does not show what turbulence does to the outputs; design from a fit by "
                "output error (process_noise=False), whose residuals include it, or give "
                "noise={output: standard deviation}, turbulence included"
            )
        return np.diag(_largest(fit, band))
    check_known("noise names", noise, model.outputs)
    for name in model.outputs:
        if not 0 < noise.get(name, 0.0) < np.inf:
            told = f"has {noise[name]:g}" if name in noise else "has none"
            raise ValueError(f"noise: output {name!r} {told}; give its standard deviation, > 0")
    return np.diag([noise[name] ** 2 for name in model.outputs])


def tells_noise(fit: AnyFit) -> bool:
    """Whether residuals hold all that is not the inputs' doing; a filter's lack turbulence."""
    return getattr(fit.notes, "K", None) is None


def _largest(fit: AnyFit, band: tuple[float, float] | None) -> Array:
    """Variances (ny,) of residuals, of their spectra the largest in a band."""
    variance = np.diag(np.asarray(fit.R)).copy()
    low, high = band or (0.0, np.inf)
    for each in getattr(fit.notes, "spectra", ()):
        inside = (each.omega >= low) & (each.omega <= high)
        power = np.nan_to_num(each.power[inside])
        variance = np.maximum(variance, power.max(axis=0, initial=0.0))
    return np.asarray(variance)


def colour_of(fit: AnyFit | None, noise: Mapping[str, float] | None) -> float:
    """How much larger errors are than residuals would make them if these were white."""
    rows = fit.parameters if fit and noise is None else ()
    pairs = [(row.std_error, row.cramer_rao) for row in rows]
    ratios = [a / b for a, b in pairs if np.isfinite(a) and np.isfinite(b) and b > 0]
    return float(np.median(ratios or [1.0]))


def known_before(free: Free, fit: AnyFit | None) -> Array:
    """Information (nf, nf) from before; a fit without noise is told, and tells nothing."""
    F = np.zeros((len(free.index), len(free.index)))
    if fit is None or fit.covariance is None:
        return F
    mine = [free.names.index(name) for name in fit.free_names if name in free.names]
    theirs = [k for k, name in enumerate(fit.free_names) if name in free.names]
    C = fit.covariance[np.ix_(theirs, theirs)]
    good = np.isfinite(np.diag(C)) & (np.diag(C) > 0)
    rows = np.array(mine)[good]
    shares = np.sqrt(np.diag(C)[good]) / free.scale[free.index][rows]
    if good.any() and (usual := float(np.median(shares))) < NOISELESS:
        warn(
            f"the fit states errors of {usual:.1g} of its parameters' sizes, as of records "
            "without noise: they do not count as prior knowledge; its residuals are not those of "
            "a flight either, so give noise, or fit records that have noise"
        )
        return F
    F[np.ix_(rows, rows)] = covariance(C[np.ix_(good, good)])
    return F


def possible(free: Free, known: Array, spread: float, count: int, seed: int) -> list[Free]:
    """The structure at ``count`` other values, drawn from what is known before.

    λ = λ₀ exp(s ξ) + η, with s the relative spread, ξ normal, so that values are
    lognormal and keep their signs, the models together a Latin hypercube (M. D. McKay and others,
    Technometrics 21, 1979), and η of the covariance of what is known, of which a standard deviation
    counts up to the parameter's own size. λ is kept within its bounds.
    """
    rng = np.random.default_rng(seed)
    n, rows = len(free.index), np.flatnonzero(np.diag(known) > 0)
    C = covariance(known[np.ix_(rows, rows)])
    size = np.maximum(np.abs(free.guess), free.scale[free.index])[rows]
    share = np.minimum(1.0, size / np.sqrt(np.diag(C)))
    sizes, axes = np.linalg.eigh(C * np.outer(share, share))
    root = axes * np.sqrt(np.maximum(sizes, 0.0))
    order = rng.permuted(np.tile(np.arange(count), (n, 1)), axis=1).T
    scatter = scipy.special.ndtri((order + rng.random((count, n))) / max(count, 1))
    made = []
    for off in scatter:
        values = free.guess * np.exp(spread * off)
        values[rows] += root @ rng.standard_normal(len(rows))
        values = np.clip(values, free.lower[free.index], free.upper[free.index])
        made.append(replace(free, model=free.model.with_vector(free.full(values))))
    return made
