"""Right-hand sides and outputs of nonlinear structures as expressions, and their derivatives."""

from collections.abc import Mapping, Sequence, Set
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casid import declaration, sensors
from casid.arrays import BoolArray
from casid.checks import check_known
from casid.errors import ModelError
from casid.model import Rows

# What has no derivative at all, and what has none at one point.
JUMPS = {ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder"}
KINKS = {ca.OP_FABS: "fabs", ca.OP_SIGN: "sign", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax"}
KINKS |= {ca.OP_IF_ELSE_ZERO: "if_else"}
COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
LOGIC = {*COMPARED, ca.OP_AND, ca.OP_OR, ca.OP_NOT}  # true or false, 1 or 0


class Channels:
    """Values by name, ``x.p``; what a structure's methods are given."""

    def __init__(self, kind: str, names: Sequence[str], values: Sequence[Any]) -> None:
        self._kind, self._names = kind, tuple(names)
        vars(self).update(zip(names, values, strict=True))

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - a number or a symbol
        raise AttributeError(f"no {self._kind} {name!r}; there are {', '.join(self._names)}")


Nonlinear: TypeAlias = Any  # a NonlinearModel, whose module stands above


def evaluated(model: Nonlinear, x: Sequence[Any], u: Sequence[Any]) -> tuple[ca.SX, ca.SX]:
    """Right-hand sides (nx,) and outputs (ny,), as sensors have them, at numbers or symbols.

    ModelError: a method that raises, or gives something else than one expression each.
    """
    named = Channels("state", model.states, x), Channels("input", model.inputs, u)

    def column(values: Any, names: Sequence[str]) -> ca.SX:  # noqa: ANN401 - whatever they wrote
        if isinstance(values, str | Set | Mapping) or not hasattr(values, "__len__"):
            raise ModelError(f"it is {values!r}, expected a list: {', '.join(names)}")
        if len(values) != len(names):
            raise ModelError(
                f"it has {len(values)} expressions, expected {len(names)}: {', '.join(names)}"
            )
        pairs = zip(values, names, strict=True)
        return ca.vertcat(*[declaration.scalar(v, f"that of {n!r}") for v, n in pairs])

    f = declaration.written(model, "derivatives", lambda v: column(v, model.states), *named)
    h = declaration.written(model, "measurements", lambda v: column(v, model.outputs), *named)
    return f, declaration.written(model, "sensors", lambda v: sensors.sensed(model, x, f, h, v))


def reference_point(model: Nonlinear) -> tuple[list[Any], list[Any]]:
    """States and inputs of the reference condition, numbers or expressions of the parameters."""
    given = declaration.written(model, "reference", dict)
    names = (*model.states, *model.inputs)
    check_known(
        f"{type(model).__name__}.reference: no state or input is called", given, names, ModelError
    )
    values = [given.get(name, 0.0) for name in names]
    return values[: len(model.states)], values[len(model.states) :]


def linearised(model: Nonlinear, x0: Sequence[Any], u0: Sequence[Any]) -> tuple[Rows, ...]:
    """A, B, C, D at a point: rows of numbers or expressions, literal zeros where nothing acts."""
    x, u = ca.SX.sym("x", len(x0)), ca.SX.sym("u", len(u0))
    f, h = evaluated(model, ca.vertsplit(x), ca.vertsplit(u))
    slopes = [ca.jacobian(value, of) for value in (f, h) for of in (x, u)]
    at = [ca.SX(ca.vertcat(*part)) for part in (x0, u0)]
    placed = [ca.sparsify(part) for part in ca.substitute(slopes, [x, u], at)]
    return tuple(
        [[part[i, j] if part.sparsity().has_nz(i, j) else 0 for j in range(part.shape[1])]
         for i in range(part.shape[0])]
        for part in placed
    )  # fmt: skip


def balances(model: Nonlinear, x0: Sequence[Any], u0: Sequence[Any]) -> ca.SX:
    """dx/dt (nx,) at a point of numbers or expressions."""
    return evaluated(model, x0, u0)[0]


def resting(equations: ca.Function) -> BoolArray:
    """States (nx,) whose dx/dt is zero in a trim: those that some equation depends on.

    Positions and headings, on which none does, go on changing. Where no state acts, all rest.
    """
    acts = ca.DM(equations.jac_sparsity(0, 0), 1).full().any(axis=0)
    return np.asarray(acts if acts.any() else ~acts)


def operations(expression: ca.SX) -> list[str]:
    """Names of the operations in an expression whose value or slope jumps."""
    function = ca.Function("operations", ca.symvar(expression), [expression])
    used = {function.instruction_id(i) for i in range(function.n_instructions())}
    return sorted(name for code, name in (JUMPS | KINKS).items() if code in used)


def jumping(expression: ca.SX) -> list[str]:
    """Names of those that have no derivative at all, and comparisons that are taken as numbers.

    What only decides between two expressions, in ``if_else``, need not jump.
    """
    function = ca.Function("jumping", ca.symvar(expression), [expression])
    found, truth = set(), dict[int, str]()  # places that hold a comparison, and which
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        inputs = function.instruction_input(k) if code != ca.OP_INPUT else []
        taken = [truth[i] for i in inputs if i in truth]
        if code == ca.OP_IF_ELSE_ZERO:
            taken = [truth[i] for i in inputs[1:] if i in truth]
        if code in JUMPS:
            found.add(JUMPS[code])
        elif code not in LOGIC:
            found.update(taken)
        if code != ca.OP_OUTPUT:
            place = function.instruction_output(k)[0]
            truth.pop(place, None)
            if code in LOGIC:
                truth[place] = COMPARED.get(code, taken[0] if taken else "a comparison")
    return sorted(found)
