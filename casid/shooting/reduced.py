"""Output and filter error over the parameters alone: biases and initial states follow them.

What records hardly tell of an initial state and a bias (the offset of a slow mode is nearly a bias)
is multiplied by parameters in the model, so that steps in all variables at once are cut to nothing.
Here every λ has its most likely biases and nodes, the intervals meeting (variable projection: Golub
and Pereyra 1973), and what remains is well conditioned: steps minimise its quadratic model within
bounds and ties, damped as far as the model is wrong (Levenberg 1944, Marquardt 1963; Nielsen 1999).
The end is where an undamped step would gain next to nothing of the likelihood, which no damping and
no scale of the parameters changes (Bates and Watts 1981).
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import scipy
import scipy.linalg

from casid.arrays import Array, BoolArray
from casid.nlp import Progress, Solution, SolverOptions
from casid.shooting.newton import MEET, Newton
from casid.shooting.precision import quadratic_model, unknown_names
from casid.shooting.programme import Programme
from casid.shooting.warm_start import MANY, QUADRATIC, STATED, step

HALF = 0.25  # of log-likelihood, a sample of an output, by which half of its variance goes
SPARE = 1.5  # times what a quadratic model says, that may be gained
LAST = 1e-6  # and where steps end, unless none of the last few has gained as much
IDLE = 5
LATER = 100  # steps, at most
SETTLING, SETTLED = 24, 1e-7  # solves for the biases and nodes of one λ; what the last may gain
SHORTER = 6  # times that a solve's step is halved, at most
CLOSED = 1e-7  # gaps, in units of unit curvature
DAMPING, MOST = 1e-3, 1e6  # of the parameters' own information: the first one, and the last
WELL, LESS = 0.25, 0.2  # share of the gain expected that lets damping fall, and to what at least
CONVEX = 1.5  # times the damping that just makes the model convex
TOUCHES = 1e-6  # from a bound, in units of unit curvature
UNTOLD = (
    "the records do not determine {}, at least not where the search ended (singular information "
    "matrix): fix or tie some of them, or start nearer"
)
NONE = 1e-12  # information of a parameter that has none, of the largest


@dataclass(frozen=True, eq=False)
class _Model:
    """The cost about a λ with biases and nodes that follow."""

    form: Array  # (nf + 1, nf + 1): the cost is half this form of [d; 1], up to a constant
    follow: Array  # biases, nodes and the continuity's multipliers by [d; 1]

    def gain(self, d: Array) -> float:
        """What a step (nf,) gains."""
        return -float(d @ self.form[:-1, :-1] @ d / 2 + d @ self.form[:-1, -1])


@dataclass(frozen=True, eq=False)
class _Place:
    """A λ with its most likely biases and nodes."""

    x: Array  # scaled variables
    cost: float  # of all observations
    gauss: _Model
    newton: _Model  # with second derivatives
    floor: float  # damping that makes Newton's convex; 0 if it is


@dataclass(frozen=True, eq=False)
class _Step:
    """A step of λ, what it should gain, and multipliers per observation."""

    x: Array  # scaled variables where it leads
    gain: float
    bounds: Array
    constraints: Array  # the continuity's, then the model's own


def completed(
    programme: Programme,
    start: Array,
    last: Solution,
    options: SolverOptions,
    stage: str,
    enough: float = LAST,
) -> Solution:
    """What IPOPT has found, or what steps of the parameters alone find from there.

    They go on where it stopped early, from the ``start`` if λ was better there or it cannot be gone
    on from, and where an undamped step would still gain: scales of the variables may have ended it
    too soon. They end where such a step gains less than ``enough``.
    """
    count = min(LATER, options.max_iterations - last.iterations)
    left = replace(options, max_iterations=max(count, 1), ipopt={})
    reduced = Reduced(programme, left, stage, enough)
    gain = reduced.gain(last.x) if last.success and count > 0 else np.inf
    if count < 1 or not gain > STATED:
        return last
    ways = [last.x, start]
    if not last.success:  # costs before biases and nodes follow tell little of open intervals
        ways.sort(key=lambda x: reduced.cost(x, STATED))
    found = reduced.run(ways[0]) or reduced.run(ways[1])
    if found is None and last.success and gain == np.inf:
        names = ", ".join(unknown_names(programme))
        return replace(last, success=False, status=UNTOLD.format(names))
    if found is None or (last.success and not programme.n * (last.f - found.f) > STATED):
        return last
    if not found.success and reduced.meet(last.x) and not found.f < last.f:
        return last
    return replace(
        found, iterations=found.iterations + last.iterations, seconds=found.seconds + last.seconds
    )


class Reduced:
    """Damped steps of λ, a filter's unknowns among them, in one programme."""

    def __init__(
        self, programme: Programme, options: SolverOptions, stage: str, enough: float = LAST
    ) -> None:
        self.programme, self.options, self.stage, self.enough = programme, options, stage, enough
        self._newton = Newton(programme)
        self._quiet = replace(options, progress=None, max_iterations=MANY, ipopt=QUADRATIC)
        self._nf = programme.evaluator.nf
        self.gaps = len(programme.links) * programme.evaluator.nx

    def meet(self, x: Array) -> bool:
        """Whether the intervals meet at scaled variables."""
        return bool(np.abs(self.programme.values(x).g[: self.gaps]).max(initial=0.0) < MEET)

    def gain(self, x: Array) -> float:
        """Log-likelihood that Gauss-Newton's step from scaled variables would gain, in bounds.

        Infinite where the model is singular, NaN where its best step is not found.
        """
        model = self._gauss(x)
        if model is None:
            return np.inf
        found = step(self.programme, x, model.form, self._quiet)
        return model.gain(found.x) - model.form[-1, -1] / 2 if found.success else np.nan

    def least(self, x: Array) -> float:
        """Of all observations the cost below which steps from scaled variables surely do not lead.

        The quadratic model tells, but for half as much: where that takes half of a variance,
        n/2 log R falls by 1.4 times as much. Where it takes more, nothing is sure.
        """
        programme, noise = self.programme, self.programme.noise
        if not (programme.evaluator.curved and (noise.concentrated or noise.given is not None)):
            return -np.inf
        gain, seen = self.gain(x), noise.patterns.T @ noise.counts
        if noise.given is None and not gain < HALF * seen[seen > 0].min():
            return -np.inf
        return programme.n * programme.values(x).cost - SPARE * gain

    def run(self, x: Array) -> Solution | None:
        """Where steps from scaled variables end; None if biases and nodes are not found there."""
        begin, place = time.perf_counter(), self._settled(x)
        damping, rise, idle = 0.0, 2.0, 0
        for iteration in range(self.options.max_iterations):
            free = (
                None
                if place is None
                else self._step(place, place.newton if place.floor == 0 else place.gauss, 0.0)
            )
            if place is None or free is None:
                return None
            seconds = self._tell(iteration, place, begin)
            if free.gain < (STATED if idle == IDLE else self.enough):
                return self._solution(place, free, iteration, seconds, "solved")
            late = seconds > self.options.max_seconds
            if late or damping > MOST or iteration == self.options.max_iterations - 1:
                status = "solved" if free.gain < STATED else self._why(late, damping)
                return self._solution(place, free, iteration, seconds, status)
            taken: _Step | None = free
            if damping + place.floor > 0:
                taken = self._step(place, place.newton, max(damping, place.floor))
            trial = None if taken is None else self._settled(taken.x)
            share = -1.0
            if taken is not None and trial is not None and taken.gain > 0:
                share = (place.cost - trial.cost) / taken.gain
            if share < WELL:
                damping, rise = max(rise * max(damping, place.floor), DAMPING), 2 * rise
            else:
                fall = max(LESS, 1 - (2 * min(share, 1.0) - 1) ** 3)
                damping, rise = damping * fall * (damping > DAMPING / 100), 2.0
            best = trial if trial is not None and trial.cost < place.cost else place
            idle, place = 0 if best.cost < place.cost - LAST else min(idle + 1, IDLE), best
        return None

    def _why(self, late: bool, damping: float) -> str:
        """Why steps ended without success."""
        if damping > MOST:
            return "no step lowers the cost, though the slope says that one should; start nearer"
        if not late and self.options.max_iterations == LATER:
            return f"no end within {LATER} steps of the parameters alone; start nearer"
        what = ("time", "max_seconds") if late else ("iteration", "max_iterations")
        return f"{what[0]} limit reached; raise {what[1]} or start nearer"

    def cost(self, x: Array, gain: float) -> float:
        """Of all observations at the λ of x, biases and nodes following but for a last ``gain``.

        Infinite where they are not found.
        """
        found = self._followed(x, gain)
        return np.inf if found is None else self.programme.n * self.programme.values(found[0]).cost

    def _settled(self, x: Array) -> _Place | None:
        """λ with its most likely biases and nodes; None if they are not found."""
        found = self._followed(x, SETTLED)
        return None if found is None else self._curved(*found)

    def _followed(self, x: Array, gain: float) -> tuple[Array, _Model] | None:
        """Variables with biases and nodes that can gain so little, and the model of the cost."""
        programme = self.programme
        for _ in range(SETTLING):
            values = programme.values(x)
            model = self._gauss(x) if np.isfinite(values.cost) else None
            if model is None:
                return None
            open_by = np.abs(values.g[: self.gaps]).max(initial=0.0)
            if open_by < CLOSED and -model.form[-1, -1] / 2 < gain:
                return x, model
            x = self._nearer(x, model)
        return None

    def _nearer(self, x: Array, model: _Model) -> Array:
        """Variables after a step of biases and nodes, λ held, that gains as much as it should.

        Where outputs bend more than Gauss-Newton knows, whole steps may pass over the minimum and
        back for ever: the augmented Lagrangian has to fall by a share of what its slope says.
        """
        programme, gaps = self.programme, self.gaps
        prices = model.follow[len(model.follow) - gaps :, -1] / programme.n

        def merit(x: Array) -> float:
            values = programme.values(x)
            c = values.g[:gaps]
            return float(values.cost + prices @ c + c @ c / 2)

        d, c = self._moved(x, np.zeros(self._nf), model) - x, programme.values(x).g[:gaps]
        now, slope = merit(x), float(programme.gradient(x) @ d - prices @ c - c @ c)
        for _ in range(SHORTER):
            if merit(x + d) <= now + WELL * slope:
                break
            d, slope = d / 2, slope / 2
        return np.asarray(x + d)

    def _gauss(self, x: Array) -> _Model | None:
        """Gauss-Newton's model of the cost; None where a filter's covariance is none."""
        try:
            upper = self.programme.hessian_matrix(x)
        except np.linalg.LinAlgError:  # far out, by a step too long
            return None
        return self._model(x, upper + scipy.sparse.triu(upper, 1).T)

    def _model(self, x: Array, hessian: scipy.sparse.sparray) -> _Model | None:
        """Quadratic model of the cost with a Hessian; None if it is singular."""
        try:
            form, follow = quadratic_model(self.programme, x, hessian)
        except (RuntimeError, np.linalg.LinAlgError):  # an exactly singular factor
            return None
        return _Model(form, follow) if np.isfinite(form).all() else None

    def _curved(self, x: Array, gauss: _Model) -> _Place:
        """The place with second derivatives, and what it takes to make them convex."""
        values = self.programme.values(x)
        cost, prices = self.programme.n * values.cost, np.zeros(len(values.g))
        prices[: self.gaps] = gauss.follow[len(gauss.follow) - self.gaps :, -1] / self.programme.n
        exact = self._model(x, self._newton.matrix(x, prices))
        if exact is None:
            return _Place(x, cost, gauss, gauss, 0.0)
        own = np.flatnonzero(~self._held(x[: self._nf], gauss.form[:-1, -1]))
        unit = 1 / np.sqrt(_information(gauss)[own])
        least = scipy.linalg.eigvalsh(exact.form[np.ix_(own, own)] * np.outer(unit, unit))
        return _Place(x, cost, gauss, exact, max(0.0, -CONVEX * float(least.min(initial=0.0))))

    def _held(self, lam: Array, gradient: Array) -> BoolArray:
        """Which scaled unknowns are on a bound that they press on, (nf,)."""
        lower, upper = self.programme.limits()[0]
        low, high = lam - lower < TOUCHES, upper - lam < TOUCHES
        return np.asarray((low & (gradient > 0)) | (high & (gradient < 0)))

    def _step(self, place: _Place, model: _Model, damping: float) -> _Step | None:
        """The best step of a model, damped by a multiple of the parameters' information."""
        form, at = model.form.copy(), np.arange(self._nf)
        form[at, at] += damping * _information(place.gauss)
        found = step(self.programme, place.x, form, self._quiet)
        if not found.success:
            return None
        follow = model.follow @ np.append(found.x, 1.0)
        continuity = follow[len(follow) - self.gaps :] / self.programme.n
        bounds = np.zeros(len(place.x))
        bounds[: self._nf] = found.multipliers_x
        constraints = np.concatenate([continuity, found.multipliers_g])
        x = self._moved(place.x, found.x, model)
        return _Step(x, model.gain(found.x), bounds, constraints)

    def _moved(self, x: Array, d: Array, model: _Model) -> Array:
        """Scaled variables after a step of λ, biases and nodes following."""
        return np.asarray(x + np.append(d, (model.follow @ np.append(d, 1.0))[: len(x) - self._nf]))

    def _tell(self, iteration: int, place: _Place, begin: float) -> float:
        """Seconds since the beginning, told with progress."""
        seconds, cost = time.perf_counter() - begin, place.cost / self.programme.n
        if self.options.progress is not None:
            told = Progress(stage=self.stage, iteration=iteration, cost=cost, seconds=seconds)
            self.options.progress(told)
        return seconds

    def _solution(
        self, place: _Place, last: _Step, iterations: int, seconds: float, status: str
    ) -> Solution:
        values = self.programme.values(place.x)
        return Solution(
            x=place.x, f=values.cost, g=values.g, multipliers_x=last.bounds,
            multipliers_g=last.constraints, success=status == "solved", status=status,
            iterations=iterations, seconds=seconds,
        )  # fmt: skip


def _information(gauss: _Model) -> Array:
    """Of every parameter, the others known, (nf,); never quite none."""
    alone = np.diag(gauss.form)[:-1]
    return np.asarray(np.maximum(alone, NONE * max(float(alone.max(initial=0.0)), 1e-300)))
