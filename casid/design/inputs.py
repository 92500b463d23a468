"""Design of inputs: alternatives, optimisation, prediction."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.design import signals
from casid.design.criterion import as_long, covariance
from casid.design.feedback_noise import deviations, peak
from casid.design.fleet import Fleet
from casid.design.flight import Flight, flight_of
from casid.design.loop import Crowd, Feedback, gains
from casid.design.multisine import best_powers, schroeder, shared_out, unit_information
from casid.design.optimise import Task, improved
from casid.design.phases import least_peak
from casid.design.plan import Alternative, Design
from casid.design.prior import (
    as_fitted,
    check_balance,
    inside,
    known_before,
    linear_at,
    without_effect,
)
from casid.design.problem import JUDGES, Problem, free_of, problem_of
from casid.design.shapes import Steps, Waves
from casid.design.specification import DesignSettings, Limits
from casid.display import listed
from casid.errors import warn
from casid.evaluation import MatrixFunction
from casid.fit import AnyFit, Fit
from casid.free import Free, free_parameters
from casid.model import Model
from casid.nonlinear.conditions import Trim
from casid.nonlinear.model import NonlinearModel
from casid.structure.identifiability import Identifiability, judged
from casid.threads import one_thread

EDGE = 2.0  # samples that a switching takes; cubic, it is 1.5 times as fast as a line
UNITS = np.array([0.35, 0.5, 0.7, 1.0, 1.4])  # of a 3-2-1-1, over the usual one


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
    deviations from there. What is designed is then flown in the nonlinear structure itself, in its
    loop, and made smaller until limits hold there, too, with other values, each in its own trim;
    what is predicted, and all standard errors, are those of this flight. Where the trim has
    unknowns they are those of the linearisation.

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
        Limits that leave nothing, unknown channels, values outside their bounds, parameters that
        matter but that nothing tells, noise that is missing, a band above the Nyquist
        frequency, an unstable aircraft without its feedback, a duration too short or too long,
        rates at which no stick gets to its limit and back, a nonlinear structure that is not in
        balance at the trim.
    """
    fit = model if isinstance(model, Fit) else None
    settings = as_fitted(settings or DesignSettings(), fit)
    structure = model.model if isinstance(model, Fit) else model
    check_balance(structure, trim)
    linear = linear_at(structure, trim)
    free = inside(free_parameters(linear, settings.fixed or (), settings.bounds))
    settings = _of_what_is_felt(structure, free, settings)
    problem = problem_of(linear, limits, duration, fit, noise, settings)
    believed = [
        _believed(structure, each, f"ensemble[{number}]", trim, settings)
        for number, each in enumerate(ensemble)
    ]
    problem = replace(problem, frees=(*problem.frees, *believed), feedback=feedback or {})
    rough = problem.task(h := problem.coarse())
    drawn = problem.drawn(h)
    rough = replace(rough, others=drawn.get("others"), judges=drawn.get("judges"))
    flown = _baselines(problem, rough)
    once = _as_large(rough, _turns(problem, rough, often=False))
    # What slow parameters cost counts: the scale is one 3-2-1-1 an axis, with long rests.
    every = [F + problem.known for F in rough.information(once)]
    problem = replace(problem, told=problem.tellable(every[0]))
    errors = [np.sqrt(np.diag(covariance(F))) for F in every]
    task = replace(rough, goals=problem.goals(errors))
    if settings.method != "multisine":
        flown["steps"] = _steps(problem, task)
    if settings.method != "steps":
        flown["multisine"] = _multisine(problem, task)
    chosen = min(list(flown)[2:], key=lambda name: task.value(flown[name]))
    stated = problem.of_all(free, known_before(free, fit))
    flight = flight_of(structure, trim, stated, ensemble, draw=bool(drawn))
    made = _stated(structure, flight, stated, task, flown, chosen)
    return _with_margin(made, problem, drawn.values(), flight.fleet if flight else None)


def _with_margin(
    made: Design, problem: Problem, crowds: Collection[Crowd], fleet: Fleet | None
) -> Design:
    """The value with the plausible aircraft of which it speaks; of a fleet, which go further."""
    draws, lost = problem.settings.draws, 0
    if fleet:
        count, unheld, lost = JUDGES * draws, fleet.unheld, fleet.untrimmed
    else:
        count = (1 + JUDGES) * draws if crowds else 0
        unheld = count - sum(crowd.count for crowd in crowds)
    return replace(made, plausible=count, unheld=unheld, untrimmed=lost, spread=problem.spread)


def _of_what_is_felt(structure: Model, free: Free, settings: DesignSettings) -> DesignSettings:
    """Settings that hold what has no effect on that by which inputs are optimised.

    ValueError: it is to matter.
    """
    unfelt = without_effect(free)
    if lost := [name for name in settings.matter if name in unfelt]:
        nonlinear = isinstance(structure, NonlinearModel)
        where = "of the linearisation at the trim, by which inputs are optimised," * nonlinear
        elsewhere = ", or design at another trim" * nonlinear
        raise ValueError(
            f"matter: no matrix and no delay {where or 'of the structure'} depends on "
            f"{lost[0]!r}: leave it out{elsewhere}"
        )
    return replace(settings, fixed=(*(settings.fixed or ()), *unfelt))


def _believed(
    structure: Model,
    other: Model,
    place: str,
    trim: Trim | Mapping[str, float] | None,
    settings: DesignSettings,
) -> Free:
    """The free parameters of a member of the ensemble, by whose place errors are told."""
    if not isinstance(other, type(structure)):
        raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
            f"{place} is a {type(other).__name__}; expected other values of the structure that is "
            f"designed for, {type(structure).__name__}"
        )
    try:
        if trim is None:
            check_balance(other, trim)
        return inside(free_of(linear_at(other, trim), settings))
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error


def _instants(task: Task) -> Array:
    return np.asarray(task.loops[0].h * np.arange(task.loops[0].N))


def _rise(task: Task, samples: float = 2.0) -> Array:
    """Time that full reversals take, (nu,) [s]: so many samples, or what the rates allow."""
    return np.maximum(samples * task.loops[0].h, 2 * task.sticks / task.rates)


def _baselines(problem: Problem, task: Task) -> dict[str, Array]:
    """What is flown without a design, as large as the limits let it be axis by axis.

    Of 3-2-1-1 of several units, unless one is given, it is what tells most in the geometric mean.
    """
    t, rest, (low, high) = _instants(task), problem.settings.rest, problem.band
    turn = (problem.duration - rest) / len(task.sticks)
    units = UNITS if problem.settings.unit is None else (1.0,)
    several = [_as_large(task, _turns(problem, task, share)) for share in units]
    told = [covariance(task.information(r)[0] + problem.known) for r in several]
    best = int(np.argmin([np.log(np.diag(C)[problem.rows]).mean() for C in told]))
    sweeps = signals.turns_of_sweeps(t, task.sticks, rest, (max(low, 4 * np.pi / turn), high))
    return {"3-2-1-1": several[best], "sweeps": _as_large(task, sweeps)}


def _turns(problem: Problem, task: Task, share: float = 1.0, *, often: bool = True) -> Array:
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


def _steps(problem: Problem, task: Task) -> Array:
    """Levels and switching times of all axes together, from a random square wave."""
    settings, t = problem.settings, _instants(task)
    step = settings.step or np.pi / 2 / problem.band[1]
    rng = np.random.default_rng(settings.seed)
    shapes = [
        Steps(t, rest=settings.rest, step=step, edge=1.5 * rise, size=size, rng=rng)
        for rise, size in zip(_rise(task, EDGE / 1.5).tolist(), task.sticks.tolist(), strict=True)
    ]
    return improved(task, shapes, settings.iterations)


def _multisine(problem: Problem, task: Task) -> Array:
    """Powers by the convex programme, phases of least peak, then all coefficients together."""
    settings, t, nu = problem.settings, _instants(task), len(task.sticks)
    omega = signals.harmonics(problem.band, problem.duration - settings.rest)
    if len(omega) < nu:
        raise ValueError(
            f"the band has {len(omega)} harmonics of {problem.duration:g} s, fewer than {nu} "
            "inputs: widen the band or fly longer"
        )
    axis = shared_out(len(omega), nu)
    # Half the shortest period: no faster than the waves are.
    fade = max(np.pi / problem.band[1], 1.5 * float(_rise(task).max()))
    free = problem.frees[0]
    at = MatrixFunction(free)(free.guess)
    K = gains(problem.feedback, free.model.inputs, free.model.outputs)
    budget = task.sticks**2 / 2
    count = problem.duration / settings.interval
    units = count * unit_information(at, K, problem.R, omega, axis)
    p = best_powers(task.goals[0], units, axis, budget)[0]
    order, size = np.argsort(axis, kind="stable"), np.sqrt(2 * p)
    faded = signals.taper(t, settings.rest, fade)[:, None]
    waves = [
        faded
        * signals.wave_family(t, settings.rest, omega[axis == j])
        * np.tile(size[axis == j], 2)
        for j in range(nu)
    ]
    phases = least_peak(task, waves, schroeder(p, axis)[order])
    parts = np.split(phases, np.cumsum(np.bincount(axis, minlength=nu))[:-1])
    shapes = [Waves(*each) for each in zip(waves, parts, task.sticks.tolist(), strict=True)]
    return improved(task, shapes, settings.iterations)


def _stated(
    structure: Model,
    flight: Flight | None,
    problem: Problem,
    rough: Task,
    flown: Mapping[str, Array],
    chosen: str,
) -> Design:
    """What all alternatives buy, of a nonlinear structure by its own flight where there is one."""
    made = _predicted(problem, rough, flight, flown, chosen)
    if flight and (said := flight.flown(made.r).jumps()):
        warn(f"{chosen}, as it is flown: {said}")
    if isinstance(structure, NonlinearModel) and not flight:
        return replace(made, linearised=True, unfelt=without_effect(problem.frees[0]))
    return made


def _predicted(
    problem: Problem, rough: Task, flight: Flight | None, flown: Mapping[str, Array], chosen: str
) -> Design:
    """Standard errors of all alternatives at the records' own sampling, and the value."""
    fine = problem.task(problem.settings.interval)
    t, coarse, exact = _instants(fine), _instants(rough), {}
    for name, each in flown.items():
        r = rough.within(each)
        r = np.stack([np.interp(t, coarse, column) for column in r.T], axis=1)
        r = r / max(1.0, float(fine.peaks(r).max()))
        exact[name] = flight.within(r) if flight else r
    alone = {
        name: flight.flown(r).information(problem.R) if flight else fine.information(r)[0]
        for name, r in exact.items()
    }
    if flight:
        tells = [problem.tellable(alone[name] + problem.known) for name in ("3-2-1-1", chosen)]
        problem = replace(problem, told=np.logical_and(*tells))
    spread = {name: covariance(F + problem.known) for name, F in alone.items()}
    r, rest = exact[chosen], problem.settings.rest
    errors = np.sqrt(np.diag(spread[chosen]))
    longer = as_long(alone["3-2-1-1"], problem.known, errors, problem.rows)
    model, share = problem.frees[0].model, fine.peaks(r)
    signals = flight.fly(r) if flight else fine.loops[0].fly(r).signals
    u, y, _ = np.split(signals, np.cumsum([len(model.inputs), len(model.outputs)]), axis=1)
    at_most = rough.peaks(np.stack([np.interp(coarse, t, x) for x in r.T], 1))
    if flight:
        share, at_most = (np.maximum(share, flight.shares(r)), np.maximum(at_most, flight.used(r)))
    at_most = np.maximum(share, at_most)
    noise, before = _with_noise(problem, fine, signals), np.diag(problem.known)
    known = np.where(before > 0, np.sqrt(np.diag(covariance(problem.known))), np.inf)
    made = Design(
        kind=chosen, inputs=model.inputs, outputs=model.outputs, t=t, r=r, u=u, y=y,
        names=problem.frees[0].names, values=problem.frees[0].guess, covariance=spread[chosen],
        before=known,
        alternatives=tuple(
            Alternative(name=name, r=exact[name], std_errors=np.sqrt(np.diag(C)))
            for name, C in spread.items()
        ),
        used=_named(problem, share), used_at_worst=_named(problem, at_most),
        used_by_noise=_named(problem, noise[0]), used_with_noise=_named(problem, noise[1]),
        instead=rest + longer * (problem.duration - rest),
        untold=tuple(np.array(problem.frees[0].names)[~problem.told].tolist()),
        matter=problem.settings.matter, limits=problem.asked, trim=flight.trim if flight else {},
    )  # fmt: skip
    _check_told(problem, alone[chosen], made.used_at_worst)
    seen = judged(problem.frees[0], alone[chosen])
    return replace(made, blind=_blind(seen, made, derived=getattr(model, "derived", False)))


def _blind(seen: Identifiability, made: Design, *, derived: bool) -> tuple[str, ...]:
    """What a flight alone does not tell, in words, and what is known of it from before.

    Of a linearisation, which is ``derived``, what no output feels may be felt at another trim.
    """
    sizes = zip(made.names, made.before, strict=True)
    told = {name for name, size in sizes if np.isfinite(size)} - {*made.untold}
    lost = [each for each in seen.confounded if not told & {*each} or {*made.untold} & {*each}]
    unseen = tuple(name for name in seen.insensitive if name not in told)
    usual = () if derived else unseen
    lines = str(replace(seen, confounded=tuple(lost), insensitive=usual)).splitlines()[1:]
    elsewhere = "parameters that act only away from this trim need another flight condition"
    if derived and unseen:
        lines.insert(
            0,
            f"no output depends on {listed(unseen)} here: {elsewhere}; fix or drop those that act "
            "nowhere",
        )
    if known := [name for name in seen.insensitive if name in told]:
        also = f"; {elsewhere}" * derived
        lines.append(
            f"no output depends on {listed(known)} here: only prior knowledge determines them{also}"
        )
    earlier = [listed(each) for each in seen.confounded if each not in lost]
    lines += [f"distinguished only by prior knowledge: {names}" for names in earlier]
    return tuple(lines)


def _with_noise(problem: Problem, task: Task, signals: Array) -> Array:
    """Peaks of sticks and rates over their limits (2, n): of noise that is heard, and with it.

    With it is after the card, whose signals (N, nu + ny + nx) are; nothing where none is heard.
    """
    found, loop, model = np.zeros((2, len(task.limits))), task.loops[0], problem.frees[0].model
    K, shares = gains(problem.feedback, model.inputs, model.outputs), task.shares(signals)
    for k, sigma in enumerate(deviations(loop, K, problem.noise) / task.limits[: 2 * loop.nu]):
        if sigma > 0.0:
            found[:, k] = peak(0.0 * shares[:, k], sigma), peak(shares[:, k], sigma)
    return found


def _check_told(problem: Problem, F: Array, used: Mapping[str, float]) -> None:
    """Refuse limits within which a flight alone, of information F, tells nothing that counts.

    That is no parameter to within its typical size, though more may be known before.
    """
    free = problem.frees[0]
    share = (np.sqrt(np.diag(covariance(F))) / free.scale[free.index])[problem.rows]
    if share.min() > 1:
        held = max(used, key=lambda name: used[name])
        raise ValueError(
            f"the limits are too tight: within that of {held!r} even the best determined "
            f"parameter, {free.names[problem.rows[share.argmin()]]}, has a standard error of "
            f"{share.min():.2g} times its size: widen it, or fly longer"
        )


def _named(problem: Problem, shares: Array) -> dict[str, float]:
    """Shares of limits by name, where there is a limit."""
    pairs = zip(problem.names, shares.tolist(), strict=True)
    return {name: share for name, share in pairs if share > 0}
