"""Where equations jump: what decides between two expressions, and whether records pass it.

Where a right-hand side jumps as a state passes a threshold, a parameter moves the instant of it,
and the motion after it by the size of the jump times that. Derivatives of the equations on either
side do not have this part, nor has what is estimated and stated by them.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.code_dependencies import Surroundings, surroundings
from casid.display import counted
from casid.model import constants
from casid.nonlinear.expressions import COMPARED, Nonlinear, evaluated

SIDES = {ca.OP_SIGN: 0, ca.OP_COPYSIGN: 1, ca.OP_ATAN2: 0}  # the argument whose sign decides
LOOKED_AT = 20  # passages of a threshold, at most
HALVED = 45  # times an interval about it
BESIDE = 1e-9  # of the interval, off the threshold on either side
JUMP = 1e-6  # of what a right-hand side moves by over the records


@dataclass(frozen=True)
class Passage:
    """An equation that jumps in the records: which, at what, how often it is passed."""

    equation: str
    threshold: str
    times: int


def told(found: Sequence[Passage]) -> str:
    """What is said of jumps that records pass, with the remedy; "" of none."""
    if not found:
        return ""
    each = (
        f"{x.equation} jumps at {x.threshold}, passed {counted(x.times, 'time')}" for x in found
    )
    return (
        f"{'; '.join(each)}: no derivative includes how a parameter moves the instant of a jump, "
        "so estimates need not be the most likely and errors come out too small. Write something "
        "smooth (casadi.tanh, casid.spline)"
    )


def deciding(model: Nonlinear) -> list[str]:
    """Parameters that only decide between expressions, in ``if_else``, and have no derivative."""
    cls: Any = type(model)
    lam = [ca.SX.sym(name) for name in cls.parameter_names()]
    x, u = ([ca.SX.sym(name) for name in names] for names in (cls.states, cls.inputs))
    at = cls(**dict(constants(model))).with_vector(ca.vertcat(*lam))
    values = ca.vertcat(*evaluated(at, x, u))
    moved = ca.sparsify(ca.jacobian(values, ca.vertcat(*lam))).sparsity().get_col()
    return [p.name() for i, p in enumerate(lam) if i not in moved and ca.depends_on(values, p)]


def passages(
    model: Nonlinear, flights: Sequence[tuple[Array, Array]], late: Collection[str] = ()
) -> list[Passage]:
    """Jumps that states (N, nx) and inputs (N, nu) of some flights pass.

    Inputs that come ``late`` by a parameter, and not in steps whose instants are known, move the
    instants of jumps that they alone decide.
    """
    cls: Any = type(model)
    thresholds, function = _thresholds(cls, constants(model), frozenset(late), surroundings(cls))
    if not thresholds:
        return []
    names = [*(f"d{name}/dt" for name in model.states), *model.outputs]
    lam, equations = model.vector(), model.equations()

    def sides(z: Array) -> Array:
        """dx/dt and outputs at states and inputs (n, nx + nu), (n, nx + ny)."""
        f, h = equations(z[:, : len(model.states)].T, z[:, len(model.states) :].T, lam)
        return np.vstack([f.full(), h.full()]).T

    def above(z: Array) -> Array:
        return np.asarray(function(z.T, lam).full().T > 0)

    points = [np.hstack(each) for each in flights]
    size = np.nanstd(np.vstack([sides(z) for z in points]), axis=0)
    found = []
    for i, threshold in enumerate(thresholds):
        ends = [(z[:-1], z[1:], np.diff(above(z)[:, i].astype(int)) != 0) for z in points]
        before, after = (np.vstack([e[k][e[2]] for e in ends]) for k in (0, 1))
        if not (times := len(before)):
            continue
        some = np.unique(np.linspace(0, times - 1, LOOKED_AT).astype(int))
        before, after = before[some], after[some]
        first, across = above(before)[:, [i]], BESIDE * (after - before)
        for _ in range(HALVED):
            middle = (before + after) / 2
            same = above(middle)[:, [i]] == first
            before, after = np.where(same, middle, before), np.where(same, after, middle)
        jumps = np.abs(sides(after + across) - sides(before - across)) > JUMP * size
        found += [
            Passage(name, threshold, round(times * share))
            for name, share in zip(names, jumps.mean(axis=0), strict=True)
            if share
        ]
    return found


@lru_cache(maxsize=64)
def _thresholds(
    cls: Nonlinear,
    trim: tuple[tuple[str, Any], ...],
    late: frozenset[str],
    read: Surroundings,  # noqa: ARG001 - it is remembered by
) -> tuple[list[str], ca.Function]:
    """What decides in the equations, in words, and by its sign as a function of ((x, u), λ)."""
    x, u, lam = (
        [ca.SX.sym(n) for n in names] for names in (cls.states, cls.inputs, cls.parameter_names())
    )
    f, h = evaluated(cls(**dict(trim)).with_vector(ca.vertcat(*lam)), x, u)
    # An instant that inputs alone decide no parameter moves, but by their delay.
    delayed = [each for each in u if each.name() in late]
    moved = ca.vertcat(*x, *delayed, *lam)
    found = {
        said: value
        for said, value in _decisions(ca.vertcat(f, h))
        if ca.depends_on(value, moved) and ca.depends_on(value, ca.vertcat(*x, *u))
    }
    arguments = [ca.vertcat(*x, *u), ca.vertcat(*lam)]
    return list(found), ca.Function("thresholds", arguments, [ca.vertcat(*found.values())])


def _decisions(expression: ca.SX) -> list[tuple[str, ca.SX]]:
    """Differences whose sign decides in an expression, and in words where it changes."""
    left, seen = list(ca.vertsplit(expression)), set[int]()
    found: list[tuple[str, ca.SX]] = []
    while left:
        node = left.pop()
        if node.is_constant() or node.is_symbolic() or node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        parts = [node.dep(i) for i in range(node.n_dep())]
        if node.op() in COMPARED:
            found.append((f"{parts[0]} = {parts[1]}", parts[0] - parts[1]))
        elif node.op() in SIDES:  # of copysign(a, b) b decides, of atan2(y, x) y, where x < 0
            side = parts[SIDES[node.op()]]
            found.append((f"{side} = 0", side))
        left += parts
    return found
