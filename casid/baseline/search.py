"""The least cost in decibels and degrees, from several starting points.

The relative error G/Ĝ − 1 is the cost's logarithm to first order and easier to descend on. So
every start descends on its squares first, then on the cost itself, and `casid.matching.programme`
solves for the best of the minima found, with the prices of what holds it.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from casid.arrays import Array
from casid.baseline.accuracy import StartCost
from casid.matching.descent import Condensed, descend
from casid.matching.initial import StartingPoint, least_squares
from casid.matching.mismatch import weighted_errors
from casid.matching.programme import Optimum, Programme
from casid.nlp import SolverOptions

STEPS = 200  # at most, of the descent on the cost
ROUGH = 1e-3  # share of the relative error's squares below which a step leads on to the cost
SETTLED = 1e-7  # share of J below which a step ends it: the programme goes on from the best end
TRIES = 3  # to solve from ends as good as the best, which are many along a valley
AGREES = 1e-4  # between J as IPOPT has it and J of the model found, relative to 1 + J


# One row a start, and the free parameters (nf,) where its descent ended.
Minima: TypeAlias = tuple[tuple[StartCost, Array], ...]


def descents(problem: Condensed, count: int, seed: int) -> Minima:
    """Descend from ``count`` points on the relative error, then on the cost; random by ``seed``."""
    found, cost = [], decibels(problem)
    for number, (name, start) in enumerate(_points(problem, count, seed)):
        began = time.perf_counter()
        rough = descend(problem, start, steps=100, tolerance=ROUGH)
        last = descend(cost, rough.values, steps=STEPS, tolerance=SETTLED)
        row = StartCost(
            start=f"{number + 1} ({name})",
            J=last.cost,
            success=last.settled,
            status="settled" if last.settled else "the limit of steps was reached",
            iterations=rough.steps + last.steps,
            seconds=time.perf_counter() - began,
        )
        found.append((row, last.values))
    return tuple(found)


def decibels(problem: Condensed) -> Condensed:
    """The same responses compared in decibels and degrees."""
    return replace(problem, norm="decibel")


def _points(problem: Condensed, count: int, seed: int) -> Iterator[tuple[str, Array]]:
    """Names and free parameters: from least squares, the guess, and at random about the first."""
    free, rng = problem.free, np.random.default_rng(seed)
    scale, limits = free.scale[free.index], (free.lower[free.index], free.upper[free.index])
    values = least_squares(problem)
    points = [("guess", free.guess)]
    if values is not None:
        points.insert(0, ("least squares", values))
    yield from points[:count]
    centre = points[0][1]
    for _ in range(count - len(points)):
        spread = np.hypot(0.5 * centre, 0.05 * scale) * rng.standard_normal(len(centre))
        yield "random", np.clip(centre + spread, *limits)


def solve(problem: Condensed, found: Minima, options: SolverOptions) -> Optimum:
    """The programme from the best minimum; from the next as good if that fails, and so on."""
    best: Optimum | None = None
    iterations = 0
    minima = [StartingPoint(name=row.start, values=values, cost=row.J) for row, values in found]
    minima.sort(key=lambda start: start.cost)
    limit = minima[0].cost + AGREES * (1 + minima[0].cost)  # a worse minimum is no answer
    for start in [minima[0], *(each for each in minima[1:] if each.cost <= limit)][:TRIES]:
        programme = Programme(problem.free, problem.comparison, "decibel", start.values)
        optimum = _checked(problem, programme.solve(options, f"derivid, start {start.name}"))
        iterations += optimum.iterations
        if best is None or optimum.success:
            best = optimum
        if optimum.success:
            break
    assert best is not None  # there is at least one start
    return replace(best, iterations=iterations)


def pair_costs(problem: Condensed, values: Array) -> Array:
    """J of every pair at free values, (ny, nu)."""
    c = problem.comparison
    r = weighted_errors(problem.matrices(values).response(c.s), c.G, c.decibel_weight)
    return np.asarray(np.sum(r**2, axis=(0, 1)))


def _checked(problem: Condensed, found: Optimum) -> Optimum:
    """What IPOPT calls a success, held against the cost of the model itself."""
    c = problem.comparison
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(pair_costs(problem, found.values).sum())
        cost += float(np.sum(problem.free.prior_residuals(found.values)[0] ** 2) / 2)
    silent = (c.W > 0) & (problem.matrices(found.values).response(c.s) == 0)
    status = found.status
    if silent.any():
        i, j = np.argwhere(silent.any(axis=0))[0]
        pair = problem.free.model.outputs[i], problem.free.model.inputs[j]
        status = f"{pair[0]} does not respond to {pair[1]} in the model; leave that pair out"
    elif abs(cost - found.cost) <= AGREES * (1 + cost):
        return replace(found, cost=cost)
    elif found.success:
        status = f"solved, but the model's own cost there is {cost:.6g}, not {found.cost:.6g}"
    cost = cost if np.isfinite(cost) else np.inf
    return replace(found, cost=cost, success=False, status=status)
