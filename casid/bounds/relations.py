"""Linear relations between parameters, read from text: ``"Nlat = 0.05 Llat"``, ``"Lp + Mq <= -1"``.

A relation is two or three sums joined by ``=``, ``<=`` or ``>=`` (``<`` and ``>`` mean the same as
``<=`` and ``>=``: a set of values an optimiser can use contains its border). A sum has numbers,
names, ``+ - * /`` and parentheses; ``0.05 Llat`` is a product. Nothing else is understood, and
nothing is evaluated as Python.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casid.errors import ModelError

TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<mark><=|>=|==|[-+*/()=<>]))"
)
SPELT = str.maketrans({"−": "-", "·": "*", "×": "*", "≤": "<", "≥": ">"})
RELATIONS = {"=": "=", "==": "=", "<": "<", "<=": "<", ">": ">", ">=": ">"}


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


def parse_relation(text: str) -> Relation:
    """Read one relation; ModelError says where it is not a linear one between parameters."""
    reader = _Reader(text)
    sides, marks = [reader.sum()], []
    while reader.peek() in RELATIONS:
        marks.append(RELATIONS[reader.take()])
        sides.append(reader.sum())
    reader.end()
    if len(marks) not in (1, 2) or len(set(marks)) > 1 or (len(marks) == 2 and "=" in marks):
        raise reader.wrong("expected one of =, <=, >= between two sums, or low <= sum <= high")
    if marks[0] == ">":
        sides.reverse()
    if len(sides) == 3:
        low, middle, high = sides
        if low.factors or high.factors:
            raise reader.wrong("expected numbers on the outer sides of low <= sum <= high")
        return _relation(reader, middle, low.constant, high.constant)
    difference = sides[0].plus(sides[1], -1.0)
    tie = marks[0] == "="
    return _relation(reader, difference, 0.0 if tie else -np.inf, 0.0)


def _relation(reader: "_Reader", total: "_Affine", lower: float, upper: float) -> Relation:
    factors = {name: a for name, a in total.factors.items() if a != 0}
    if not factors:
        raise reader.wrong("no parameter is left in it")
    lower, upper = lower - total.constant, upper - total.constant
    if len(factors) == 1:  # 2 Lp <= -3 is Lp <= -1.5
        ((name, a),) = factors.items()
        factors, (lower, upper) = {name: 1.0}, sorted((lower / a, upper / a))
    elif next(iter(factors.values())) < 0:
        factors = {name: -a for name, a in factors.items()}
        lower, upper = -upper, -lower
    # 0.0 + clears the sign of a negative zero
    return Relation(
        reader.text.strip(), tuple(factors), tuple(factors.values()), 0.0 + lower, 0.0 + upper
    )


@dataclass(frozen=True)
class _Affine:
    """constant + Σ factor · name."""

    constant: float = 0.0
    factors: Mapping[str, float] = field(default_factory=dict)

    def plus(self, other: "_Affine", sign: float = 1.0) -> "_Affine":
        names = dict.fromkeys([*self.factors, *other.factors])
        factors = {
            name: self.factors.get(name, 0.0) + sign * other.factors.get(name, 0.0)
            for name in names
        }
        return _Affine(self.constant + sign * other.constant, factors)

    def times(self, factor: float) -> "_Affine":
        return _Affine(self.constant * factor, {k: a * factor for k, a in self.factors.items()})


class _Reader:
    """Recursive descent over the tokens of one relation."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._tokens: list[tuple[str, str]] = []
        plain, at = text.translate(SPELT), 0
        while plain[at:].strip():
            found = TOKEN.match(plain, at)
            if found is None:
                raise self.wrong(f"{plain[at:].strip()[0]!r} is not understood")
            kind = str(found.lastgroup)
            self._tokens.append((kind, found[kind]))
            at = found.end()
        self._at = 0

    def wrong(self, why: str) -> ModelError:
        return ModelError(
            f"relation {self.text!r}: {why}; write linear relations such as "
            '"Nlat = 0.05 Llat", "Lp <= 2 Mq - 0.1" or "-5 <= Lp + Mq <= -1"'
        )

    def peek(self) -> str:
        return self._tokens[self._at][1] if self._at < len(self._tokens) else ""

    def kind(self) -> str:
        return self._tokens[self._at][0] if self._at < len(self._tokens) else ""

    def take(self) -> str:
        token = self.peek()
        self._at += 1
        return token

    def end(self) -> None:
        if self.peek():
            raise self.wrong(f"{self.peek()!r} is out of place")

    def sum(self) -> _Affine:
        total = self.product()
        while self.peek() in ("+", "-"):
            sign = 1.0 if self.take() == "+" else -1.0
            total = total.plus(self.product(), sign)
        return total

    def product(self) -> _Affine:
        total = self.factor()
        while self.peek() in ("*", "/", "(") or self.kind() in ("name", "number"):
            if self.peek() == "/":
                self.take()
                divisor = self.factor()
                if divisor.factors or divisor.constant == 0:
                    raise self.wrong("a divisor must be a number other than zero")
                total = total.times(1 / divisor.constant)
                continue
            if self.peek() == "*":
                self.take()
            total = self._multiplied(total, self.factor())
        return total

    def _multiplied(self, a: _Affine, b: _Affine) -> _Affine:
        if a.factors and b.factors:
            raise self.wrong("a product of parameters is not linear")
        return b.times(a.constant) if b.factors else a.times(b.constant)

    def factor(self) -> _Affine:
        kind, token = self.kind(), self.take()
        if token in ("+", "-"):
            return self.factor().times(1.0 if token == "+" else -1.0)
        if kind == "number":
            return _Affine(float(token))
        if kind == "name":
            return _Affine(0.0, {token: 1.0})
        if token == "(":
            inner = self.sum()
            if self.take() != ")":
                raise self.wrong("a parenthesis is not closed")
            return inner
        raise self.wrong(f"{token!r} is out of place" if token else "something is missing")
