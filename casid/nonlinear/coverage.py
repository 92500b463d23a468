"""Where a nonlinear structure is backed by data: the spans of its tables and of a fit's records."""

from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.code_dependencies import Surroundings, surroundings
from casid.errors import warn
from casid.model import constants
from casid.nonlinear.expressions import Nonlinear, evaluated
from casid.nonlinear.tables import noted

MARGIN = 0.1  # of a span that a manoeuvre about its end may leave it by,
NEARBY = 0.05  # or of the largest value: one airspeed, flown with little change, is no wall
SPEEDS = ("u", "V")  # what is an airspeed by name, see `airspeeds`

Spans: TypeAlias = Mapping[str, tuple[float, float]]  # lowest and highest value of a variable


def airspeeds(model: Nonlinear, names: Collection[str]) -> tuple[str, ...]:
    """Those of names that are airspeeds of a structure: u or V, an input only if it has that unit.

    An input called u may be any; without a unit of its own in ``units`` it is none.
    """
    units = getattr(model, "units", {})
    inputs = {name for name in model.inputs if units.get(name) != "m/s"}
    return tuple(name for name in SPEEDS if name in names and name not in inputs)


def tabulated(model: Nonlinear) -> dict[str, tuple[float, float]]:
    """Span of the knots of each variable that tables are over; the narrowest of several tables."""
    names, _, knots = _scheduled(*_built_of(model))
    return {name: ends for name, ends in zip(names, knots, strict=True) if ends is not None}


def reached(model: Nonlinear, x: Array, u: Array) -> dict[str, tuple[float, float]]:
    """Span of each scheduled variable, and of airspeed, over states (N, nx) and inputs (N, nu)."""
    names, function, _ = _scheduled(*_built_of(model))
    values = function(np.transpose(x), np.transpose(u), model.vector()).full()
    seen = {name: row[np.isfinite(row)] for name, row in zip(names, values, strict=True)}
    return {n: (float(row.min()), float(row.max())) for n, row in seen.items() if len(row)}


def joined_spans(spans: Sequence[Spans]) -> dict[str, tuple[float, float]]:
    """The least span of each variable that holds all of its."""
    every = {
        name: [each[name] for each in spans if name in each] for span in spans for name in span
    }
    return {n: (min(a for a, _ in some), max(b for _, b in some)) for n, some in every.items()}


def leaves(span: tuple[float, float], covered: tuple[float, float]) -> bool:
    """Whether a span leaves what is covered by more than the margin."""
    size = max(map(abs, covered))
    room = max(MARGIN * (covered[1] - covered[0]), NEARBY * size if np.isfinite(size) else 0.0)
    return span[0] < covered[0] - room or span[1] > covered[1] + room


def warn_beyond(model: Nonlinear, told: str, visited: Spans, flown: Spans | None = None) -> None:
    """Warn, once, of variables beyond the tables and what a fit's records covered (``flown``).

    Tables are data, and so are records; but of an airspeed only those of the fit tell parameters.
    """
    own, tables = dict(flown or {}), tabulated(model)
    covered = joined_spans([tables, own]) | {n: own[n] for n in airspeeds(model, own)}
    said = []
    for name, (low, high) in visited.items():
        first, last = covered.get(name, (-np.inf, np.inf))
        if leaves((low, high), (first, last)):
            unit = f" {model.units[name]}" if name in model.units else ""
            at = f"is {low:.4g}" if low == high else f"runs from {low:.4g} to {high:.4g}"
            sources = {"its tables": tables.get(name), "the records of the fit": own.get(name)}
            alone = [by for by, span in sources.items() if span == (first, last)]
            by = alone[0] if alone else " and ".join(sources)
            said.append(f"{name} {at}{unit}, where {by} cover {first:.4g} to {last:.4g}")
    if said:
        warn(
            f"{type(model).__name__}, {told}: {'; '.join(said)}. Beyond them the structure is "
            "extrapolated: stay inside, or fly there and fit or tabulate again"
        )


def _built_of(model: Nonlinear) -> tuple[Any, tuple[tuple[str, Any], ...], Surroundings]:
    cls: Any = type(model)
    return cls, constants(model), surroundings(cls)


@lru_cache(maxsize=64)
def _scheduled(
    cls: Nonlinear,
    constants: tuple[tuple[str, Any], ...],
    read: Surroundings,  # noqa: ARG001 - it is remembered by
) -> tuple[list[str], ca.Function, list[tuple[float, float] | None]]:
    """Variables of tables and airspeeds: names, function of (x, u, λ), spans of the knots."""
    x, u, lam = ([ca.SX.sym(n) for n in names] for names in
                 (cls.states, cls.inputs, cls.parameter_names()))  # fmt: skip
    vector = ca.vertcat(*lam)
    with noted() as tables:
        evaluated(cls(**dict(constants)).with_vector(vector), x, u)
    spans: dict[str, tuple[float, float] | None] = {}
    variables: dict[str, ca.SX] = {}
    for argument, low, high in tables:
        if ca.depends_on(argument, ca.vertcat(*x, *u)):
            before = spans.get(str(argument)) or (-np.inf, np.inf)
            spans[str(argument)] = max(before[0], low), min(before[1], high)
            variables[str(argument)] = argument
    for name in (name for name in airspeeds(cls, cls.states) if name not in spans):
        spans[name], variables[name] = None, x[cls.states.index(name)]
    outputs = ca.vertcat(*variables.values())
    function = ca.Function("scheduled", [ca.vertcat(*x), ca.vertcat(*u), vector], [outputs])
    return list(spans), function, list(spans.values())
