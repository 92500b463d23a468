"""Linear relations between parameters, read from text: ``"Nlat = 0.05 Llat"``, ``"Lp + Mq <= -1"``.

A relation is two or three sums joined by ``=``, ``<=`` or ``>=`` (``<`` and ``>`` mean the same as
``<=`` and ``>=``: a set of values an optimiser can use contains its border). A sum has numbers,
names, ``+ - * /`` and parentheses; a number before a name or a parenthesis multiplies it,
``0.05 Llat``. Nothing else is understood, and nothing is evaluated as Python.
"""

import ast
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from casid.errors import ModelError

TOKEN = re.compile(
    r"(?P<code>0[xXoObB_]\w*)|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[^\W\d]\w*|<=|>=|==|[-+*/()=<>]|(?P<other>\S)"
)
SPELT = str.maketrans({"−": "-", "·": "*", "×": "*", "≤": "<", "≥": ">"})
LARGEST = 1e100  # number; beyond it products overflow
ROUNDING = 1e-9  # of the sizes of a relation's terms
MARKS = {ast.Eq: "=", ast.Lt: "<", ast.LtE: "<", ast.Gt: ">", ast.GtE: ">"}


@dataclass(frozen=True)
class Relation:
    """lower <= Σ coefficient · parameter <= upper; equal bounds make a tie."""

    text: str  # as it was written
    names: tuple[str, ...]
    coefficients: tuple[float, ...]
    lower: float  # infinite on an open side
    upper: float

    @property
    def tie(self) -> bool:
        """Whether it is an equation."""
        return self.lower == self.upper

    def value(self, of: Mapping[str, Any]) -> Any:  # noqa: ANN401 - numbers or symbols
        """Σ coefficient · parameter of the values (or symbols) of parameters by name."""
        return sum(a * of[name] for name, a in zip(self.names, self.coefficients, strict=True))

    def row(self, names: tuple[str, ...]) -> Any:  # noqa: ANN401 - an array
        """Coefficients in the order of the names given, (n,); zero where it says nothing."""
        known = dict(zip(self.names, self.coefficients, strict=True))
        return np.array([known.get(name, 0.0) for name in names])


def check_possible(
    relations: Sequence[Relation], bounds: Mapping[str, tuple[float, float]]
) -> None:
    """Refuse relations that cannot all hold between parameters within their bounds: ModelError.

    The linear programme of the least sum of violations; those that its multipliers name contradict
    each other, or the bounds.
    """
    names = tuple(dict.fromkeys(name for each in relations for name in each.names))
    limits = [bounds[name] for name in names]
    size = np.array([max([1.0, *(abs(x) for x in pair if abs(x) < np.inf)]) for pair in limits])
    sides, terms = [], []
    for each in relations:
        row = each.row(names) * size
        for sign, side in ((1.0, each.upper), (-1.0, -each.lower)):
            if side < np.inf:
                unit = np.abs(row).max()
                sides.append((each, side / unit))
                terms.append(sign * row / unit)
    if not sides:
        return
    m, right = len(sides), [side for _, side in sides]
    found = scipy.optimize.linprog(
        c=np.repeat([0.0, 1.0], [len(names), m]),
        A_ub=np.hstack([np.array(terms), -np.eye(m)]),
        b_ub=right,
        bounds=[*np.divide(limits, size[:, None]), *[(0.0, np.inf)] * m],
    )
    if not found.success or found.fun <= ROUNDING * max(1.0, np.abs(right).max()):
        return
    against = np.flatnonzero(np.abs(found.ineqlin.marginals) > ROUNDING)
    guilty = dict.fromkeys(sides[k][0].text for k in against)
    at_bounds = np.abs([found.lower.marginals, found.upper.marginals])[:, : len(names)].max(axis=0)
    held = [names[i] for i in np.flatnonzero(at_bounds > ROUNDING)]
    within = ", ".join(f"{name} in [{bounds[name][0]:g}, {bounds[name][1]:g}]" for name in held)
    raise ModelError(
        f"{' and '.join(map(repr, guilty))} cannot hold{' together' if len(guilty) > 1 else ''}"
        f"{f' with {within}' if held else ''}; loosen one of them, or a bound"
    )


def parse_relation(text: str) -> Relation:
    """Read one relation; ModelError says where it is not a linear one between parameters."""
    try:
        return _read(text.strip())
    except (ModelError, RecursionError, MemoryError) as error:
        why = error if isinstance(error, ModelError) else "it is too long"
        raise ModelError(
            f"relation {text!r}: {why}; write linear relations such as "
            '"Nlat = 0.05 Llat", "Lp <= 2 Mq - 0.1" or "-5 <= Lp + Mq <= -1"'
        ) from error


def _read(text: str) -> Relation:
    """The relation; the messages of its errors are the reasons alone."""
    tree = _tree(text)
    parts = [tree.left, *tree.comparators] if isinstance(tree, ast.Compare) else []
    sides = [_affine(part) for part in parts]
    marks = [MARKS.get(type(op), "") for op in tree.ops] if isinstance(tree, ast.Compare) else []
    if len(marks) not in (1, 2) or len(set(marks)) > 1 or (len(marks) == 2 and "=" in marks):
        raise ModelError("expected one of =, <=, >= between two sums, or low <= sum <= high")
    if marks[0] == ">":
        sides.reverse()
    if len(sides) == 3:
        low, middle, high = sides
        if {*low, *high} - {""}:
            raise ModelError("expected numbers on the outer sides of low <= sum <= high")
        lowest, highest = low.get("", 0.0), high.get("", 0.0)
        if lowest > highest:
            raise ModelError(f"nothing is above {lowest:g} and below {highest:g}")
        return _relation(text, middle, lowest, highest)
    difference = _added(sides[0], sides[1], -1.0)
    return _relation(text, difference, 0.0 if marks[0] == "=" else -np.inf, 0.0)


def _tree(text: str) -> ast.expr:
    """The syntax of a text in Python's terms, ``*`` written where a product has none."""
    tokens = list(TOKEN.finditer(text.translate(SPELT)))
    if wrong := [token[0] for token in tokens if token["code"] or token["other"]]:
        raise ModelError(f"{wrong[0]!r} is not understood")
    spelt = ["==" if token[0] == "=" else token[0] for token in tokens]
    words = spelt[:1]
    for before, token in pairwise(spelt):
        if before[-1] not in "+-*/(<>=" and (token[0].isdigit() or token[0] == "."):
            raise ModelError(f"{token} stands right behind {before}: an operator is missing")
        ends, begins = before == ")" or before[-1] not in "(+-*/<>=", token[0] not in ")+-*/<>="
        words += ["*", token] if ends and begins else [token]
    try:
        return ast.parse(" ".join(words), mode="eval").body
    except SyntaxError as error:
        closed = spelt.count("(") == spelt.count(")")
        why = "something is missing or out of place" if closed else "a parenthesis is not closed"
        raise ModelError(why) from error


def _affine(node: ast.expr) -> dict[str, float]:
    """Coefficients by parameter of what a part of a relation is, its constant by ""."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            if not abs(number) < LARGEST:
                raise ModelError("a number is too large")
            return {"": float(number)}
        case ast.Name(id=name):
            return {name: 1.0}
        case ast.UnaryOp(op=op, operand=inner):
            return _added({}, _affine(inner), -1.0 if isinstance(op, ast.USub) else 1.0)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            sign = 1.0 if isinstance(op, ast.Add) else -1.0
            return _added(_affine(left), _affine(right), sign)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            return _product(_affine(left), _affine(right), inverse=isinstance(op, ast.Div))
    raise ModelError(f"{ast.unparse(node)!r} is out of place")


def _product(a: Mapping[str, float], b: Mapping[str, float], *, inverse: bool) -> dict[str, float]:
    """Coefficients of a times b, or over b; one of them must be a number."""
    if inverse:
        if {*b} != {""} or not b[""]:
            raise ModelError("a divisor must be a number other than zero")
        b = {"": 1 / b[""]}
    number, other = sorted((a, b), key=lambda side: {*side} != {""})
    if {*number} != {""}:
        raise ModelError("a product of parameters is not linear")
    return _added({}, other, number[""])


def _added(a: Mapping[str, float], b: Mapping[str, float], times: float) -> dict[str, float]:
    """Coefficients of a + times b."""
    return {name: a.get(name, 0.0) + times * b.get(name, 0.0) for name in {**a, **b}}


def _relation(text: str, total: Mapping[str, float], lower: float, upper: float) -> Relation:
    factors = {name: a for name, a in total.items() if a != 0 and name}
    if not factors:
        raise ModelError("no parameter is left in it")
    lower, upper = lower - total.get("", 0.0), upper - total.get("", 0.0)
    if len(factors) == 1:  # 2 Lp <= -3 is Lp <= -1.5
        ((name, a),) = factors.items()
        factors, (lower, upper) = {name: 1.0}, sorted((lower / a, upper / a))
    elif next(iter(factors.values())) < 0:
        factors = {name: -a for name, a in factors.items()}
        lower, upper = -upper, -lower
    # 0.0 + clears the sign of a negative zero
    return Relation(text, tuple(factors), tuple(factors.values()), 0.0 + lower, 0.0 + upper)
