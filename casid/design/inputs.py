"""Design of inputs: alternatives, optimisation, prediction."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.design import signals
from casid.design.criterion import Goal, as_long, covariance
from casid.design.loop import Crowd, Feedback, Loop, UnheldError, gains
from casid.design.multisine import best_powers, schroeder, shared_out, unit_information
from casid.design.optimise import Task, improved
from casid.design.phases import least_peak
from casid.design.plan import Alternative, Design, DesignSettings, Limits
from casid.design.prior import (
    FITTED,
    GUESSED,
    check_balance,
    known_before,
    linear_at,
    noise_of,
    possible,
    without_effect,
)
from casid.design.shapes import Steps, Waves
from casid.evaluation import MatrixFunction
from casid.fit import AnyFit, Fit
from casid.free import Free, free_parameters
from casid.model import Model
from casid.nonlinear.conditions import Trim
from casid.structure.identifiability import identifiability
from casid.threads import one_thread

FEWEST = 50  # samples a stick
MOST = 100_000  # samples of a manoeuvre
COARSE = 800  # samples on which inputs are optimised
EDGE = 3.0  # samples that a switching takes; cubic, it is 1.5 times as fast as a line
UNITS = np.array([0.35, 0.5, 0.7, 1.0, 1.4])  # of a 3-2-1-1, over the usual one
FINEST = 6.0  # samples of them in a period of the band's upper edge, at least


@dataclass(frozen=True, eq=False, kw_only=True)
class _Problem:
    """All that was asked, checked, in arrays."""

    frees: tuple[Free, ...]
    R: Array
    known: Array
    limits: Array
    spread: float
    feedback: Feedback
    duration: float
    band: tuple[float, float]
    settings: DesignSettings

    def task(self, h: float) -> Task:
        """What counts on a grid of interval h [s]."""
        N = round(self.duration / h) + 1
        # Noise refers to dt: of fewer samples each counts for more.
        R = self.R * self.settings.dt / h
        loops = tuple(Loop(free, self.feedback, R, h=h, N=N) for free in self.frees)
        scale = self.frees[0].scale[self.frees[0].index]
        return Task(loops=loops, goals=self.goals([scale] * len(loops)), limits=self.limits)

    def drawn(self, h: float) -> list[Loop]:
        """Loops of models drawn from the prior, if limits may depend on their values.

        Those that the feedback does not hold, with which nothing keeps the limits, are left out.
        """
        settings, free, nu = self.settings, self.frees[0], len(self.frees[0].model.inputs)
        if not self.feedback and not np.isfinite(self.limits[2 * nu :]).any():
            return []
        made, N = [], round(self.duration / h) + 1
        for each in possible(free, self.known, self.spread, 2 * settings.draws, settings.seed):
            with suppress(UnheldError):
                made.append(Loop(each, self.feedback, self.R, h=h, N=N))
        if settings.draws and not made:
            raise ValueError(
                f"none of {2 * settings.draws} plausible aircraft, which are {self.spread:.0%} off "
                "the model, is held by the feedback given: give one that holds them, a smaller "
                "spread if the model is known better, or draws = 0, without a margin"
            )
        return made

    def goals(self, reference: Sequence[Array]) -> tuple[Goal, ...]:
        """The criterion of each model, over the standard errors (nf,) of its reference."""
        names = self.frees[0].names
        rows = np.array([names.index(name) for name in self.settings.matter or names])
        criterion, known = self.settings.criterion, self.known
        return tuple(Goal(criterion, rows, scale[rows], known) for scale in reference)


@one_thread
def design_inputs(
    model: Model | AnyFit,
    limits: Limits,
    duration: float,
    *,
    noise: Mapping[str, float] | None = None,
    feedback: Feedback | None = None,
    trim: Trim | Mapping[str, float] | None = None,
    ensemble: Sequence[Model] = (),
    settings: DesignSettings | None = None,
) -> Design:
    """Inputs that tell the parameters of a structure apart best, within limits.

    A nonlinear structure is designed for by its linearisation at a trim; everything is in
    deviations from there.

    Parameters
    ----------
    model : Model or Fit
        A structure at the values that are believed; or a fit, whose covariance is known before,
        whose residuals are the noise unless that is given, and whose standard errors say how much
        larger errors are than white residuals make them.
    limits : Limits
        Of sticks, their rates and responses.
    duration : float
        Of the manoeuvre [s].
    noise : mapping
        Standard deviation of each output's noise, a sample.
    feedback : mapping
        ``{"lat": {"p": 0.15, "phi": 0.4}}``: what holds the aircraft, u_lat = r_lat - 0.15 p - 0.4
        phi about the trim. The limits are those of u.
    trim : Trim or mapping
        Where a nonlinear structure is flown, total values of states and inputs; its reference
        condition unless given.
    ensemble : sequence of Model
        Other values that are thought possible, as from `sample_models`: the criterion is the mean
        over them and the model, and limits hold for all, beside those that are drawn.
    settings : DesignSettings
        Method, criterion, parameters that matter, sampling.

    Raises
    ------
    ValueError
        Limits that leave nothing, unknown channels, noise that is missing, a band above the Nyquist
        frequency, an unstable aircraft without its feedback, a duration too short or too long,
        rates at which no stick gets to its limit and back, a nonlinear structure that is not in
        balance at the trim.
    """
    settings = settings or DesignSettings()
    structure = model.model if isinstance(model, Fit) else model
    for each in (structure, *(ensemble if trim is None else ())):
        check_balance(each, trim)
    linear = linear_at(structure, trim)
    unfelt = without_effect(free_parameters(linear, settings.fixed))
    settings = replace(settings, fixed=(*settings.fixed, *unfelt))
    problem = _problem(linear, limits, duration, model if isinstance(model, Fit) else None, noise,
                       settings)  # fmt: skip
    believed = [free_parameters(linear_at(each, trim), settings.fixed) for each in ensemble]
    problem = replace(problem, frees=(*problem.frees, *believed), feedback=feedback or {})
    h = max(settings.dt, min(duration / COARSE, 2 * np.pi / problem.band[1] / FINEST))
    rough = problem.task(h)
    drawn = problem.drawn(h)
    if drawn:
        rough = replace(rough, others=Crowd(drawn[::2]), judges=Crowd(drawn[1::2] or drawn))
    flown = _baselines(problem, rough)
    once = _as_large(rough, _turns(problem, rough, often=False))
    # What slow parameters cost counts: the scale is one 3-2-1-1 an axis, with long rests.
    errors = [np.sqrt(np.diag(covariance(F + problem.known))) for F in rough.information(once)]
    task = replace(rough, goals=problem.goals(errors))
    if settings.method != "multisine":
        flown["steps"] = _steps(problem, task)
    if settings.method != "steps":
        flown["multisine"] = _multisine(problem, task)
    chosen = min(list(flown)[2:], key=lambda name: task.value(flown[name]))
    made = _predicted(problem, task, flown, chosen)
    blind = [f"{name}: no effect on the linearisation at the trim" for name in unfelt]
    count = 2 * settings.draws if drawn else 0
    return replace(made, plausible=count, unheld=count - len(drawn), blind=(*made.blind, *blind))


def _problem(
    structure: Model,
    limits: Limits,
    duration: float,
    fit: AnyFit | None,
    noise: Mapping[str, float] | None,
    settings: DesignSettings,
) -> _Problem:
    _check_times(duration, limits, settings)
    free = free_parameters(structure, settings.fixed)
    if unknown := [name for name in settings.matter if name not in free.names]:
        raise ValueError(f"matter names {unknown[0]!r}, which is not free: {', '.join(free.names)}")
    band = settings.band or _band(structure, duration, settings.dt)
    if band[1] > (nyquist := np.pi / settings.dt):
        raise ValueError(
            f"the band ends at {band[1]:g} rad/s, above the Nyquist frequency {nyquist:.4g} rad/s "
            f"of samples {settings.dt:g} s apart: lower it, or sample faster (dt)"
        )
    if duration - settings.rest < (least := FEWEST * settings.dt * len(structure.inputs)):
        raise ValueError(
            f"{duration:g} s less {settings.rest:g} s of rest are too short for "
            f"{len(structure.inputs)} inputs: fly longer, {settings.rest + least:.3g} s at least"
        )
    return _Problem(
        frees=(free,), R=noise_of(structure, fit, noise), known=known_before(free, fit),
        limits=_arrays(structure, limits), feedback={}, duration=duration, band=band,
        spread=settings.spread if settings.spread is not None else (FITTED if fit else GUESSED),
        settings=settings,
    )  # fmt: skip


def _check_times(duration: float, limits: Limits, settings: DesignSettings) -> None:
    """Refuse times that are none, more samples than can be worked on, changes that take too long.

    A manoeuvre has room for two changes of each stick from end to end at least.
    """
    for name, value in (("duration", duration), ("dt", settings.dt)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} = {value:g} s: expected a time above 0")
    if duration / settings.dt > MOST:
        raise ValueError(
            f"{duration:g} s have {duration / settings.dt:.3g} samples {settings.dt:g} s apart, "
            f"more than the {MOST} that a design is made of: design "
            f"{MOST * settings.dt:.4g} s at most and fly that again"
        )
    room = (duration - settings.rest) / 2
    if settings.step is not None and room > 0 and not 0 < settings.step <= room:
        raise ValueError(f"step = {settings.step:g} s: expected a time above 0, below {room:.3g} s")
    for name, rate in limits.rates.items():
        if (rise := 2 * limits.sticks[name] / rate) > room > 0:
            raise ValueError(
                f"at its rate of {rate:g} a second {name!r} takes {rise:.3g} s from one end of its "
                f"limit {limits.sticks[name]:g} to the other, and {duration:g} s have no room for "
                f"two such changes: lower the limit of the stick, to {rate * room / 2:.3g} at "
                "most, or raise that of its rate"
            )


def _band(model: Model, duration: float, dt: float) -> tuple[float, float]:
    """From two periods in the duration to three times the fastest mode."""
    fastest = float(np.abs(model.system().poles()).max())
    low = 4 * np.pi / duration
    return low, min(max(3 * fastest, 8 * low), np.pi / dt / 2)


def _arrays(model: Model, limits: Limits) -> Array:
    """Limits of sticks, rates, outputs, states in their order; infinite where there is none."""
    sides = (*model.outputs, *model.states)
    named = ((limits.sticks, model.inputs), (limits.rates, model.inputs))
    for group, known in (*named, (limits.responses, sides)):
        if unknown := [name for name in group if name not in known]:
            raise ValueError(f"limits name {unknown[0]!r}; there are {', '.join(known)}")
    if missing := [name for name in model.inputs if name not in limits.sticks]:
        raise ValueError(f"limits.sticks has no {missing[0]!r}: every input needs its limit")
    hidden = tuple(name if name not in model.outputs else "" for name in model.states)
    groups = (*named, (limits.responses, model.outputs), (limits.responses, hidden))
    return np.array([group.get(name, np.inf) for group, names in groups for name in names])


def _instants(task: Task) -> Array:
    return np.asarray(task.loops[0].h * np.arange(task.loops[0].N))


def _rise(task: Task) -> Array:
    """Time that full reversals take, (nu,) [s]: two samples, or what the rates allow."""
    return np.maximum(2 * task.loops[0].h, 2 * task.sticks / task.rates)


def _baselines(problem: _Problem, task: Task) -> dict[str, Array]:
    """What is flown without a design, as large as the limits let it be axis by axis.

    Of 3-2-1-1 of several units, unless one is given, it is what tells most in the geometric mean.
    """
    t, rest, (low, high) = _instants(task), problem.settings.rest, problem.band
    turn = (problem.duration - rest) / len(task.sticks)
    units = UNITS if problem.settings.unit is None else (1.0,)
    several = [_as_large(task, _turns(problem, task, share)) for share in units]
    told = [covariance(task.information(r)[0] + problem.known) for r in several]
    best = int(np.argmin([np.log(np.diag(C)).mean() for C in told]))
    sweeps = signals.turns_of_sweeps(t, task.sticks, rest, (max(low, 4 * np.pi / turn), high))
    return {"3-2-1-1": several[best], "sweeps": _as_large(task, sweeps)}


def _turns(problem: _Problem, task: Task, share: float = 1.0, *, often: bool = True) -> Array:
    """3-2-1-1 of a share of the unit asked for or usual, as large as the sticks may be, (N, nu)."""
    settings, (low, high) = problem.settings, problem.band
    unit = share * (settings.unit or 1.5 / np.sqrt(low * high))
    return signals.turns_of_3211(
        _instants(task), task.sticks, settings.rest, unit, _rise(task), often=often
    )


def _as_large(task: Task, r: Array) -> Array:
    """An input (N, nu), each axis alone as large as it may be, then all together."""
    alone = [task.within(r * only)[:, j] for j, only in enumerate(np.eye(r.shape[1]))]
    return task.within(np.stack(alone, axis=1))


def _steps(problem: _Problem, task: Task) -> Array:
    """Levels and switching times of all axes together, from a random square wave."""
    settings, t, h = problem.settings, _instants(task), task.loops[0].h
    step = settings.step or np.pi / 2 / problem.band[1]
    rng = np.random.default_rng(settings.seed)
    shapes = [
        Steps(t, rest=settings.rest, step=step, edge=max(EDGE * h, 1.5 * rise), size=size, rng=rng)
        for rise, size in zip(_rise(task).tolist(), task.sticks.tolist(), strict=True)
    ]
    return improved(task, shapes, settings.iterations)


def _multisine(problem: _Problem, task: Task) -> Array:
    """Powers by the convex programme, phases of least peak, then all coefficients together."""
    settings, t, nu = problem.settings, _instants(task), len(task.sticks)
    omega = signals.harmonics(problem.band, problem.duration - settings.rest)
    if len(omega) < nu:
        raise ValueError(
            f"the band has {len(omega)} harmonics of {problem.duration:g} s, fewer than {nu} "
            "inputs: widen the band or fly longer"
        )
    axis = shared_out(len(omega), nu)
    free = problem.frees[0]
    at = MatrixFunction(free)(free.guess)
    K = gains(problem.feedback, free.model.inputs, free.model.outputs)
    budget = task.sticks**2 / 2
    count = problem.duration / settings.dt
    units = count * unit_information(at, K, problem.R, omega, axis)
    p = best_powers(task.goals[0], units, axis, budget)[0]
    order, size = np.argsort(axis, kind="stable"), np.sqrt(2 * p)
    waves = [
        signals.wave_family(t, settings.rest, omega[axis == j]) * np.tile(size[axis == j], 2)
        for j in range(nu)
    ]
    phases = least_peak(task, waves, schroeder(p, axis)[order])
    parts = np.split(phases, np.cumsum(np.bincount(axis, minlength=nu))[:-1])
    shapes = [Waves(*each) for each in zip(waves, parts, task.sticks.tolist(), strict=True)]
    return improved(task, shapes, settings.iterations)


def _predicted(problem: _Problem, rough: Task, flown: Mapping[str, Array], chosen: str) -> Design:
    """Standard errors of all alternatives at the records' own sampling, and the value."""
    fine = problem.task(problem.settings.dt)
    t, coarse, exact = _instants(fine), _instants(rough), {}
    for name, each in flown.items():
        r = rough.within(each)
        r = np.stack([np.interp(t, coarse, column) for column in r.T], axis=1)
        exact[name] = r / max(1.0, float(fine.peaks(r).max()))
    spread = {name: covariance(fine.information(r)[0] + problem.known) for name, r in exact.items()}
    r = exact[chosen]
    usual = fine.information(exact["3-2-1-1"])[0]
    rest = problem.settings.rest
    longer = as_long(usual, problem.known, np.sqrt(np.diag(spread[chosen])))
    seen = fine.loops[0].fly(r)
    model = problem.frees[0].model
    share = fine.peaks(r)
    at_most = np.maximum(share, rough.peaks(np.stack([np.interp(coarse, t, x) for x in r.T], 1)))
    before = np.diag(problem.known)
    known = np.where(before > 0, np.sqrt(np.diag(covariance(problem.known))), np.inf)
    made = Design(
        kind=chosen, inputs=model.inputs, outputs=model.outputs, t=t, r=r, u=seen.u, y=seen.y,
        names=problem.frees[0].names, covariance=spread[chosen], before=known,
        alternatives=tuple(
            Alternative(name=name, std_errors=np.sqrt(np.diag(C))) for name, C in spread.items()
        ),
        used=_named(model, share), used_at_worst=_named(model, at_most),
        instead=rest + longer * (problem.duration - rest),
    )  # fmt: skip
    judged = identifiability(model, made.record(), fixed=problem.settings.fixed, spread=0.0)
    return replace(made, blind=tuple(str(judged).splitlines()[1:]))


def _named(model: Model, shares: Array) -> dict[str, float]:
    """Shares of limits by name, where there is a limit."""
    rates = [f"{name} rate" for name in model.inputs]
    names = [*model.inputs, *rates, *model.outputs, *model.states]
    return {name: share for name, share in zip(names, shares.tolist(), strict=True) if share > 0}
