"""Derivatives and modes of a nonlinear structure over its flight conditions, with local fits.

At each condition the structure is linearised; the covariance of an entry of A or B is J C Jᵀ, J its
exact derivatives by the parameters, C the covariance that `Fit.std_error` is read from. That has
no error of a parameter on its bound, nor has any entry that depends on one. States and inputs that
a condition does not name balance the equations, and move with the parameters in J, as what it
names does as far as it gives way.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array, BoolArray, ComplexArray
from casid.display import Shown, counted, listed
from casid.errors import ModelError, warn
from casid.evaluation import MatrixFunction
from casid.fit import AnyFit, Fit
from casid.free import free_parameters
from casid.nonlinear.balance import Balance, balanced, unbalanced
from casid.nonlinear.conditions import Trim, check_named, linearisation
from casid.nonlinear.coverage import airspeeds, leaves, tabulated
from casid.nonlinear.model import NonlinearModel
from casid.record import Record

APART = 0.01  # chance that one entry or more of true local fits is told to lie off the one model
NOTHING = 1e-9  # share of an entry's largest dependence on a parameter that is rounding


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Envelope(Shown):
    """Entries of A and B, and poles, over speed.

    Parameters
    ----------
    speed : (n,) array
        Of the conditions [m/s], increasing.
    names : tuple of str
        Of the entries: "q' by w" is the derivative of dq/dt by w.
    values, std_error : (n, m) array
        The entries and their standard errors, SI units; NaN where an entry depends on a parameter
        on its bound, whose error nobody knows.
    poles : (n, nx) complex array
        Each column follows one pole from condition to condition [1/s].
    beyond : (n,) array of bool
        Conditions outside what the fit's records flew, or, where it does not say, its tables: there
        the structure is extrapolated, and standard errors say nothing of that.
    local : Envelope or None
        The same of fits made at one condition each, to compare with.
    balanced : tuple of str
        States and inputs that the conditions do not name: found so that dx/dt = 0, of several
        balances the one nearest to what the fit's records began in.
    moved : mapping
        By how much at most those that they name moved for it.
    doubts : tuple of str
        Conditions, of local fits too, that do not balance, do with what they name far away, leave
        some of it open, or have several balances none of which is clearly nearest.
    apart : tuple of str
        Entries of local fits that lie off the one model at their conditions by more than the errors
        of both allow, at one per cent for all together; the farthest first.
    """

    speed: Array
    names: tuple[str, ...]
    values: Array
    std_error: Array
    poles: ComplexArray
    beyond: BoolArray
    local: "Envelope | None" = None
    balanced: tuple[str, ...] = ()
    moved: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    apart: tuple[str, ...] = ()

    def headline(self) -> str:
        """Conditions and entries."""
        beside = "" if self.local is None else f", {len(self.local.speed)} local fits beside them"
        if self.apart:
            beside += f" ({len(self.apart)} of their entries off it)"
        outside = f", {self.beyond.sum()} outside what was flown" if self.beyond.any() else ""
        return (
            f"{listed(self.names, 10)} at {counted(len(self.speed), 'condition')} from "
            f"{self.speed[0]:.3g} to {self.speed[-1]:.3g} m/s{outside}{beside}"
        )


def envelope(
    fit: AnyFit,
    trims: Sequence[Trim],
    entries: Sequence[tuple[str, str]],
    *,
    local: Mapping[Trim, AnyFit] | None = None,
) -> Envelope:
    """Derivatives and poles of a fit over flight conditions.

    Parameters
    ----------
    fit : Fit
        Of a `NonlinearModel`.
    trims : sequence of Trim
        Where it is linearised; placed at their ``speed``, or at their value of "u" or "V", of an
        input only if the structure's ``units`` give it in m/s. States and inputs that they do not
        name, or call unknown, are balanced, states from what the fit's records began in on, else
        from the reference.
    entries : sequence of pairs
        State and what its derivative is taken by, state or input: ``("q", "w")`` for M_w.
    local : mapping of Trim to Fit
        Fits made at one condition each, of the same states and inputs, to compare with.

    Returns
    -------
    Envelope
        A `DataWarning` names the conditions outside what the fit's records flew, another those at
        which what a trim does not name is not determined by balance.

    Raises
    ------
    ValueError, ModelError
        A linear structure, no condition or entry, one without a speed, a name that is none.
    """
    if not isinstance(fit.model, NonlinearModel):
        raise ModelError(
            f"{type(fit.model).__name__} is linear, the same at every speed; give it in local"
        )
    if not trims or not entries:
        raise ValueError("envelope: give at least one trim and one entry, like ('q', 'w')")
    for trim in trims:
        check_named(fit.model, trim.values)
        if wrong := [name for name, value in trim.values.items() if not np.isfinite(value)]:
            raise ValueError(
                f"trim {trim.name!r}: {wrong[0]} is {trim.values[wrong[0]]}, expected a number"
            )
    own = None if not local else _gathered(list(local.items()), entries)
    made = _gathered([(trim, fit) for trim in trims], entries, own)
    if local and own is not None and all(airspeeds(fit.model, trim.values) for trim in local):
        whole = _gathered([(trim, fit) for trim in local], entries)
        made = replace(made, apart=_apart(whole, own))
    if made.beyond.any():
        flown = ", ".join(f"{n} {a:.4g} to {b:.4g}" for n, (a, b) in _covered(fit).items())
        warn(
            f"{type(fit.model).__name__} is extrapolated at "
            f"{', '.join(f'{speed:.4g}' for speed in made.speed[made.beyond])} m/s, outside what "
            f"the fit is from ({flown}); standard errors do not include that: stay inside, or "
            "fly there and fit again"
        )
    if made.doubts:
        warn(unbalanced(fit.model, made.doubts))
    return made


def flight_condition(model: NonlinearModel, record: Record) -> Trim:
    """Where a record was flown: its trim, what it measures before an input moves."""
    known = record.total().detrend("first").trim
    own = {name: known[name] for name in (*model.states, *model.inputs) if name in known}
    speed = next((own[name] for name in airspeeds(model, own)), np.nan)
    return Trim(name=f"{speed:.4g} m/s", values=own, speed=speed)


def balance_of(fit: Fit[Any, Any], trim: Trim) -> Balance:
    """The balance of a fit's structure at a trim, of several that in which its records began."""
    return balanced(fit.model, trim, flown=fit.initial_states)


def linear_fit(fit: Fit[Any, Any], trim: Trim) -> AnyFit:
    """A fit of a nonlinear structure as one of its linearisation in balance at a trim."""
    return replace(fit, model=fit.model.at(balance_of(fit, trim).trim))


def _gathered(
    fits: Sequence[tuple[Trim, AnyFit]],
    entries: Sequence[tuple[str, str]],
    local: Envelope | None = None,
) -> Envelope:
    """The envelope of fits, each at its condition."""
    along = sorted(fits, key=lambda each: _speed(*each))
    speed = np.array([_speed(*each) for each in along])
    rest = [
        balance_of(fit, trim) if isinstance(fit.model, NonlinearModel) else Balance(trim)
        for trim, fit in along
    ]
    along = [(each.trim, fit) for each, (_, fit) in zip(rest, along, strict=True)]
    values, errors, poles = zip(*(_read(*each, entries) for each in along), strict=True)
    moved = sorted((name, abs(move)) for each in rest for name, move in each.moved.items())
    return Envelope(
        speed=speed,
        names=tuple(f"{state}' by {channel}" for state, channel in entries),
        values=np.array(values),
        std_error=np.array(errors),
        poles=_followed(poles),
        beyond=np.array([_is_beyond(*each) for each in along]),
        local=local,
        balanced=tuple(dict.fromkeys(name for each in rest for name in each.found)),
        moved=dict(moved),
        doubts=(*filter(None, (each.doubt for each in rest)), *(local.doubts if local else ())),
    )


def _apart(whole: Envelope, local: Envelope) -> tuple[str, ...]:
    """What lies off, of local fits and of the one model at the same conditions.

    Records of the local fits are some of the one model's, so differences vary by less than the sum.
    """
    off = (local.values - whole.values) / np.hypot(local.std_error, whole.std_error)
    known = np.isfinite(off)
    most = -scipy.special.ndtri(APART / (2 * max(int(known.sum()), 1)))
    far = sorted(zip(*np.nonzero(known & (np.abs(off) > most)), strict=True))
    return tuple(
        f"{local.names[j]} at {local.speed[i]:.3g} m/s is {local.values[i, j]:.3g} ± "
        f"{local.std_error[i, j]:.2g} by itself, {whole.values[i, j]:.3g} ± "
        f"{whole.std_error[i, j]:.2g} by the one model"
        for i, j in sorted(far, key=lambda place: -abs(off[place]))
    )


def _covered(fit: AnyFit) -> dict[str, tuple[float, float]]:
    """Spans of airspeed and of the variables of tables: as flown, else those of the tables."""
    return tabulated(fit.model) | dict(getattr(fit.notes, "covered", {}))


def _is_beyond(trim: Trim, fit: AnyFit) -> bool:
    """Whether a condition is outside what a nonlinear structure's fit covers."""
    if not isinstance(fit.model, NonlinearModel):
        return False
    at = fit.model.reached_at(trim)
    for name, (low, high) in _covered(fit).items():
        if name in at and leaves(at[name], (low, high)):
            return True
    return False


def _speed(trim: Trim, fit: AnyFit) -> float:
    """Where a condition stands on the axis of speeds."""
    if np.isfinite(trim.speed):
        return trim.speed
    if not (named := airspeeds(fit.model, trim.values)):
        raise ValueError(f"trim {trim.name!r} has no speed; give it one: Trim(speed=...)")
    return trim.values[named[0]]


def _read(
    trim: Trim, fit: AnyFit, entries: Sequence[tuple[str, str]]
) -> tuple[Array, Array, ComplexArray]:
    """Entries (m,), their standard errors, and poles (nx,) of a fit at a condition."""
    nonlinear = isinstance(fit.model, NonlinearModel)
    model = linearisation(fit.model, [trim]) if nonlinear else fit.model
    columns = (*model.states, *model.inputs)
    for state, channel in entries:
        if state not in model.states or channel not in columns:
            raise ModelError(
                f"{type(model).__name__} has no derivative of {state!r} by {channel!r}; there are "
                f"states {', '.join(model.states)} and inputs {', '.join(model.inputs)}"
            )
    own = [name for name in fit.free_names if name in model.parameter_names()]
    held = [name for name in model.parameter_names() if name not in own]
    free = free_parameters(model, fixed=held)
    matrices = MatrixFunction(free)(model.vector()[free.index])
    rows = [model.states.index(state) for state, _ in entries]
    cols = [columns.index(channel) for _, channel in entries]
    J = matrices.slopes[:, rows, cols].T
    places = [list(fit.free_names).index(free.names[i]) for i in range(len(free.names))]
    C = np.full((len(fit.free_names),) * 2, np.nan) if fit.covariance is None else fit.covariance
    inside = C[np.ix_(places, places)]
    on_bound = np.array([fit[name].active for name in free.names], dtype=bool)
    stuck = on_bound & ~(np.diag(inside) > 0)
    inside = np.where(stuck[:, None] | stuck, 0.0, inside)
    moves = np.abs(J) * free.scale[free.index]
    unknown = (moves[:, stuck] > NOTHING * moves.max(axis=1, keepdims=True)).any(axis=1)
    variance = np.where(unknown, np.nan, np.einsum("ma,ab,mb->m", J, inside, J))
    poles = np.sort_complex(np.linalg.eigvals(matrices.blocks[0]))
    return matrices.N[rows, cols], np.sqrt(np.maximum(variance, 0.0)), poles


def _followed(poles: Sequence[ComplexArray]) -> ComplexArray:
    """Poles (n, nx) in such an order that each column moves least from row to row."""
    rows = [poles[0]]
    for each in poles[1:]:
        distance = np.abs(rows[-1][:, None] - each)
        rows.append(each[scipy.optimize.linear_sum_assignment(distance)[1]])
    return np.array(rows)
