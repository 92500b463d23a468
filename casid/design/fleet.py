"""Plausible aircraft of a nonlinear structure, each flown from a trim of its own.

A trim depends on the values, too: it is the balance nearest to that of the design at the same
airspeed, the rest moved by as little as it takes; any airspeed, where there is none at that.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, BoolArray
from casid.design.criterion import KEPT
from casid.design.loop import ALONE, GROWN, GROWTH, Feedback, gains
from casid.design.motion import Motion
from casid.design.optimise import Task
from casid.nonlinear.balance import DETERMINED, balance_function, move_sizes
from casid.nonlinear.conditions import BALANCE
from casid.nonlinear.coverage import airspeeds
from casid.nonlinear.expressions import resting
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import OUT_OF_BALANCE

ROUNDS = 30  # of Newton's method
STRIDE = 0.3  # of a step of it, in sizes, at most
PULSE = 1e-4  # share of the sticks' limits after which a loop is seen to be stable or not
NEAR = 0.8  # of the share that decides, from which on another aircraft may
FAR = 1e6  # share of a limit that stands for running away


class Fleet:
    """Aircraft in their loops: those of a structure's other values that have a trim and are held.

    ``asked`` are the aircraft, of one class, z (nx + nu,) the states and inputs of the design's
    trim; task has the sampling and the limits. Integration takes so many ``parts`` an interval.
    """

    def __init__(
        self,
        asked: Sequence[NonlinearModel],
        z: Array,
        feedback: Feedback,
        task: Task,
        parts: int,
    ) -> None:
        model, self._task = asked[0], task
        self._K = gains(feedback, model.inputs, model.outputs)
        delays = [
            np.array([float(each.delays().get(name, 0.0)) for name in model.inputs])
            for each in asked
        ]
        h, N, longest = task.loops[0].h, task.loops[0].N, float(np.max(delays))
        self._motion = Motion(model, self._K, h=h, N=N, parts=parts, longest=longest)
        balance = Balances(model, z)
        self._places, self.untrimmed, self.unheld = [], 0, 0
        for each, tau in zip(asked, delays, strict=True):
            lam = each.vector()
            if (own := balance.nearest(lam)) is None:
                self.untrimmed += 1
            elif self._held(place := self._motion.place(own, lam, tau), balance.growth(own, lam)):
                self._places.append(place)
            else:
                self.unheld += 1
        self.count = len(self._places)

    def _held(self, place: Array, growth: float) -> bool:
        """Whether an aircraft with such a fastest growing mode is held, as a linear one is."""
        folds = growth * self._motion.h * (self._motion.N - 1)
        if not self._K.any():
            return folds <= ALONE
        if folds > GROWTH:
            return False
        r, nu = np.zeros((self._motion.N, self._K.shape[0])), self._K.shape[0]
        r[1] = PULSE * self._task.sticks
        u = np.abs(self._motion.fly(place, r)[:, :nu] / self._task.sticks)
        last = 4 * len(u) // 5
        return bool(u[last:].max() <= GROWN * u[:last].max() < np.inf)

    def peaks(self, r: Array, among: BoolArray | None = None) -> Array:
        """Largest shares of the limits (M, n) of all or some aircraft; FAR of what runs away."""
        chosen = np.arange(self.count) if among is None else np.flatnonzero(among)
        flown = (self._motion.fly(self._places[k], r) for k in chosen.tolist())
        with np.errstate(all="ignore"):  # of what runs away
            most = np.array([np.abs(self._task.shares(each)).max(axis=0) for each in flown])
        return np.asarray(np.nan_to_num(most, nan=FAR, posinf=FAR).clip(max=FAR))

    def used(self, r: Array) -> Array:
        """Largest shares (n,) of those nine in ten that use least of what they use most."""
        most = self.peaks(r)
        hardest = most.max(axis=1)
        return np.asarray(most[hardest <= np.quantile(hardest, KEPT)].max(axis=0))


class Watch:
    """The share that nine in ten of a fleet stay below after c r.

    Only those that may come to decide it are flown every time; what others reached when they were
    flown last is taken to go as c does, until `all` are.
    """

    def __init__(self, fleet: Fleet, r: Array) -> None:
        self._fleet, self._r = fleet, r
        self._most, self._c = np.zeros((2, fleet.count))

    def all(self, c: float) -> float:
        """All are flown."""
        return self._flown(c, np.full(self._fleet.count, True))

    def some(self, c: float) -> float:
        """Those that may decide are flown; `all` were before."""
        level = float(np.quantile(self._most * c / self._c, KEPT))
        while (among := (self._most * c / self._c >= NEAR * level) & (self._c != c)).any():
            level = self._flown(c, among)
        return level

    def _flown(self, c: float, among: BoolArray) -> float:
        self._most[among], self._c[among] = self._fleet.peaks(c * self._r, among).max(axis=1), c
        return float(np.quantile(self._most * c / self._c, KEPT))


class Balances:
    """Where a structure is in balance at other values of its parameters."""

    def __init__(self, model: NonlinearModel, z: Array) -> None:
        names = (*model.states, *model.inputs)
        self._z, self._nx = z, len(model.states)
        self._function, acts = balance_function(model)
        self._rows, at = resting(model.equations()), dict(zip(names, z.tolist(), strict=True))
        self._size, held = move_sizes(model, at), airspeeds(model, names)
        self._free = [acts & ~np.isin(names, held), *([acts] if held else [])]

    def nearest(self, lam: Array) -> Array | None:
        """States and inputs (nx + nu,) of the balance at λ, if any; see the module."""
        found = (self._newton(lam, free) for free in self._free)
        return next((each for each in found if each is not None), None)

    def _newton(self, lam: Array, free: BoolArray) -> Array | None:
        z, size, f = self._z.copy(), self._size[free], np.zeros(0)
        for _ in range(ROUNDS):
            f, J = (part.full()[self._rows] for part in self._function(z, lam))
            if not (np.isfinite(f).all() and np.isfinite(J).all()):
                return None
            if np.abs(f).max(initial=0.0) < BALANCE:
                return z
            step = np.linalg.lstsq(J[:, free] * size, -f.ravel(), rcond=DETERMINED)[0]
            z[free] += size * step / max(1.0, float(np.abs(step).max()) / STRIDE)
        return z if np.abs(f).max() <= OUT_OF_BALANCE else None

    def growth(self, z: Array, lam: Array) -> float:
        """Real part [1/s] of the mode that grows fastest about a balance."""
        A = self._function(z, lam)[1].full()[:, : self._nx]
        return float(np.linalg.eigvals(A).real.max()) if np.isfinite(A).all() else np.inf
