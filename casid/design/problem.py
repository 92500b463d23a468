"""What a design is made for: all that was asked, checked, in arrays."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.channels import CONTROLS
from casid.checks import check_known
from casid.design.criterion import Goal, told
from casid.design.loop import Crowd, Feedback, Loop, UnheldError
from casid.design.optimise import Task
from casid.design.prior import (
    FITTED,
    GUESSED,
    colour_of,
    inside,
    known_before,
    noise_of,
    possible,
)
from casid.design.signals import longest_unit
from casid.design.specification import DesignSettings, Limits, check_times
from casid.display import counted
from casid.errors import warn
from casid.fit import AnyFit
from casid.free import Free, free_parameters
from casid.model import Model

FEWEST = 50  # samples a stick
MOST = 100_000  # samples of a manoeuvre
JUDGES = 2  # models that judge limits for each that leads the optimisation
COARSE = 1600  # samples on which inputs are optimised: with fewer, edges tell less of delays
TRAVEL = 1.0  # that a stick deviates by at most, as a fraction
TILTS, STEEPEST = ("phi", "theta"), 1.5  # rad; a heading may turn by more
FINEST = 6.0  # samples of them in a period of the band's upper edge, at least


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """All that was asked, as `problem_of` has checked it."""

    frees: tuple[Free, ...]
    R: Array  # of a sample, as large as it takes to predict errors that residuals justify
    noise: Array  # of a sample, as it is heard
    known: Array
    limits: Array
    spread: float
    feedback: Feedback
    duration: float
    band: tuple[float, float]
    settings: DesignSettings
    told: np.ndarray  # (nf,) which parameters a flight can tell

    @property
    def rows(self) -> np.ndarray:
        """Places of the parameters that count and that a flight can tell."""
        names = self.frees[0].names
        return np.flatnonzero(self.told & np.isin(names, self.settings.matter or names))

    def task(self, h: float) -> Task:
        """What counts on a grid of interval h [s]."""
        N = round(self.duration / h) + 1
        # Noise refers to dt: of fewer samples each counts for more.
        R = self.R * self.settings.interval / h
        loops = tuple(Loop(free, self.feedback, R, h=h, N=N) for free in self.frees)
        scale = self.frees[0].scale[self.frees[0].index]
        return Task(loops=loops, goals=self.goals([scale] * len(loops)), limits=self.limits)

    def drawn(self, h: float) -> dict[str, Crowd]:
        """Models drawn from the prior, others and judges; none if limits do not depend on values.

        Those that the feedback does not hold, with which nothing keeps the limits, are left out.
        """
        settings, limits = self.settings, self.limits.copy()
        if not self.feedback:  # sticks and rates are those of the card
            limits[: 2 * len(self.frees[0].model.inputs)] = np.inf
        if not settings.draws or not np.isfinite(limits).any():
            return {}
        counts = {"others": settings.draws, "judges": JUDGES * settings.draws}
        made = {role: Crowd(self._held(n, n, h), limits) for role, n in counts.items()}
        if not all(crowd.count for crowd in made.values()):
            held = "held by the feedback given" if self.feedback else "held, without feedback"
            raise ValueError(
                f"none of {settings.draws} plausible aircraft, which are {self.spread:.0%} off "
                f"the model, is {held}: give one that holds them, a smaller "
                "spread if the model is known better, or draws = 0, without a margin"
            )
        return made

    def _held(self, count: int, seed: int, h: float) -> Iterator[Loop]:
        """Loops of so many models drawn from the prior, without those that are not held.

        They do not depend on the seed of the start, so that starts are held against one another.
        """
        N = round(self.duration / h) + 1
        for each in possible(self.frees[0], self.known, self.spread, count, seed):
            with suppress(UnheldError):
                yield Loop(each, self.feedback, self.R, h=h, N=N)

    def goals(self, reference: Sequence[Array]) -> tuple[Goal, ...]:
        """The criterion of each model, over the standard errors (nf,) of its reference."""
        rows, criterion, known = self.rows, self.settings.criterion, self.known
        return tuple(Goal(criterion, rows, scale[rows], known) for scale in reference)

    def coarse(self) -> float:
        """Interval on which inputs are optimised [s], of which the card is a whole number."""
        dt, duration = self.settings.interval, self.duration
        h = max(dt, min(duration / COARSE, 2 * np.pi / self.band[1] / FINEST))
        length = dt * round(duration / dt)
        return float(length / round(length / h))

    def of_all(self, free: Free, known: Array) -> "Problem":
        """The same to state what is told of all free parameters, of which this may lack some.

        Those have no effect here: what is known of them (nf, nf) is from before.
        """
        own = np.isin(free.names, self.frees[0].names)
        told = np.isin(free.names, np.array(self.frees[0].names)[self.told])
        told |= ~own & (np.diag(known) > 0)
        return replace(self, frees=(free, *self.frees[1:]), known=known, told=told)

    @property
    def asked(self) -> dict[str, float]:
        """The limits there are, by their names in `names`."""
        pairs = zip(self.names, self.limits.tolist(), strict=True)
        return {name: limit for name, limit in pairs if np.isfinite(limit)}

    @property
    def names(self) -> tuple[str, ...]:
        """Of what may be limited, in the order of the limits."""
        model = self.frees[0].model
        rates = [f"{name} rate" for name in model.inputs]
        return (*model.inputs, *rates, *model.outputs, *model.states)

    def tellable(self, F: Array) -> np.ndarray:
        """Which parameters (nf,) F tells; refused if it does not tell those that matter."""
        free, matter = self.frees[0], self.settings.matter
        found = told(F, free.scale[free.index])
        lost = [name for name, seen in zip(free.names, found, strict=True) if not seen]
        away = [name for name in matter if name in lost]
        if away or not found.any():
            raise ValueError(
                f"no input identifies {(away or lost)[0]!r} alone, only combinations of "
                f"{', '.join(lost)}: fix one of these, DesignSettings(fixed=...)"
            )
        return found


def free_of(model: Model, settings: DesignSettings) -> Free:
    """The free parameters of a design; refused if one that matters is not among them."""
    free = free_parameters(model, settings.fixed or (), settings.bounds)
    check_known("matter: no free parameter is called", settings.matter, free.names)
    return free


def problem_of(
    structure: Model,
    limits: Limits,
    duration: float,
    fit: AnyFit | None,
    noise: Mapping[str, float] | None,
    settings: DesignSettings,
) -> Problem:
    """What is asked of a linear structure, of which a fit may be known; ValueError by name."""
    _check_times(duration, limits, settings)
    _check_unit(duration, len(structure.inputs), settings)
    free = inside(free_of(structure, settings))
    band = settings.band or _band(structure, duration, settings.interval)
    if band[1] > (nyquist := np.pi / settings.interval):
        raise ValueError(
            f"the band ends at {band[1]:g} rad/s, above the Nyquist frequency {nyquist:.4g} rad/s "
            f"of samples {settings.interval:g} s apart: lower it, or sample faster (dt)"
        )
    if duration - settings.rest < (least := FEWEST * settings.interval * len(structure.inputs)):
        raise ValueError(
            f"{duration:g} s less {settings.rest:g} s of rest are too short for "
            f"{counted(len(structure.inputs), 'input')}: fly longer, "
            f"{settings.rest + least:.3g} s at least, or sample faster: a design has {FEWEST} "
            f"samples an input at least, here dt = {settings.interval:g} s"
        )
    heard = noise_of(structure, fit, noise, band)
    return Problem(
        frees=(free,), R=heard * colour_of(fit, noise) ** 2, noise=heard,
        known=known_before(free, fit), limits=_arrays(structure, limits), feedback={},
        duration=duration, band=band,
        spread=settings.spread if settings.spread is not None else (FITTED if fit else GUESSED),
        settings=settings, told=np.full(len(free.index), True),
    )  # fmt: skip


def _check_times(duration: float, limits: Limits, settings: DesignSettings) -> None:
    """Refuse times that are none, more samples than can be worked on, changes that take too long.

    A manoeuvre has room for two changes of each stick from end to end at least.
    """
    check_times(duration=duration)
    if (count := duration / (dt := settings.interval)) > MOST:
        raise ValueError(
            f"{duration:g} s have {count:.3g} samples {dt:g} s apart, more than the {MOST} that a "
            f"design is made of: design {MOST * dt:.4g} s at most and fly that again"
        )
    room = (duration - settings.rest) / 2
    if settings.step is not None and settings.step > room > 0:
        raise ValueError(f"step = {settings.step:g} s: expected a time above 0, below {room:.3g} s")
    for name, rate in limits.rates.items():
        if (rise := 2 * limits.sticks[name] / rate) > room > 0:
            raise ValueError(
                f"at its rate of {rate:g} a second {name!r} takes {rise:.3g} s from one end of its "
                f"limit {limits.sticks[name]:g} to the other, and {duration:g} s have no room for "
                f"two such changes: lower the limit of the stick, to {rate * room / 2:.3g} at "
                "most, or raise that of its rate"
            )


def _check_unit(duration: float, count: int, settings: DesignSettings) -> None:
    """Refuse a unit with which there is no time for a 3-2-1-1 on each of ``count`` inputs."""
    longest = longest_unit((duration - settings.rest) / count)
    if settings.unit is not None and settings.unit > longest > 0:
        raise ValueError(
            f"unit = {settings.unit:g} s: {duration:g} s have no room for a 3-2-1-1 on "
            f"{counted(count, 'input')} to compare with: use {longest:.3g} s at most, or leave "
            "unit out"
        )


def _band(model: Model, duration: float, dt: float) -> tuple[float, float]:
    """From two periods in the duration to three times the fastest mode."""
    fastest = float(np.abs(model.system().poles()).max())
    low = 4 * np.pi / duration
    return low, min(max(3 * fastest, 8 * low), np.pi / dt / 2)


def check_limited(model: Model, inputs: Iterable[str], responses: Iterable[str]) -> None:
    """Refuse limits of what a structure does not have: ValueError."""
    check_known("limits name", inputs, model.inputs)
    check_known("limits name", responses, dict.fromkeys((*model.outputs, *model.states)))


def _ask_units(limits: Limits) -> None:
    """Warn of limits that no stick in fractions of its travel and no angle in rad would have."""
    asked = (
        (limits.sticks, CONTROLS, TRAVEL, "fractions of full travel", "percent"),
        (limits.responses, TILTS, STEEPEST, "rad", "degrees"),
    )
    for group, names, most, unit, meant in asked:
        for name in (name for name in names if most < group.get(name, 0.0) < np.inf):
            warn(
                f"the limit of {name!r} is {group[name]:g}, in {unit}: is it meant in {meant}? "
                "Limits are in SI"
            )


def _arrays(model: Model, limits: Limits) -> Array:
    """Limits of sticks, rates, outputs, states in their order; infinite where there is none."""
    check_limited(model, (*limits.sticks, *limits.rates), limits.responses)
    _ask_units(limits)
    named = ((limits.sticks, model.inputs), (limits.rates, model.inputs))
    if missing := [name for name in model.inputs if name not in limits.sticks]:
        raise ValueError(f"limits.sticks has no {missing[0]!r}: every input needs its limit")
    hidden = tuple(name if name not in model.outputs else "" for name in model.states)
    groups = (*named, (limits.responses, model.outputs), (limits.responses, hidden))
    return np.array([group.get(name, np.inf) for group, names in groups for name in names])
