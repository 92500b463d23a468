"""Flight conditions completed: what a trim does not name as the balance of the equations has it."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.channels import UNITS
from casid.display import listed
from casid.model import Model
from casid.nonlinear.conditions import BALANCE, Trim
from casid.nonlinear.coverage import SPEEDS
from casid.nonlinear.model import NonlinearModel

EXACT = 1e4  # weight of dx/dt = 0 against what is named staying as it is
LOOSE = 1e5  # how much further what is not named moves from the reference at the same price
DETERMINED = 1e-9  # least singular value of the balance's slopes, relative to the largest
FAR = 0.03  # of travel, rad, or of the airspeed: trims are measured better


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


def balanced(model: NonlinearModel, trim: Trim, *, held: Collection[str] = SPEEDS) -> Balance:
    """The condition with dx/dt = 0 that is nearest to a trim, whatever that names.

    What it names was measured, or lies between what was, so that on it alone no balance need exist:
    all that is not ``held`` gives way, by the least sum of squares, angles in rad, sticks in
    travel, values above one by shares, velocities relative to the airspeed. What it does not name,
    or calls unknown, is free, from the reference on. States that no equation depends on, positions
    and headings, need not rest. Doubts are of equations that stay out of balance, of what is named
    and moved far, and of more unknowns than the equations determine.
    """
    names = (*model.states, *model.inputs)
    usual = zip(names, map(float, np.concatenate(model.operating_point())), strict=True)
    start = {name: trim.values.get(name, value) for name, value in usual}
    z0, (balance, acts) = np.array(list(start.values())), balance_function(model)
    rows, states = acts[: len(model.states)], itertools.compress(model.states, acts)
    sought = acts & [name not in trim.values or name in trim.unknown for name in names]
    free = sought | acts & [name not in held for name in names]
    size = _sizes(model, start)
    price = np.diag(1 / np.where(sought, LOOSE * size, size)[free])

    def at(move: Array) -> tuple[Array, Array, Array]:
        z = z0.copy()
        z[free] += move
        f, J = (part.full()[rows] for part in balance(z, model.vector()))
        return z, f.ravel(), J

    def residuals(move: Array) -> Array:
        return np.concatenate([EXACT * at(move)[1], price @ move])

    def slopes(move: Array) -> Array:
        return np.vstack([EXACT * at(move)[2][:, free], price])

    still = np.zeros(free.sum())
    if not np.isfinite(residuals(still)).all():
        return Balance(trim, doubt=_told(trim, {}, ["dx/dt is not finite"]))
    if not free.any() or np.abs(at(still)[1]).max() < BALANCE:
        return Balance(replace(trim, moves=trim.moves or moving(model, z0, rows, free, price)))
    end = scipy.optimize.least_squares(
        residuals, still, slopes, x_scale=size[free], xtol=1e-12, ftol=1e-12, gtol=1e-12
    )
    z, f, J = at(end.x)
    values = dict(zip(itertools.compress(names, free), map(float, z[free]), strict=True))
    found = {name: values[name] for name in itertools.compress(names, sought)}
    moved = {name: value - start[name] for name, value in values.items() if name not in found}
    doubts = [
        f"{name} {moved[name]:+.2g} from the {start[name]:.4g} it names"
        for name in itertools.compress(names, ~sought & (np.abs(z - z0) > FAR * size))
    ]
    doubts = _uneven(dict(zip(states, f, strict=True))) or doubts
    if (rank := np.linalg.matrix_rank(J[:, sought] * size[sought], rtol=DETERMINED)) < len(found):
        doubts.append(f"its equations determine {rank} of these {len(found)} only")
    whole = replace(trim, values=dict(trim.values) | values, unknown=())
    whole = replace(whole, moves=moving(model, z, rows, free, price))
    return Balance(whole, found, moved, _told(trim, found, doubts))


def unbalanced(model: Model, doubts: Sequence[str]) -> str:
    """What a warning says of the doubts of `balanced`."""
    return (
        f"{type(model).__name__} is linearised where it is not known to be in balance, "
        f"{listed(doubts, 3)}: name more in the trim of the records, or fly speeds between"
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


def _sizes(model: NonlinearModel, start: Mapping[str, float]) -> Array:
    """What a move of each state and input counts by: the airspeed for velocities, at least 1."""
    units, speed = UNITS | dict(model.units), max(1.0, *(abs(start.get(n, 1.0)) for n in SPEEDS))
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
