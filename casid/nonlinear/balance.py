"""Flight conditions completed: what a trim does not name as the balance of the equations has it."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.channels import UNITS
from casid.display import listed
from casid.model import Model
from casid.nonlinear.conditions import BALANCE, Trim
from casid.nonlinear.coverage import airspeeds
from casid.nonlinear.expressions import resting
from casid.nonlinear.model import NonlinearModel

EXACT = 1e4  # weight of dx/dt = 0 against what is named staying as it is
LOOSE = 1e5  # how much further what is not named moves from the reference at the same price
DETERMINED = 1e-9  # least singular value of the balance's slopes, relative to the largest
FAR = 0.03  # of travel, rad, or of the airspeed: trims are measured better
STARTS = 12  # from which other balances are looked for
SPREAD = 0.3  # of those starts, relative to an unknown's size, at least absolute
APART = 1e-3  # of two balances that differ, in the same units
REACH = 1.0  # of two that may be confused, in the same units
TOLD = 0.5  # distance from the start to one balance, over that to another, which tells which


@dataclass(frozen=True)
class Balance:
    """A flight condition in balance.

    ``found`` has the values that ``trim`` did not name before, ``moved`` by how much those that it
    did name differ now. ``doubt``, empty without any, says why it is no trim all the same.
    """

    trim: Trim
    found: Mapping[str, float] = field(default_factory=dict)
    moved: Mapping[str, float] = field(default_factory=dict)
    doubt: str = ""


_End: TypeAlias = tuple[Array, Array, Array]  # states and inputs z, dx/dt there, its slopes by z


@dataclass(frozen=True, eq=False)
class _Search:
    """The balances near a point z of states and inputs: which of it may move, at what price."""

    model: NonlinearModel
    z0: Array
    sought: BoolArray  # not named: it moves at next to no price
    free: BoolArray  # that and what gives way
    known: BoolArray  # of what is sought, what was flown, if anything: it tells balances apart
    size: Array  # what a move counts by

    @cached_property
    def balance(self) -> tuple[ca.Function, BoolArray]:
        """dx/dt and its slopes, and the states whose rows have to rest."""
        return balance_function(self.model)[0], resting(self.model.equations())

    @cached_property
    def price(self) -> Array:
        """Of the moves of what is free, a diagonal matrix."""
        return np.diag(1 / np.where(self.sought, LOOSE * self.size, self.size)[self.free])

    def at(self, move: Array) -> _End:
        """Where a move of what is free leads."""
        z, (function, rows) = self.z0.copy(), self.balance
        z[self.free] += move
        f, J = (part.full()[rows] for part in function(z, self.model.vector()))
        return z, f.ravel(), J

    def _residuals(self, move: Array) -> Array:
        return np.concatenate([EXACT * self.at(move)[1], self.price @ move])

    def _slopes(self, move: Array) -> Array:
        return np.vstack([EXACT * self.at(move)[2][:, self.free], self.price])

    def ends(self, moves: Sequence[Array]) -> list[_End]:
        """Where the search from each move ends that has a dx/dt; balances first, by distance."""
        finite = [each for each in moves if np.isfinite(self._residuals(each)).all()]
        how: Any = {"x_scale": self.size[self.free]}
        how |= dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
        search = scipy.optimize.least_squares
        found = [search(self._residuals, each, self._slopes, **how) for each in finite]
        ends = [self.at(end.x) for end in found]
        rest = [each for each in ends if self.rests(each)]
        return sorted(rest, key=lambda end: self.apart(end[0], self.z0, self.known)) or ends

    def strained(self, z: Array) -> BoolArray:
        """What is named and moved far."""
        return np.asarray(~self.sought & (np.abs(z - self.z0) > FAR * self.size))

    def rests(self, end: _End) -> bool:
        """Whether an end is in balance with what is named nearly as it was."""
        return bool(np.abs(end[1]).max() < BALANCE) and not self.strained(end[0]).any()

    def rank(self, end: _End) -> int:
        """How many of what is not named the equations determine."""
        slopes = end[2][:, self.sought] * self.size[self.sought]
        return int(np.linalg.matrix_rank(slopes, rtol=DETERMINED))

    def apart(self, z: Array, other: Array, among: BoolArray) -> float:
        """The largest distance of two points among some of their values, in sizes."""
        return float((np.abs(z - other) / self.size)[among].max(initial=0.0))

    def doubts(self, ends: Sequence[_End]) -> list[str]:
        """What speaks against the first of these ends, which are all `ends`."""
        names, (z, f, _) = (*self.model.states, *self.model.inputs), ends[0]
        said = [
            f"{names[k]} moves by {z[k] - self.z0[k]:+.2g} from the {self.z0[k]:.4g} given"
            for k in np.flatnonzero(self.strained(z))
        ]
        resting = itertools.compress(self.model.states, self.balance[1])
        said = _uneven(dict(zip(resting, f, strict=True))) or said
        if (rank := self.rank(ends[0])) < (count := self.sought.sum()):
            return [*said, f"its equations determine {rank} of these {count} only"]
        near = [end[0] for end in ends if APART < self.apart(end[0], z, self.sought) < REACH]
        if said or not near:
            return said
        off, far = (self.apart(each, self.z0, self.known) for each in (z, near[0]))
        if max(off, APART) <= TOLD * far:
            return []
        differ = np.flatnonzero(self.sought & (np.abs(near[0] - z) > APART * self.size))
        return [
            f"it also balances with {', '.join(f'{names[k]} = {near[0][k]:.4g}' for k in differ)}"
        ]


def balanced(
    model: NonlinearModel,
    trim: Trim,
    *,
    held: Collection[str] | None = None,
    flown: Array | None = None,
) -> Balance:
    """The condition with dx/dt = 0 that is nearest to a trim, whatever that names.

    What it names was measured, or lies between what was, so that on it alone no balance need exist:
    all that is not ``held``, airspeeds unless given, gives way, by the least sum of squares, angles
    in rad, sticks in travel, values above one by shares, velocities relative to the airspeed. What
    it does not name, or calls unknown, is free, and has the balance nearest to where it starts:
    states as a record of the fit began, of ``flown`` (records, nx) the one nearest to what is
    named; else the reference. States that no equation depends on, positions and headings, need not
    rest. Doubts are of equations that stay out of balance, of what is named and moved far, of more
    unknowns than the equations determine, and of several balances none of which is clearly nearest.
    """
    names, point = (*model.states, *model.inputs), np.concatenate(model.operating_point())
    usual = {n: trim.values.get(n, float(value)) for n, value in zip(names, point, strict=True)}
    size, acts = move_sizes(model, usual), balance_function(model)[1]
    began = _began(model, trim, flown, size)
    z0 = np.array(list((usual | began).values()))
    sought = acts & [name not in trim.values or name in trim.unknown for name in names]
    held = airspeeds(model, names) if held is None else held
    free = sought | acts & [name not in held for name in names]
    known = sought & np.isin(names, list(began)) if began else sought
    search = _Search(model, z0, sought, free, known, size)
    usually = (np.array(list(usual.values())) - z0)[free]
    if search.rests(end := search.at(usually)) and search.rank(end) < max(sought.sum(), 1):
        own = trim.moves or moving(model, end[0], search.balance[1], free, search.price)
        return Balance(replace(trim, moves=own))  # as good as any
    around = sought[free] * size[free] * scattered(free.sum())
    if not (ends := search.ends([*around, usually] if sought.any() else [usually])):
        return Balance(trim, doubt=_told(trim, {}, ["dx/dt is not finite"]))
    z = ends[0][0]
    values = dict(zip(itertools.compress(names, free), map(float, z[free]), strict=True))
    found = {name: values[name] for name in itertools.compress(names, sought)}
    moved = {n: value - trim.values[n] for n, value in values.items() if n not in found}
    whole = replace(trim, values=dict(trim.values) | values, unknown=())
    whole = replace(whole, moves=moving(model, z, search.balance[1], free, search.price))
    return Balance(whole, found, moved, _told(trim, found, search.doubts(ends)))


def scattered(count: int) -> Array:
    """No move, and those to look for other balances from, (1 + STARTS, count), in sizes."""
    moves = SPREAD * np.random.default_rng(0).uniform(-1, 1, (1 + STARTS, count))
    moves[0] = 0.0
    return np.asarray(moves)


def unbalanced(model: Model, doubts: Sequence[str]) -> str:
    """What a warning says of the doubts of `balanced`."""
    return (
        f"{type(model).__name__} is linearised where its balance is in doubt, "
        f"{listed(doubts, 3)}: give more values in the trim of the records, or fly speeds between"
    )


def balance_function(model: NonlinearModel) -> tuple[ca.Function, BoolArray]:
    """dx/dt and its slopes by states and inputs z at (z, λ), and which of them act."""
    z, lam, f, J = _expressions(model)
    return ca.Function("balance", [z, lam], [f, J]), ca.DM(J.sparsity(), 1).full().any(axis=0)


def moving(
    model: NonlinearModel, at: Array, rows: BoolArray, free: BoolArray, price: Array
) -> dict[str, dict[str, tuple[float, float]]]:
    """How a balance z moves with the parameters, as `Trim.moves` has it.

    By differentiation of what makes it one: ∂/∂z (|P m|² / 2 + μᵀ f) = 0, f = μ / EXACT².
    """
    z, lam, f, _ = _expressions(model)
    f, own = f[np.flatnonzero(rows).tolist()], z[np.flatnonzero(free).tolist()]
    mu, values = ca.SX.sym("mu", f.numel()), model.vector()
    pull, J = ca.jacobian(ca.dot(mu, f), own).T, ca.jacobian(f, own)
    parts = [ca.jacobian(pull, own), J, ca.jacobian(pull, lam), ca.jacobian(f, lam)]
    multipliers = EXACT**2 * ca.Function("f", [z, lam], [f])(at, values)
    function = ca.Function("parts", [z, lam, mu], parts)
    H, J, by_lam, f_lam = (part.full() for part in function(at, values, multipliers))
    system = np.block([[price**2 + H, J.T], [J, -np.eye(len(J)) / EXACT**2]])
    slopes = -np.linalg.lstsq(system, np.vstack([by_lam, f_lam]))[0][: free.sum()]
    names = itertools.compress((*model.states, *model.inputs), free)
    return {
        name: {
            parameter: (slope, value)
            for parameter, slope, value in zip(model.parameter_names(), row, values, strict=True)
            if slope
        }
        for name, row in zip(names, slopes.tolist(), strict=True)
        if any(row)
    }


def _expressions(model: NonlinearModel) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Symbols z of states and inputs, and λ, with dx/dt and its slopes by z."""
    z = ca.SX.sym("z", len(model.states) + len(model.inputs))
    lam = ca.SX.sym("lam", len(model.parameter_names()))
    f = model.equations()(*ca.vertsplit(z, [0, len(model.states), z.numel()]), lam)[0]
    return z, lam, f, ca.jacobian(f, z)


def _began(model: NonlinearModel, trim: Trim, flown: Array | None, size: Array) -> dict[str, float]:
    """States that a trim does not name as the record began that is nearest to those it does."""
    if flown is None or not len(flown):
        return {}
    named = [name in trim.values and name not in trim.unknown for name in model.states]
    values = np.array([trim.values.get(name, 0.0) for name in model.states])
    away = np.square((flown - values) / size[: len(values)])[:, named].sum(axis=1)
    began = zip(model.states, flown[np.argmin(away)].tolist(), strict=True)
    return {name: value for name, value in began if name not in trim.values}


def move_sizes(model: NonlinearModel, start: Mapping[str, float]) -> Array:
    """What a move of each state and input counts by: the airspeed for velocities, at least 1."""
    units = UNITS | dict(model.units)
    speed = max([1.0, *(abs(start[name]) for name in airspeeds(model, start))])
    own = {n: speed if units.get(n) == "m/s" else max(abs(v), 1.0) for n, v in start.items()}
    return np.array(list(own.values()))


def _uneven(rates: Mapping[str, float]) -> list[str]:
    """The rate furthest from zero, if it is not that within rounding."""
    worst = max(rates, key=lambda name: abs(rates[name]))
    rests = abs(rates[worst]) < BALANCE
    return [] if rests else [f"d/dt {worst} = {rates[worst]:.3g} instead of 0"]


def _told(trim: Trim, found: Mapping[str, float], doubts: Sequence[str]) -> str:
    """Doubts of a condition in one sentence, empty without any."""
    among = " with " * bool(found) + ", ".join(f"{name} = {v:.4g}" for name, v in found.items())
    return f"at {trim.name or 'a trim'}{among}: {' and '.join(doubts)}" if doubts else ""
