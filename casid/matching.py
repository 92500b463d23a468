"""Match a structure to a black box and to frequency responses, in the quadratic or H-infinity norm.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 3.3: min over λ of ‖Ĝ(s) − G(s; λ)‖ on the shifted line (8)-(10). The programmes are those
of `casid.lifted`; here are the order of the solves, the certificate over the band and the checks
of what a solver calls success.
"""

import logging
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.certificate import Band, band_norm, peaks
from casid.comparison import Comparison, Source, Target, Weight, compare
from casid.errors import ConvergenceError
from casid.fit import Certificate, Fit, parameter_table
from casid.frequency import FrequencyResponse
from casid.initial import starts
from casid.lifted import Lifted, lift
from casid.linear import StateSpace
from casid.model import Bounds, Free, Model, free_parameters
from casid.nlp import Solution, SolverOptions, solve
from casid.pbsid import BlackBox

LOG = logging.getLogger("casid")

NORMS = ("quadratic", "hinf")
GAP = 0.01  # between grid value and bound over the band
HIGH = 0.5  # of the highest peak of the quadratic fit: what is added before the first solve
ROUNDS = 12  # of adding peaks to the grid
# A quadratic programme starts next to its solution, which its barrier must not blur.
NEAR: dict[str, dict[str, float | str]] = {
    "quadratic": {"mu_init": 1e-7, "bound_push": 1e-8, "bound_frac": 1e-8, "tol": 1e-11,
                  "acceptable_tol": 1e-8, "acceptable_iter": 3},
    "hinf": {"mu_init": 1e-2, "bound_mult_init_method": "mu-based"},
}  # fmt: skip
EXACT = 1e-8  # error, relative to the response, that is rounding


def match(
    model: Model,
    target: Target | Sequence[Target],
    *,
    norm: str = "hinf",
    omega: Array | None = None,
    shift: float | None = None,
    weight: Weight | Sequence[Weight] = None,
    source_weight: Sequence[float] | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    stable_shift: bool = True,
    options: SolverOptions = SolverOptions(),  # noqa: B008 - frozen
) -> Fit:
    """The parameters with which a structure comes nearest to a target's response.

    Parameters
    ----------
    model : Model
        Structure and guess; its channels are found in the target by name.
    target : BlackBox, FrequencyResponse or a sequence of both
        What to match. Measured responses enter at their own points of s = jω, weighted by
        coherence (pairs below 0.6 are left out), black boxes on s = σ + jω.
    norm : {"hinf", "quadratic"}
        The largest singular value of the weighted error over grid and band, or the mean over the
        grid of its squared Frobenius norm.
    omega : (K,) array
        Grid [rad/s]; 40 points over the black box's band unless given.
    shift : float
        σ >= 0 [1/s], right of all poles of the black box: frequencies below about σ are blurred.
        The default is the least that leaves a margin of a tenth of the rightmost pole's modulus.
    weight : None, "relative", array, or a sequence of one a target
        On top of the default scaling by standard deviations, std(u)/std(y), an array that
        broadcasts to (K, ny, nu), zeros being masks, linear in ω between the grid's points.
        "relative" divides every output's error by the size of its response at that frequency.
    source_weight : sequence of float
        Factor on the error of each target, one unless given.
    fixed, bounds
        Parameters held, and bounds {name: (lower, upper)} instead of the model file's.
    stable_shift : bool
        Keep the structure's poles left of the line s = σ + jω.
    options : SolverOptions
        Limits and tolerance of every solve.

    Returns
    -------
    Fit
        ``cost`` is the norm (H-infinity) or the mean square (quadratic). ``certificate`` bounds
        the norm over the band. ``notes`` holds singular values over the band, the frequency and
        channels of the optimum, and what each target contributes.

    Raises
    ------
    ValueError, ModelError
        A channel no target has, a grid outside the band, a shift left of a pole, wrong bounds.
    ConvergenceError
        No solution that passes the checks; ``best`` is the best iterate as a `Fit`.
    """
    if norm not in NORMS:
        raise ValueError(f"norm={norm!r}: expected one of {', '.join(map(repr, NORMS))}")
    begin = time.perf_counter()
    targets = [target] if isinstance(target, BlackBox | FrequencyResponse) else list(target)
    free = free_parameters(model, fixed, bounds)
    comparison = compare(
        model, targets, omega=omega, shift=shift, weight=weight, source_weight=source_weight
    )
    matcher = _Matcher(free, comparison, stable_shift, options)
    state = matcher.quadratic()
    if norm == "hinf":
        state = matcher.hinf(state)
    fit = matcher.fit(state, norm, model, time.perf_counter() - begin)
    LOG.info("%s: cost %.6g, %d iterations, %.2f s", fit.method, fit.cost, fit.iterations,
             fit.seconds)  # fmt: skip
    if not fit.success:
        raise ConvergenceError(f"match {norm}: {fit.status}", best=fit)
    return fit


@dataclass(frozen=True, eq=False, kw_only=True)
class _State:
    """Where a match stands: values (nf,), their multipliers, and how they were found."""

    values: Array
    multipliers: Array
    cost: float
    success: bool
    status: str
    start: str
    comparison: Comparison
    bands: tuple[Band, ...] = ()


class _Matcher:
    """The solves of one match; counts their iterations."""

    def __init__(
        self, free: Free, comparison: Comparison, stable: bool, options: SolverOptions
    ) -> None:
        self.free, self.comparison, self.stable, self.options = free, comparison, stable, options
        self.iterations = 0
        self.size = float(np.linalg.norm(comparison.W * comparison.G, 2, axis=(1, 2)).max())
        self.negligible = EXACT * self.size

    def system(self, values: Array) -> StateSpace:
        """The structure at the free values."""
        return self.free.model.with_vector(self.free.full(values)).system()

    def quadratic(self) -> _State:
        """The quadratic fit from the best start whose programme converges."""
        found: list[_State] = []
        for start in starts(self.free, self.comparison):
            found.append(self._solve("quadratic", start.name, start.values, self.comparison))
            if found[-1].success:
                break
        return min(found, key=lambda state: (not state.success, state.cost))

    def hinf(self, state: _State) -> _State:
        """The H-infinity fit from a quadratic one, certified over the band."""
        bands = self._bands(self.system(state.values), self.comparison)
        grown = _with_peaks(self.comparison, bands, HIGH * _upper(bands))
        for _ in range(ROUNDS):
            if grown.norm(self.system(state.values)) > self.negligible:
                state = self._solve("hinf", state.start, state.values, grown)
            state = self._certified(state, grown)
            if not state.success or _upper(state.bands) <= self._enough(state):
                return state
            grown = _with_peaks(grown, state.bands, state.cost)
        gap = f"{_upper(state.bands) / state.cost - 1:.1%}"
        status = f"the bound over the band stays {gap} above the grid; pass a finer omega"
        return replace(state, success=False, status=status)

    def _certified(self, state: _State, comparison: Comparison) -> _State:
        system = self.system(state.values)
        cost, bands = comparison.norm(system), self._bands(system, comparison)
        return replace(state, cost=cost, comparison=comparison, bands=bands)

    def _enough(self, state: _State) -> float:
        """Bound over the band that certifies the optimum on the grid."""
        return max(state.cost * (1 + GAP), self.negligible)

    def _bands(self, system: StateSpace, comparison: Comparison) -> tuple[Band, ...]:
        return tuple(
            band_norm(system, source, negligible=self.negligible) for source in comparison.sources
        )

    def _solve(self, norm: str, start: str, values: Array, comparison: Comparison) -> _State:
        """One programme; once more with the stability constraint if its solution needs it."""
        lifted, solution = self._programme(norm, values, comparison, stable=False)
        if self._unstable(lifted, solution):
            values = lifted.parameters(solution.x)
            lifted, solution = self._programme(norm, values, comparison, stable=True)
        scale = self.free.scale[self.free.index]
        unit = lifted.unit**2
        # From squared errors to the cost that is reported: itself, or the norm √t.
        slope = (
            unit if norm == "quadratic" else unit / (2 * np.sqrt(max(solution.f * unit, 1e-300)))
        )
        return _State(
            values=lifted.parameters(solution.x),
            multipliers=-solution.multipliers_x[: len(scale)] / scale * slope,
            cost=solution.f * unit,
            success=solution.success,
            status=solution.status,
            start=start,
            comparison=comparison,
        )

    def _programme(
        self, norm: str, values: Array, comparison: Comparison, *, stable: bool
    ) -> tuple[Lifted, Solution]:
        lifted = lift(self.free, comparison, norm, values, stable=stable)
        options = replace(self.options, ipopt=NEAR[norm] | dict(self.options.ipopt))
        solution = solve(lifted.problem, options, stage=f"match {norm}")
        self.iterations += solution.iterations
        return lifted, solution

    def _unstable(self, lifted: Lifted, solution: Solution) -> bool:
        line = self.comparison.line
        if not self.stable or line is None:
            return False
        poles = self.system(lifted.parameters(solution.x)).poles()
        return bool(poles.real.max() > line + 1e-6 * (1 + line))

    def fit(self, state: _State, norm: str, guess: Model, seconds: float) -> Fit:
        """The result, its certificate and its tables."""
        system = self.system(state.values)
        bands = state.bands or self._bands(system, state.comparison)
        sources = state.comparison.sources
        top = max(bands, key=lambda band: band.lower)
        return Fit(
            model=self.free.model.with_vector(self.free.full(state.values)),
            parameters=parameter_table(self.free, state.values, state.multipliers, guess=guess),
            cost=state.cost,
            status=state.status,
            success=state.success,
            iterations=self.iterations,
            seconds=seconds,
            method=f"match {norm}",
            certificate=Certificate(
                grid_norm=state.comparison.norm(system),
                upper_bound=_upper(bands),
                peak_omega=top.peak_omega,
                band=state.comparison.band,
                shift=state.comparison.shift,
            ),
            free_names=self.free.names,
            notes=_notes(system, state, bands, sources),
        )


def _upper(bands: Sequence[Band]) -> float:
    return max(band.upper for band in bands)


def _with_peaks(comparison: Comparison, bands: Sequence[Band], above: float) -> Comparison:
    """The comparison with the peaks between its points added to its grids."""
    sources = []
    for source, band in zip(comparison.sources, bands, strict=True):
        if source.system is not None:
            added = peaks(band, above * (1 + 1e-3), 0.01)
            source = source.at(np.unique(np.concatenate([source.omega, added])))  # noqa: PLW2901
        sources.append(source)
    return replace(comparison, sources=tuple(sources))


def _notes(
    system: StateSpace, state: _State, bands: Sequence[Band], sources: Sequence[Source]
) -> dict[str, Any]:
    """Numbers for the report, plain lists."""
    number = max(range(len(bands)), key=lambda i: bands[i].lower)
    band, source = bands[number], sources[number]
    omega = np.array([band.peak_omega])
    k = int(np.argmin(np.abs(source.omega - omega)))
    at_peak = source.at(omega).error(system)[0] if source.system else source.error(system)[k]
    i, j = np.unravel_index(int(np.argmax(np.abs(at_peak))), at_peak.shape)
    return {
        "start": state.start,
        "peak": {
            "source": source.name,
            "omega": float(band.peak_omega),
            "output": system.outputs[int(i)],
            "input": system.inputs[int(j)],
        },
        "band": [
            {"source": s.name, "omega": b.omega.tolist(), "sigma": b.sigma.tolist()}
            for s, b in zip(sources, bands, strict=True)
        ],
        "grid": [{"source": s.name, "omega": s.omega.tolist()} for s in sources],
        "sources": [_contribution(system, s) for s in sources],
    }


def _contribution(system: StateSpace, source: Source) -> dict[str, Any]:
    E = source.error(system)
    return {
        "source": source.name,
        "points": len(source.omega),
        "entries": int((source.W > 0).sum()),
        "norm": float(np.linalg.norm(E, 2, axis=(1, 2)).max()),
        "sum_of_squares": float(np.sum(np.abs(E) ** 2)),
    }
