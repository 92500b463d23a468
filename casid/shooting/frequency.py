"""Output error in the frequency domain: maximum likelihood on the transforms of whole records.

    min_λ  ½ Σ w ( |E|²/Φ + log Φ )                         over all lines, outputs and records

with E of `casid.shooting.spectral`, less what noise leaves there of what was before the record
(`casid.shooting.noise_transients`), and Φ of `casid.shooting.spectrum`, held in each solve and
estimated from its residuals before the next, until the estimates rest. Klein and Morelli (2006),
section 7.3, on the lines of whole records and with their transients; Pintelon and Schoukens, System
Identification (2012), chapters 9 and 10. IPOPT sees λ alone: gradient and Gauss-Newton Hessian are
those of the cost with the transients eliminated.
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.assembly import evaluated
from casid.free import Free
from casid.nlp import Problem, Solution, SolverOptions, solve
from casid.shooting.anderson_acceleration import Secants
from casid.shooting.line_residuals import Residual, information
from casid.shooting.lines import Lines
from casid.shooting.noise_transients import Outside, directions, on_lines
from casid.shooting.spectral import SpectralResiduals
from casid.shooting.spectrum import NoiseSpectrum, leverages, noise_spectra, powers, reach

ROUNDS = 40  # of solves
STEADY = 8  # of them, after which the directions of noise under way before records are held
ROUGH = 1e-4  # tolerance of all but the last
SETTLED = 2e-2  # standard errors that a round may move the estimates and be the last but one
TAIL = 0.1  # of the information about a parameter that the rounds before the last may leave out
IPOPT: dict[str, float | str] = {
    "nlp_scaling_method": "none",
    "mu_strategy": "monotone",
    "acceptable_tol": 1e-5,  # where rounding ends the descent, as without noise
    "acceptable_iter": 5,
    "acceptable_obj_change_tol": 1e-12,
}
WARM: dict[str, float | str] = {  # a warm round stays where it starts
    "mu_init": 1e-6,
    "warm_start_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
}
CLOSE: dict[str, float | str] = {  # of one that starts beside a solution
    "mu_init": 1e-9,
    "bound_push": 1e-9,
    "bound_frac": 1e-9,
    "bound_mult_init_val": 1e-2,  # the cost is a mean over measurements: so are prices
}


def close(options: SolverOptions) -> SolverOptions:
    """Options of a solve that starts beside a solution, and stays there."""
    return replace(options, ipopt=CLOSE | dict(options.ipopt))


@dataclass(frozen=True, eq=False)
class State:
    """The likelihood at some λ, its spectra held."""

    residuals: list[Residual]
    cost: float  # ½ Σ w |E|²/Φ, and of prior values
    F: Array  # (nf, nf) information
    g: Array  # (nf,) gradient
    alone: Array  # (nf,) information were all else known, transients too

    @cached_property
    def taken(self) -> list[Array]:
        """What is taken of the lines' freedom, as `leverages` has it."""
        return leverages(self.residuals, self.F)


class SpectralProgramme:
    """Cost and derivatives of scaled free parameters for spectra held, for IPOPT."""

    def __init__(
        self,
        residuals: SpectralResiduals,
        spectra: tuple[NoiseSpectrum, ...],
        scales: Array,
        before: tuple[NoiseSpectrum, ...] | None = None,
    ) -> None:
        self.residuals, self.spectra, self.scales = residuals, spectra, scales
        self.before = spectra if before is None else before  # of noise under way before records
        lines = residuals.lines
        self.powers = powers(spectra, lines)
        self.weights = [
            each.weight[:, None] / power for each, power in zip(lines, self.powers, strict=True)
        ]
        self.outside = _outside(self.before, lines)
        self.n = measurements(lines)
        self._last: tuple[bytes, State | None] = b"", None

    def state(self, x: Array) -> State | None:
        """The likelihood at scaled parameters; None where the model has a pole on a line."""
        key = x.tobytes()
        if self._last[0] != key:
            self._last = key, self._state(x * self.scales)
        return self._last[1]

    def _state(self, lam: Array) -> State | None:
        try:
            found = self.residuals(lam, self.weights, self.outside)
        except np.linalg.LinAlgError:
            return None
        off, pull = self.residuals.free.prior_residuals(lam)
        known, F = information(found)
        g = np.sum([each.g for each in found], axis=0) + pull.T @ off
        cost = sum(each.cost for each in found) + float(off @ off) / 2
        alone = np.diag(known) + np.sum(pull**2, axis=0)
        return State(found, cost, F + pull.T @ pull, g, alone)

    def likelihood(self, x: Array) -> float:
        """Negative log-likelihood, less its constant ½ n log 2π."""
        state = self.state(x)
        logs = [
            float(each.weight @ np.log(power[:, each.seen]).sum(axis=1))
            for each, power in zip(self.residuals.lines, self.powers, strict=True)
        ]
        return np.inf if state is None else state.cost + sum(logs) / 2

    def solve(
        self, x: Array, options: SolverOptions, number: int, warm: tuple[Array, Array] | None
    ) -> Solution:
        """Estimate with the spectra held."""
        if warm is not None:
            options = replace(options, ipopt=WARM | dict(options.ipopt))
        stage = f"output error in the frequency domain, round {number}"
        return solve(self._problem(x), options, stage=stage, warm=warm)

    def _problem(self, start: Array) -> Problem:
        free, s = self.residuals.free, self.scales
        limits, n = free.constraint_limits, len(start)
        x = start, free.lower[free.index] / s, free.upper[free.index] / s
        J, H = ca.Sparsity.dense(limits.shape[1], n), ca.Sparsity.upper(n)
        return evaluated(self, x, (limits[0], limits[1]), J, H)

    @cached_property
    def ties(self) -> Array:
        """Size of one of each of the structure's constraints, (m,)."""
        return self.residuals.free.constraint_sizes

    def cost(self, x: Array) -> float:
        """The cost per measurement, NaN where the model has a pole on a line."""
        state = self.state(x)
        return np.nan if state is None else state.cost / self.n

    def gradient(self, x: Array) -> Array:
        """Its gradient."""
        state = self.state(x)
        return np.full(len(x), np.nan) if state is None else state.g * self.scales / self.n

    def constraints(self, x: Array) -> Array:
        """Values of the structure's constraints."""
        return np.asarray(self.residuals.matrices(x * self.scales).c / self.ties)

    def jacobian(self, x: Array) -> Array:
        """Their derivatives, column by column."""
        slopes = self.residuals.matrices(x * self.scales).dc
        return np.asarray((slopes * self.scales[:, None] / self.ties).ravel())

    def hessian(self, x: Array, f: float, mu: Array) -> Array:  # noqa: ARG002 - as `Calls` has it
        """Upper triangle, by columns, of Gauss-Newton's Hessian of f times the cost."""
        state, s = self.state(x), self.scales
        F = np.full((len(x),) * 2, np.nan) if state is None else state.F * np.outer(s, s) / self.n
        return np.asarray(f * F[np.tril_indices(len(x))])

    def balanced(self, lam: Array) -> "SpectralProgramme":
        """The same in scales that make the curvature at free values (nf,) per observation one.

        Scales are at most the present ones.
        """
        state = self.state(lam / self.scales)
        if state is None:
            return self
        size = np.diag(state.F) * self.scales**2 / self.n
        scales = self.scales / np.sqrt(np.maximum(size, 1.0))
        other = copy(self)
        other.scales, other._last = scales, ((lam / scales).tobytes(), state)
        return other

    def released(self, free: Free) -> "SpectralProgramme":
        """The same under other bounds, which the likelihood does not depend on."""
        residuals = SpectralResiduals(free, self.residuals.lines)
        other = SpectralProgramme(residuals, self.spectra, self.scales, self.before)
        other._last = self._last
        return other


def _outside(spectra: tuple[NoiseSpectrum, ...], lines: list[Lines]) -> list[Outside]:
    """What noise of the spectra may leave on every record's lines of what was before it."""
    longest: dict[int, int] = {}
    for each in lines:
        longest[each.kind] = max(longest.get(each.kind, 0), each.record.N)
    return [
        on_lines(each, _directions(spectra[each.kind], each.dt, longest[each.kind]))
        for each in lines
    ]


@lru_cache(maxsize=16)
def _directions(spectrum: NoiseSpectrum, dt: float, N: int) -> tuple[Array, ...]:
    """In time, of every output, of records of at most N samples."""
    columns = np.where(np.isfinite(spectrum.power), spectrum.power, 1.0).T
    return tuple(directions(spectrum.omega, column, dt, N) for column in columns)


def measurements(lines: list[Lines]) -> float:
    """Number of real measurements on the lines."""
    return float(sum(each.weight.sum() * each.seen.sum() for each in lines))


@dataclass(frozen=True, eq=False)
class SpectralOutcome:
    """Where the rounds of solves ended."""

    programme: SpectralProgramme
    solution: Solution
    iterations: int
    rounds: int
    settled: bool

    @property
    def lam(self) -> Array:
        """Free values (nf,)."""
        return self.solution.x * self.programme.scales

    @property
    def F(self) -> Array:
        """Information (nf, nf); NaN where the model has a pole on a line."""
        state, n = self.programme.state(self.solution.x), len(self.solution.x)
        return np.full((n, n), np.nan) if state is None else state.F

    def rests(self, step: Array) -> bool:
        """Whether a step of free values (nf,) is no matter."""
        return float(step @ self.F @ step) < SETTLED**2


def search(
    residuals: SpectralResiduals,
    start: Array,
    options: SolverOptions,
    held: tuple[NoiseSpectrum, ...] | None = None,
    last: SpectralOutcome | None = None,
) -> SpectralOutcome:
    """Rounds of solves from free values (nf,); one, if the spectra are known and held.

    The first is warm if the start is hardly off the end of a ``last`` one, whose spectra are those
    held, if any are.

    All but the last take only lines that carry information; without a ``last`` one the first weighs
    them alike. Slow ones are accelerated. ValueError: a start without residuals.
    """
    options = replace(options, ipopt=IPOPT | dict(options.ipopt))
    lines, free = residuals.lines, residuals.free
    scales, limits = free.scale[free.index], (free.lower[free.index], free.upper[free.index])
    if held is not None:
        own = None if last is None else last.programme.before
        return _settled(SpectralProgramme(residuals, held, scales, own), start, last, options)
    rough = replace(options, tolerance=max(ROUGH, options.tolerance))
    spectra, lam, highest, secants = white(lines), start, 0.0, Secants()
    before = spectra if last is None else last.programme.before
    if last is None:  # what a poor start leaves is no noise: its spectrum would excuse it
        first = _begun(SpectralProgramme(residuals, spectra, scales), start, rough)
        if first.solution.success:
            last, lam = replace(first, settled=False), first.lam
    while True:
        state = SpectralProgramme(residuals, spectra, scales, before).state(lam / scales)
        if state is None:
            raise ValueError("the model has a pole on a line of its records' transforms: move it")
        taken = state.taken
        spectra = noise_spectra(lines, state.residuals, taken)
        before = _before(spectra, before, last)
        if last is not None and last.settled:
            whole = SpectralProgramme(residuals, spectra, scales, before)
            return _settled(whole, lam, last, options)
        highest = max(highest, reach(lines, taken, TAIL))
        plan = options if secants.used else rough  # secants are of exact ends
        part = SpectralProgramme(residuals.below(highest), spectra, scales, before)
        last = _round(part, lam, last, plan)
        ahead = np.clip(secants.ahead(lam, last.lam, last.F), *limits)
        last, lam = replace(last, settled=last.settled and last.rests(ahead - lam)), ahead
        if not last.solution.success or last.rounds >= ROUNDS:
            whole = SpectralProgramme(residuals, spectra, last.programme.scales, before)
            return replace(last, programme=whole, settled=False)


def _before(
    spectra: tuple[NoiseSpectrum, ...],
    before: tuple[NoiseSpectrum, ...],
    last: SpectralOutcome | None,
) -> tuple[NoiseSpectrum, ...]:
    """By which spectra noise was under way before records: held at last.

    Its directions come and go with their variance, and rounds may not settle.
    """
    return spectra if last is None or last.rounds < STEADY else before


def _begun(programme: SpectralProgramme, start: Array, options: SolverOptions) -> SpectralOutcome:
    """The first round, on the lines that tell of the start."""
    state, residuals = programme.state(start / programme.scales), programme.residuals
    if state is not None:
        highest = reach(residuals.lines, state.taken, TAIL)
        part = residuals.below(highest)
        programme = SpectralProgramme(part, programme.spectra, programme.scales, programme.before)
    return _round(programme, start, None, options)


def _round(
    programme: SpectralProgramme, lam: Array, last: SpectralOutcome | None, options: SolverOptions
) -> SpectralOutcome:
    """One solve from free values (nf,), the spectra held; settled if it hardly moves them."""
    programme = programme.balanced(lam)
    scales = programme.scales
    rounds, iterations, warm = 1, 0, None
    if last is not None:
        rounds, iterations = last.rounds + 1, last.iterations
        prices = last.solution.multipliers_x * scales / last.programme.scales
        warm = prices, last.solution.multipliers_g
    solution = programme.solve(lam / scales, options, rounds, warm)
    end = SpectralOutcome(programme, solution, iterations + solution.iterations, rounds, False)
    return replace(end, settled=end.rests(end.lam - lam))


def _settled(
    programme: SpectralProgramme, lam: Array, last: SpectralOutcome | None, options: SolverOptions
) -> SpectralOutcome:
    """The last solve, its spectra known."""
    return replace(_round(programme, lam, last, options), settled=True)


def white(lines: list[Lines], R: Array | None = None) -> tuple[NoiseSpectrum, ...]:
    """White spectra of variances R (ny,); unless given, the outputs' mean squares on the lines."""
    if R is None:
        power = sum(each.weight @ np.abs(each.Y) ** 2 for each in lines)
        count = sum(each.weight.sum() * each.seen for each in lines)
        R = np.maximum(power / np.maximum(count, 1.0), 1e-300)
    omega = np.array([min(each.omega[0] for each in lines), max(each.omega[-1] for each in lines)])
    names = tuple(each.record.name for each in lines)
    kinds = 1 + max(each.kind for each in lines)
    return (NoiseSpectrum(records=names, omega=omega, power=np.tile(R, (2, 1))),) * kinds
