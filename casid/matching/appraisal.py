"""What a match is worth: bounds over the band, reasons to disbelieve it, tables for the report."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.fit import Certificate
from casid.free import Free, violated
from casid.linear import StateSpace
from casid.matching.certificate import Band, band_norm, peaks
from casid.matching.comparison import Comparison, Source
from casid.values import seal, storable

EXACT = 1e-8  # error, relative to the response, that is rounding
NOTHING = 0.999  # error, relative to the response, of a fit that explains nothing
RUNAWAY = 1e4  # scales by which an unbounded parameter may leave its guess


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedSource:
    """One target of a match and the error left against it."""

    name: str
    grid: Array  # (points,) frequencies that were matched [rad/s]
    omega: Array  # (K,) over the band [rad/s]
    sigma: Array  # (K, n) all singular values of the weighted error there
    entries: int  # weighted entries of the response over the grid
    norm: float  # largest singular value over the grid
    sum_of_squares: float
    share: float  # of the sum of squares of all targets

    def __post_init__(self) -> None:
        seal(self)


@storable
@dataclass(frozen=True, kw_only=True)
class Peak:
    """Where the largest singular value is: its target, frequency [rad/s] and worst pair there."""

    source: str
    omega: float
    output: str
    input: str


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class MatchNotes:
    """What a match reports beside its estimates.

    ``start`` is the one that led to them, ``weight`` the name of the weights, "given" of arrays;
    ``covered`` has the spans of airspeed and tables of flight conditions, where there are any.
    """

    start: str
    peak: Peak
    sources: tuple[MatchedSource, ...]
    weight: str = "size"
    covered: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Appraisal:
    """The error of one model over all sources of a comparison."""

    system: StateSpace
    comparison: Comparison
    bands: tuple[Band, ...]  # bounds over the band of every source
    grid_norm: float  # largest singular value over the points

    @property
    def upper(self) -> float:
        """Bound of the largest singular value over the band."""
        return max(band.upper for band in self.bands)

    @property
    def top(self) -> tuple[Source, Band]:
        """The source, and its band, that holds the largest value."""
        number = max(range(len(self.bands)), key=lambda i: self.bands[i].lower)
        return self.comparison.sources[number], self.bands[number]

    def certificate(self) -> Certificate:
        """Both bounds, for the fit."""
        return Certificate(
            grid_norm=self.grid_norm,
            upper_bound=self.upper,
            peak_omega=self.top[1].peak_omega,
            band=self.comparison.band,
            shift=self.comparison.shift,
            at_points=tuple(each.name for each in self.comparison.sources if not each.system),
        )

    def with_peaks(self, above: float) -> Comparison:
        """The comparison with the peaks higher than ``above`` added to its grids."""
        sources = []
        for source, band in zip(self.comparison.sources, self.bands, strict=True):
            if source.system is None:
                sources.append(source)
            else:
                added = peaks(band, above, 0.01)
                sources.append(source.at(np.unique(np.concatenate([source.omega, added]))))
        return replace(self.comparison, sources=tuple(sources))

    def peak_channels(self) -> tuple[str, str]:
        """Output and input whose error is largest where the largest value is."""
        source, band = self.top
        k = int(np.argmin(np.abs(source.omega - band.peak_omega)))
        if source.system is None:
            error = source.error(self.system)[k]
        else:
            error = source.at(np.array([band.peak_omega])).error(self.system)[0]
        i, j = np.unravel_index(int(np.argmax(np.abs(error))), error.shape)
        return self.system.outputs[int(i)], self.system.inputs[int(j)]

    def notes(self, start: str) -> MatchNotes:
        """Where the optimum is held, the error over the band, and what each target contributes."""
        output, input_ = self.peak_channels()
        top, band = self.top
        sources = self.comparison.sources
        squares = [float(np.sum(np.abs(s.error(self.system)) ** 2)) for s in sources]
        total = sum(squares) or 1.0
        return MatchNotes(
            start=start,
            peak=Peak(source=top.name, omega=band.peak_omega, output=output, input=input_),
            sources=tuple(
                MatchedSource(
                    name=source.name,
                    grid=source.omega,
                    omega=band.omega,
                    sigma=band.sigma,
                    entries=int((source.W > 0).sum()),
                    norm=_largest(source.error(self.system)),
                    sum_of_squares=square,
                    share=square / total,
                )
                for source, band, square in zip(sources, self.bands, squares, strict=True)
            ),
        )


def appraise(system: StateSpace, comparison: Comparison) -> Appraisal:
    """Bound the error of a model over the band of every source."""
    negligible = EXACT * response_size(comparison)
    bands = tuple(band_norm(system, source, negligible=negligible) for source in comparison.sources)
    return Appraisal(
        system=system, comparison=comparison, bands=bands, grid_norm=comparison.norm(system)
    )


def response_size(comparison: Comparison) -> float:
    """Largest singular value of the weighted response itself over the points."""
    return _largest(comparison.W * comparison.G)


def doubts(free: Free, x: Array, guess: Array, appraisal: Appraisal, *, stable: bool) -> str | None:
    """Why not to believe a solution that the solver calls one; None when nothing speaks against it.

    Values (nf,) of the parameters with the guess they came from, and the appraisal of their model,
    whose poles had to stay left of the line if ``stable``.
    """
    return (
        _runaway(free, x, guess)
        or violated(free, x)
        or (_right_of_line(appraisal) if stable else None)
        or _explains_nothing(appraisal)
    )


def _runaway(free: Free, values: Array, guess: Array) -> str | None:
    scale, lower, upper = (part[free.index] for part in (free.scale, free.lower, free.upper))
    unbounded = np.where(values > guess, ~np.isfinite(upper), ~np.isfinite(lower))
    far = np.flatnonzero(unbounded & (np.abs(values - guess) > RUNAWAY * scale))
    if not len(far):
        return None
    name, value = free.names[far[0]], values[far[0]]
    return f"{name} = {value:.3g} runs away: the optimum is at infinity; bound it, or fix it"


def _right_of_line(appraisal: Appraisal) -> str | None:
    line = appraisal.comparison.line
    rightmost = appraisal.system.poles()[0]
    if line is None or rightmost.real <= line + 1e-6 * (1 + line):
        return None
    return (
        f"the structure's pole at {rightmost:.4g} lies right of the shift {line:.4g} 1/s; start "
        "nearer, or bound the parameters that destabilise it"
    )


def _explains_nothing(appraisal: Appraisal) -> str | None:
    comparison = appraisal.comparison
    error, response = comparison.error(appraisal.system), comparison.W * comparison.G
    if np.linalg.norm(error) < NOTHING * np.linalg.norm(response):
        return None
    if _largest(error) < NOTHING * _largest(response):
        return None
    output, input_ = appraisal.peak_channels()
    return (
        f"the structure explains nothing of the target; its worst pair is {output} from {input_}: "
        "add what connects them, or mask the pair by a zero weight"
    )


def _largest(E: Any) -> float:  # noqa: ANN401 - real or complex (K, ny, nu)
    return float(np.linalg.norm(E, 2, axis=(1, 2)).max())
