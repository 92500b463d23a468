"""A card flown in the nonlinear structure that it was designed for, in its loop.

Beside the structure at the values that are believed its limits hold for other plausible aircraft,
each flown in the nonlinear structure, too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from casid.arrays import Array
from casid.design.fleet import Balances, Fleet, Watch
from casid.design.loop import Feedback, gains
from casid.design.motion import Motion
from casid.design.nonlinear_information import Flown
from casid.design.optimise import Task
from casid.design.prior import condition, possible
from casid.design.problem import JUDGES, Problem
from casid.evaluation import MatrixFunction
from casid.free import Free
from casid.model import Model
from casid.nonlinear.conditions import Trim
from casid.nonlinear.model import NonlinearModel

REACH = 0.5  # of the fastest mode times a step of the integration, at most
LEAST, MOST = 4, 100  # steps of it a sample: lines break within one, where delays have them do so
FEWEST = 2  # of plausible aircraft, many of which are flown
ROUNDS = 40  # of making a card smaller
SAFE = 1e-3  # by which it is made smaller than it needs to be, so that rounds end
CLOSE = 0.01  # share of a limit that may be left
HALF = 2.0  # a card that is further beyond its limits, or runs away, is halved first
INSIDE = 0.1  # of what is between a card that is too large and one that is not, from either


class Flight:
    """A nonlinear structure in its loop from a trim, sampled N times every h seconds.

    ``free`` are the parameters of its linearisation there, whose modes and delays count.
    """

    def __init__(
        self,
        model: NonlinearModel,
        trim: Trim | Mapping[str, float] | None,
        free: Free,
        feedback: Feedback,
        task: Task,
    ) -> None:
        at, (h, N) = MatrixFunction(free)(free.guess), (task.loops[0].h, task.loops[0].N)
        self.z, nx = total(model, trim), len(model.states)
        K = gains(feedback, model.inputs, model.outputs)
        self._fastest = float(np.abs(np.linalg.eigvals(at.blocks[0])).max())
        parts, longest = _parts(self._fastest * h, LEAST), float(at.tau.max())
        self._motion = Motion(model, K, h=h, N=N, parts=parts, longest=longest)
        self._place = self._motion.place(self.z, model.vector(), at.tau)
        y0 = model.equations()(*np.split(self.z, [nx]), model.vector())[1].full().ravel()
        self._free = replace(free, model=model)
        self._values = np.concatenate([self.z[nx:], y0, self.z[:nx]])
        self._t, self._task = h * np.arange(N), task
        self._beside: list[Flight] = []
        self._coarse, self._feedback = self._t, feedback
        self.fleet: Fleet | None = None

    def join(self, beside: Sequence["Flight"], drawn: Sequence[NonlinearModel], task: Task) -> None:
        """Other aircraft have to keep the limits, too: all beside, nine in ten of those drawn.

        These are sampled as of the task.
        """
        self._beside, (h, N) = list(beside), (task.loops[0].h, task.loops[0].N)
        if drawn:
            self._coarse, parts = h * np.arange(N), _parts(self._fastest * h, FEWEST)
            self.fleet = Fleet(drawn, self.z, self._feedback, task, parts)

    def fly(self, r: Array) -> Array:
        """Sticks, outputs and states (N, nu + ny + nx), in deviations, after a designed input r."""
        return self._motion.fly(self._place, r)

    def shares(self, r: Array) -> Array:
        """Largest shares of the limits (2 nu + ny + nx,); infinite where the flight runs away."""
        most = np.abs(self._task.shares(self.fly(r))).max(axis=0)
        return np.where(np.isfinite(most), most, np.inf)

    def used(self, r: Array) -> Array:
        """The same of all aircraft, of those drawn of the nine in ten that limits are kept with."""
        every = [each.shares(r) for each in (self, *self._beside)]
        if self.fleet:
            every.append(self.fleet.used(self._resampled(r)))
        return np.asarray(np.max(every, axis=0))

    def _resampled(self, r: Array) -> Array:
        return np.stack([np.interp(self._coarse, self._t, x) for x in r.T], axis=1)

    @property
    def trim(self) -> dict[str, float]:
        """Total values of states, inputs and outputs."""
        model, (nu, ny) = self._free.model, (len(self._free.model.inputs), self._task.loops[0].ny)
        u, y, x = np.split(self._values, [nu, nu + ny])
        pairs = (model.states, x), (model.inputs, u), (model.outputs, y)
        return {n: v for names, own in pairs for n, v in zip(names, own.tolist(), strict=True)}

    def flown(self, r: Array) -> Flown:
        """The flight after r as output error sees it."""
        nu, ny = len(self._free.model.inputs), self._task.loops[0].ny
        parts = np.split(self._values + self.fly(r), [nu, nu + ny], axis=1)
        return Flown(self._free, self._t, *parts)

    def within(self, r: Array) -> Array:
        """An input that keeps the limits in the linearisation, as small as it takes here."""
        watch = Watch(self.fleet, self._resampled(r)) if self.fleet else None
        if (share := self._most(r, 1.0, watch.all if watch else None)) <= 1.0:
            return r
        high, low = (1.0, share), (0.0, 0.0)
        for _ in range(ROUNDS):
            c = _between(low, high)
            share = self._most(c * r, c, watch.some if watch else None)
            if share <= 1.0 and _near(c, share, high) and watch:
                share = self._most(c * r, c, watch.all)
            if share > 1.0:
                high, low = (c, share), low if low[0] < c else (0.0, 0.0)
            elif _near(c, share, high):
                return c * r
            else:
                low = c, share
        raise ValueError(
            "the nonlinear structure diverges after inputs of any size, though its linearisation "
            "at the trim does not: check its equations there, or design for model.at(trim)"
        )

    def _most(self, r: Array, c: float, of_fleet: Callable[[float], float] | None) -> float:
        """The largest share of a limit after r, of a fleet that is watched after the factor c."""
        most = max(float(each.shares(r).max()) for each in (self, *self._beside))
        return max(most, of_fleet(c)) if of_fleet else most


def total(model: NonlinearModel, trim: Trim | Mapping[str, float] | None) -> Array:
    """States and inputs (nx + nu,) of a trim."""
    values = condition(model, trim).values
    return np.array([values[name] for name in (*model.states, *model.inputs)])


def _parts(reach: float, least: int) -> int:
    """Steps of the integration in a sample in which the fastest mode gets that far."""
    return int(np.clip(np.ceil(reach / REACH), least, MOST))


def _near(c: float, share: float, high: tuple[float, float]) -> bool:
    """Whether a card that is small enough is as large as one may be, or the next is too large."""
    return share >= 1.0 - CLOSE or c > high[0] * (1.0 - CLOSE)


def _between(low: tuple[float, float], high: tuple[float, float]) -> float:
    """What to try between a factor that is too large and one that is not, with their shares."""
    (a, least), (b, most) = low, high
    if not a:
        return b / min(HALF, most + SAFE)
    wanted = -CLOSE / 2  # of the logarithm, as good as a power between the two
    part = (wanted - np.log(least)) / (np.log(min(most, HALF)) - np.log(least))
    return float(a + (b - a) * np.clip(part, INSIDE, 1.0 - INSIDE))


def flight_of(
    structure: Model,
    trim: Trim | Mapping[str, float] | None,
    problem: Problem,
    ensemble: Sequence[Model],
    *,
    draw: bool,
) -> Flight | None:
    """A nonlinear structure in its loop, at the records' own sampling, with other aircraft.

    None of a linear one, and where the trim has unknowns. ValueError: no other aircraft is held.
    """
    if not isinstance(structure, NonlinearModel) or (isinstance(trim, Trim) and trim.unknown):
        return None
    settings, feedback = problem.settings, problem.feedback
    task = problem.task(settings.interval)
    made = Flight(structure, trim, problem.frees[0], feedback, task)
    beside = []
    for other, free in zip(ensemble, problem.frees[1:], strict=True):
        z = total(other := cast(NonlinearModel, other), trim)
        own = Balances(other, z).nearest(other.vector())
        names = (*structure.states, *structure.inputs)
        values = dict(zip(names, (z if own is None else own).tolist(), strict=True))
        beside.append(Flight(other, values, free, feedback, task))
    count, spread = JUDGES * settings.draws * draw, problem.spread
    others = possible(
        replace(problem.frees[0], model=structure), problem.known, spread, count, count
    )
    made.join(
        beside,
        [cast(NonlinearModel, each.model) for each in others],
        problem.task(problem.coarse()),
    )
    if made.fleet and not made.fleet.count:
        held = "held by the feedback given" if feedback else "held, without feedback"
        raise ValueError(
            f"none of {count} plausible aircraft, which are {spread:.0%} off the model, has a "
            f"trim of its own, in which it is {held}: give a feedback that holds them, a smaller "
            "spread if the model is known better, or draws = 0, without a margin"
        )
    return made
