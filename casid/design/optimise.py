"""The best input of a family, within limits.

Everything the loop does is linear in the input r, so a signal that is to stay within its limit can
be brought there by making r smaller: with s the largest ratio of any signal to its limit, r/s keeps
all limits and has standard errors s times as large. What is minimised is therefore

    mean of ½ ln Φ(F(r)) over the models + ln s,

in which the scale of r does not matter once a limit is reached. The limits are also those of other
models, of which nothing else is asked; what they reach counts for what models reach of which the
optimisation knows nothing. s, smooth, is (1 + Σ ratioᵖ)^(1/p), p rising; the last word has the
largest ratio itself. It is not convex: the start decides which optimum is found. L-BFGS with exact
derivatives takes it; `benchmarks/design_ipopt.py` has IPOPT on few parameters, with the limits as
constraints and exact second derivatives: it takes far more time, and does not always arrive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array
from casid.design.criterion import KEPT, Goal
from casid.design.loop import Crowd, Loop
from casid.design.shapes import Shape

POWERS = (16, 64, 64)  # p, one after the other, a third of the iterations each; powers of two
MEMORY = 20  # of L-BFGS
TRIES = 3  # evaluations an iteration, on average, after which it gives up
FAINT = 0.3  # share of a limit whose powers are nothing, and slow in single precision


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What a design is judged by: loops of one or several models, goals, limits."""

    loops: tuple[Loop, ...]
    goals: tuple[Goal, ...]
    limits: Array  # (2 nu + ny + nx,) of sticks, rates, outputs, states; infinite where none is
    others: Crowd | None = None  # models that have to keep the limits, too
    judges: Crowd | None = None  # unseen ones, with most of which what is found keeps them
    strain: float = 1.0  # what shares of the others count for

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

        Of the judges, without which it is the other models, it is what nine in ten keep.
        """
        every = [np.abs(self.shares(loop.fly(r).signals)).max(axis=0) for loop in self.loops]
        if self.judges:
            found = self.judges.peaks(r)
            hardest = found.max(axis=1)
            every.extend(found[hardest <= np.quantile(hardest, KEPT)])
        elif self.others:
            every.extend(self.others.peaks(r))
        return np.asarray(np.max(every, axis=0))

    def strained(self, r: Array) -> "Task":
        """The same, the others' shares counting for what those of the judges after r say.

        What was optimised keeps limits better with the models it was optimised with than with
        others; without this, sticks would stay small for that gap, too.
        """
        if not (self.others and self.judges):
            return self
        unseen = np.quantile(self.judges.peaks(r).max(axis=1), KEPT)
        return replace(self, strain=float(unseen / max(1e-12, self.others.peaks(r).max())))

    def within(self, r: Array) -> Array:
        """The same input as large as the limits let it be."""
        return r / max(1e-12, float(self.peaks(r).max()))

    def extremes(self, r: Array, near: float) -> list[tuple[int, int, int]]:
        """Where shares are largest: model, sample and signal of local extremes.

        They have ``near`` times the largest share at least; of several models it is the worst.
        """
        models = [self.shares(loop.fly(r).signals)[None] for loop in self.loops]
        if self.others:
            models.append(np.zeros((self.others.count, *models[0].shape[1:])))
            models[-1][..., self.others.places] = self.others.fly(r)
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
            impulses = self._impulses(model)
            for row, (which, k, i) in zip(out, places, strict=True):
                if which == model:
                    row[: k + 1] = impulses[:, k::-1, i].T
        return out

    def _impulses(self, model: int) -> Array:
        """Shares (nu, N, 2 nu + ny + nx) after one sample of each r."""
        if model < len(self.loops) or self.others is None:
            return self.shares(np.moveaxis(self.loops[model].impulses(), 2, 0))
        made = np.moveaxis(self.others.impulses(model - len(self.loops)), 2, 0)
        whole = np.zeros((*made.shape[:2], len(self.limits)))
        whole[..., self.others.places] = made
        return whole

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
            shares.append(self.strain * self.others.fly(r))
        top = max(1.0, *(float(np.abs(part).max()) for part in shares))
        powers = [_powers(part / top, p) for part in shares]
        total = top**-p + sum(float(power.sum()) for power, _ in powers)
        value, slope, count = np.log(top) + np.log(total) / p, np.zeros_like(r), len(self.loops)
        pull = [lower / (top * total) for _, lower in powers]
        if self.others:
            slope += self.others.pulled_back(self.strain * pull[-1])
        for loop, goal, each, lower in zip(self.loops, self.goals, flown, pull, strict=False):
            signals = self.shares_slope(lower)
            J = loop.sensitivities(each.z)
            worth, M = goal(J.T @ J)
            value += worth / count
            slope += loop.pulled_back(signals, loop.information_slope(J, M) / count)
        return float(value), slope


def _powers(share: Array, p: int) -> tuple[Array, Array]:
    """Shares to the p, a power of two, and to the p - 1: squared, which is faster than a power."""
    lower = np.where(np.abs(share) < FAINT, 0.0, share).astype(share.dtype)
    power = lower * lower
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
        task, value = task.strained(found), task.value(found)
        if value < least:
            best, least = found, value
    return best
