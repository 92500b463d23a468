"""The best input of a family, within limits.

Everything the loop does is linear in the input r, so a signal that is to stay within its limit can
be brought there by making r smaller: with s the largest ratio of any signal to its limit, r/s keeps
all limits and has standard errors s times as large. What is minimised is therefore

    mean of ½ ln Φ(F(r)) over the models + ln s,

in which the scale of r does not matter once a limit is reached. The limits are also those of other
models, of which nothing else is asked. s, smooth, is (1 + Σ ratioᵖ)^(1/p),
p rising; the last word has the largest ratio itself. It is not convex: the start decides which
optimum is found. L-BFGS with exact derivatives takes it; in trials on few parameters IPOPT, with
the limits as constraints and exact second derivatives, found somewhat smaller errors in far more
time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array
from casid.design.criterion import Goal
from casid.design.loop import Crowd, Loop
from casid.design.shapes import Shape

POWERS = (16, 64, 64)  # p, one after the other, a third of the iterations each; powers of two
MEMORY = 20  # of L-BFGS
TRIES = 3  # evaluations an iteration, on average, after which it gives up
KEPT = 0.9  # share of the judges with which limits are kept


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What a design is judged by: loops of one or several models, goals, limits."""

    loops: tuple[Loop, ...]
    goals: tuple[Goal, ...]
    limits: Array  # (2 nu + ny + nx,) of sticks, rates, outputs, states; infinite where none is
    others: Crowd | None = None  # models that have to keep the limits, too
    judges: Crowd | None = None  # models that most of what is found has to keep them with

    @property
    def sticks(self) -> Array:
        """Their limits, (nu,)."""
        return self.limits[: self.loops[0].nu]

    @property
    def rates(self) -> Array:
        """Limits of the sticks' rates, (nu,)."""
        nu = self.loops[0].nu
        return self.limits[nu : 2 * nu]

    def shares(self, signals: Array) -> Array:
        """Sticks, rates, outputs and states (..., N, 2 nu + ny + nx) over their limits."""
        nu, h = self.loops[0].nu, self.loops[0].h
        u, sides = signals[..., :nu], signals[..., nu:]
        rates = np.diff(u, axis=-2, prepend=0.0 * u[..., :1, :]) / h
        return np.asarray(np.concatenate([u, rates, sides], axis=-1) / self.limits)

    def shares_slope(self, slope: Array) -> Array:
        """Derivatives by signals of a function with these derivatives by their shares."""
        nu, h = self.loops[0].nu, self.loops[0].h
        slope = slope / self.limits
        rates = slope[..., nu : 2 * nu]
        du = slope[..., :nu] - np.diff(rates, axis=-2, append=0.0 * rates[..., :1, :]) / h
        return np.concatenate([du, slope[..., 2 * nu :]], axis=-1)

    def peaks(self, r: Array) -> Array:
        """Largest shares of the limits (2 nu + ny + nx,) over all models.

        Of the judges it is what all but one in ten keep.
        """
        every = [np.abs(self.shares(loop.fly(r).signals)).max(axis=0) for loop in self.loops]
        if self.others:
            every.extend(np.abs(self.shares(self.others.fly(r))).max(axis=1))
        if self.judges:
            found = np.abs(self.shares(self.judges.fly(r))).max(axis=1)
            hardest = found.max(axis=1)
            every.extend(found[hardest <= np.quantile(hardest, KEPT)])
        return np.asarray(np.max(every, axis=0))

    def within(self, r: Array) -> Array:
        """The same input as large as the limits let it be."""
        return r / max(1e-12, float(self.peaks(r).max()))

    def extremes(self, r: Array, near: float) -> list[tuple[int, int, int]]:
        """Where shares are largest: model, sample and signal of local extremes.

        They have ``near`` times the largest share at least; of several models it is the worst.
        """
        models = [self.shares(loop.fly(r).signals)[None] for loop in self.loops]
        if self.others:
            models.append(self.shares(self.others.fly(r)))
        size = np.abs(np.concatenate(models))
        top = size.max(axis=0)
        around = np.pad(top, ((1, 1), (0, 0)))
        peak = (top >= around[:-2]) & (top > around[2:]) & (top >= near * top.max())
        return [(int(size[:, k, i].argmax()), int(k), int(i)) for k, i in np.argwhere(peak)]

    def rows(self, places: Sequence[tuple[int, int, int]]) -> Array:
        """Derivatives by r, (n, N, nu), of the shares at these places: impulses read backward."""
        N, nu = self.loops[0].N, self.loops[0].nu
        out = np.zeros((len(places), N, nu))
        for model in {place[0] for place in places}:
            impulses = self.shares(np.moveaxis(self._impulses(model), 2, 0))
            for row, (which, k, i) in zip(out, places, strict=True):
                if which == model:
                    row[: k + 1] = impulses[:, k::-1, i].T
        return out

    def _impulses(self, model: int) -> Array:
        """Sticks, outputs and states (N, nu + ny + nx, nu) after one sample of each r."""
        if model < len(self.loops) or self.others is None:
            return self.loops[model].impulses()
        return self.others.impulses(model - len(self.loops))

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
        flown = [loop.fly(r) for loop in self.loops]
        shares = [self.shares(each.signals) for each in flown]
        if self.others:
            shares.append(self.shares(self.others.fly(r)))
        top = max(1.0, *(float(np.abs(part).max()) for part in shares))
        powers = [_powers(part / top, p) for part in shares]
        total = top**-p + sum(float(power.sum()) for power, _ in powers)
        value, slope, count = np.log(top) + np.log(total) / p, np.zeros_like(r), len(self.loops)
        pull = [self.shares_slope(lower / (top * total)) for _, lower in powers]
        if self.others:
            slope += self.others.pulled_back(pull[-1])
        for loop, goal, each, signals in zip(self.loops, self.goals, flown, pull, strict=False):
            J = loop.sensitivities(each.z)
            worth, M = goal(J.T @ J)
            value += worth / count
            slope += loop.pulled_back(signals, loop.information_slope(J, M) / count)
        return float(value), slope


def _powers(share: Array, p: int) -> tuple[Array, Array]:
    """Shares to the p, a power of two, and to the p - 1: squared, which is faster than a power."""
    power, lower = share * share, share.copy()
    for _ in range(p.bit_length() - 2):
        lower *= power
        power *= power
    return power, lower


def improved(task: Task, shapes: Sequence[Shape], iterations: int) -> Array:
    """Best input found (N, nu) from where the shapes, one an axis, start.

    ``iterations`` are those of L-BFGS in all. Of the start and the results the best is returned, as
    large as the limits let it be.
    """
    cut = np.cumsum([len(shape.start) for shape in shapes])[:-1]

    def signal(x: Array) -> Array:
        parts = zip(shapes, np.split(x, cut), strict=True)
        return np.stack([shape.signal(part) for shape, part in parts], axis=1)

    def judged(x: Array, p: int) -> tuple[float, Array]:
        value, slope = task.slope(signal(x), p)
        parts = zip(shapes, np.split(x, cut), slope.T, strict=True)
        return value, np.concatenate([shape.pulled_back(part, row) for shape, part, row in parts])

    objective: Any = judged
    x, rounds = np.concatenate([shape.start for shape in shapes]), iterations // len(POWERS)
    lower = np.concatenate([shape.lower for shape in shapes])
    upper = np.concatenate([shape.upper for shape in shapes])
    bounds = scipy.optimize.Bounds(lower, upper)
    best = task.within(signal(x))
    least = task.value(best)
    options: Any = {"maxiter": rounds, "maxfun": TRIES * rounds + 1, "maxcor": MEMORY}
    for p in POWERS:
        result: Any = scipy.optimize.minimize(
            objective, x, args=(p,), jac=True, method="L-BFGS-B", bounds=bounds, options=options
        )
        x = result.x
        found = task.within(signal(x))
        value = task.value(found)
        if value < least:
            best, least = found, value
    return best
