"""The best member of a linear family of inputs, within limits.

Everything the loop does is linear in the input r, so a signal that is to stay within its limit can
be brought there by making r smaller: with s the largest ratio of any signal to its limit, r/s keeps
all limits and has standard errors s times as large. What is minimised is therefore

    mean of ½ ln Φ(F(r)) over the models + ln s,

in which the scale of r does not matter once a limit is reached. The limits are also those of other
models, of which nothing else is asked. s, smooth, is (1 + Σ ratioᵖ)^(1/p),
p rising; the last word has the largest ratio itself. It is not convex: the start decides which
optimum is found.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize

from casid.arrays import Array
from casid.design.criterion import Goal
from casid.design.loop import Loop, Response

POWERS = (16, 60)  # p, one after the other
MEMORY = 20  # of L-BFGS


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What a design is judged by: loops of one or several models, goals, limits.

    ``others`` are loops that have to keep the limits, too.
    """

    loops: tuple[Loop, ...]
    goals: tuple[Goal, ...]
    others: tuple[Loop, ...]
    sticks: Array  # (nu,) limits, those of their rates, (ny,) of outputs, (nx,) of states;
    rates: Array  # infinite where there is none
    responses: Array
    states: Array

    def ratios(self, loop: Loop, flown: Response) -> list[Array]:
        """Sticks, their rates, outputs and states over their limits."""
        rate, x = np.diff(flown.u, axis=0, prepend=0.0) / loop.h, flown.z[:, : loop.nx]
        sides = flown.y / self.responses, x / self.states
        return [flown.u / self.sticks, rate / self.rates, *sides]

    def peaks(self, r: Array) -> list[Array]:
        """Largest shares of the limits of sticks, rates, outputs and states over all models."""
        every = [self.ratios(loop, loop.fly(r)) for loop in (*self.loops, *self.others)]
        largest = [[np.abs(part).max(axis=0) for part in each] for each in every]
        return [np.max(part, axis=0) for part in zip(*largest, strict=True)]

    def within(self, r: Array) -> Array:
        """The same input as large as the limits let it be."""
        return r / max(1e-12, *(float(part.max()) for part in self.peaks(r)))

    def information(self, r: Array) -> list[Array]:
        """F (nf, nf) of each model."""
        J = [loop.sensitivities(loop.fly(r).z) for loop in self.loops]
        return [each.T @ each for each in J]

    def value(self, r: Array) -> float:
        """Mean of ½ ln Φ over the models."""
        pairs = zip(self.goals, self.information(r), strict=True)
        return float(np.mean([goal(F)[0] for goal, F in pairs]))

    def slope(self, r: Array, p: int) -> tuple[float, Array]:
        """What is minimised, and its derivatives by r (N, nu)."""
        every = (*self.loops, *self.others)
        flown = [loop.fly(r) for loop in every]
        ratios = [self.ratios(*pair) for pair in zip(every, flown, strict=True)]
        parts = [part for each in ratios for part in each]
        top = max(1.0, *(float(np.abs(part).max()) for part in parts))
        total = top**-p + sum(float(((part / top) ** p).sum()) for part in parts)
        value, slope = np.log(top) + np.log(total) / p, np.zeros_like(r)
        limits, count = (self.sticks, self.rates, self.responses, self.states), len(self.loops)
        for k, (loop, each, four) in enumerate(zip(every, flown, ratios, strict=True)):
            du, rate, dy, dx = (
                (part / top) ** (p - 1) / top / total / limit
                for part, limit in zip(four, limits, strict=True)
            )
            du -= np.diff(rate, axis=0, append=0.0) / loop.h
            dz = np.zeros_like(each.z)
            dz[:, : loop.nx] = dx
            if k < count:
                J = loop.sensitivities(each.z)
                worth, M = self.goals[k](J.T @ J)
                value += worth / count
                dz += loop.information_slope(J, M) / count
            slope += loop.pulled_back(du, dy, dz)
        return float(value), slope


def improved(
    task: Task, family: Sequence[Array], start: Sequence[Array], iterations: int
) -> tuple[Array, list[Array]]:
    """Best input found (N, nu) and its coefficients, one array an axis, from those given.

    Parameters
    ----------
    task : Task
        What counts.
    family : sequence of (N, n_j) array
        Signals of each axis that may be superposed.
    start : sequence of (n_j,) array
        Coefficients; what they make may exceed limits.
    iterations : int
        Of L-BFGS, in all.
    """
    edges = np.cumsum([len(each) for each in start])[:-1]

    def signal(c: Array) -> Array:
        parts = zip(family, np.split(c, edges), task.sticks, strict=True)
        return np.stack([B @ part * size for B, part, size in parts], axis=1)

    def judged(c: Array, p: int) -> tuple[float, Array]:
        value, slope = task.slope(signal(c), p)
        rows = zip(family, slope.T, task.sticks, strict=True)
        return value, np.concatenate([B.T @ row * size for B, row, size in rows])

    objective: Any = judged
    best = np.concatenate([np.asarray(each, dtype=float) for each in start])
    least = task.value(task.within(signal(best)))
    c = best
    for p in POWERS:
        options: Any = {"maxiter": iterations // len(POWERS), "maxcor": MEMORY}
        found: Any = scipy.optimize.minimize(
            objective, c, args=(p,), jac=True, method="L-BFGS-B", options=options
        )
        c = found.x
        value = task.value(task.within(signal(c)))
        if value < least:
            best, least = c, value
    return task.within(signal(best)), np.split(best, edges)
