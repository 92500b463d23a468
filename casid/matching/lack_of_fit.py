"""What a structure misses of measured responses, whatever its parameters, in stated errors.

The cost in decibels and degrees, as every norm of a match, does not know how well the responses are
known: it is small where a structure misses a lag of a tenth of a second. Residuals made independent
and of unit variance by the stated errors tell it, less what a step of the parameters would explain,
to first order. The median over a pair's points counts: what single points miss, as at the peak of a
response or by an error that came out small, says nothing of the structure.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.special import chdtrc

from casid.arrays import Array, BoolArray, ComplexArray
from casid.display import listed
from casid.estimates import holding
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free
from casid.frequency.covariance import Whitener, steadied, whitener
from casid.frequency.response import FrequencyResponse
from casid.matching.comparison import Comparison, Source
from casid.matching.targets import Target
from casid.model import Model

FAR = 2.5  # stated errors that half of a pair's points are off, above which that is told
SELDOM = 1e-3  # chance by which independent points are
NOTHING = 1e-8  # of the largest singular value, all parameters moving a response alike

WHY = (
    "in half of their points or more, whatever the parameters: the structure misses something (a "
    "lag, a mode, a coupling), a unit or a sign is wrong, or errors are stated too small. J and "
    "norm do not show that"
)


class Residuals(NamedTuple):
    """Of a measured response, made independent and of unit variance by its stated errors."""

    white: Whitener
    r: ComplexArray  # (points,) structure less measurement
    J: ComplexArray  # (points, nf) derivatives by the free parameters

    def parts(self) -> tuple[Array, Array]:
        """Real parts, then imaginary ones: (2 points,), (2 points, nf)."""
        return (
            np.concatenate([self.r.real, self.r.imag]),
            np.vstack([self.J.real, self.J.imag]),
        )


def misfit(free: Free, active: BoolArray, comparison: Comparison, targets: Sequence[Target]) -> str:
    """What says that a structure misses more of measured responses than their errors; "" if none.

    Parameters as of `casid.matching.condition_homogeneity.discord`; conditions may be one.
    """
    matrices, room = MatrixFunction(free)(free.guess), directions(free, active)
    told = [
        f"{pair} {factor:.2g} times"
        for target, source in measurements(comparison, targets)
        if (found := residuals(free.model, matrices, target, source)) is not None
        for pair, factor in _far(found, room, target)
    ]
    if not told:
        return ""
    return f"measured responses are farther off than their stated errors, {listed(told)}, {WHY}"


def _far(found: Residuals, room: Array, target: FrequencyResponse) -> Iterator[tuple[str, float]]:
    """Pairs most of whose points are far off, and how many stated errors."""
    r, J = found.parts()
    J = J @ room
    size = np.linalg.norm(J, axis=0)
    J = J / np.where(size > 0, size, 1.0)
    left = (r - J @ np.linalg.lstsq(J, r, rcond=NOTHING)[0]).reshape(2, -1)
    power = (left**2).sum(axis=0) / 2
    for pair, at, own in found.white.runs():
        usual = min(np.median(power[own]) / np.log(2), np.mean(power[own]))
        freedom = 2 * found.white.independent * len(at) / len(power)
        if usual > FAR**2 and chdtrc(freedom, freedom * usual) < SELDOM:
            i, j = divmod(pair, len(target.inputs))
            yield f"{target.outputs[i]} after {target.inputs[j]}", float(np.sqrt(usual))


def measurements(
    comparison: Comparison, targets: Sequence[Target]
) -> list[tuple[FrequencyResponse, Source]]:
    """The measured ones of targets, each with its source or that in which all are put together."""
    merged = len(comparison.sources) < len(targets)
    sources = comparison.sources * len(targets) if merged else comparison.sources
    return [
        (target, source)
        for target, source in zip(targets, sources, strict=True)
        if isinstance(target, FrequencyResponse)
    ]


def directions(free: Free, active: BoolArray) -> Array:
    """Steps (nf, n) that bounds and relations leave the parameters, of their typical sizes."""
    scale = free.scale[free.index]
    rows = holding(free, free.guess, active) * scale
    room = scipy.linalg.null_space(rows) if len(rows) else np.eye(len(scale))
    return np.asarray(scale[:, None] * room)


def residuals(
    model: Model, matrices: Matrices, target: FrequencyResponse, source: Source
) -> Residuals | None:
    """A target's residuals at points that its source weighs; None without stated errors."""
    measured = steadied(target).take(np.flatnonzero(np.isin(target.omega, source.omega)))
    outputs = [name for name in measured.outputs if name in model.outputs]
    inputs = [name for name in measured.inputs if name in model.inputs]
    every = np.arange(len(measured.omega))
    place = np.ix_(every, *_places(measured, outputs, inputs))
    own = _places(model, outputs, inputs)
    at = np.searchsorted(source.omega, measured.omega)
    used, off = np.zeros(measured.G.shape, dtype=bool), np.zeros(measured.G.shape, dtype=complex)
    used[place] = source.W[np.ix_(at, *own)] > 0
    try:
        white = whitener(measured, used)
    except ValueError:  # none of these points states an error
        return None
    G, slopes = matrices.response_slopes(1j * measured.omega)
    by_lam = np.zeros((*off.shape, len(slopes)), dtype=complex)
    misses: ComplexArray = G[np.ix_(every, *own)] - source.G[np.ix_(at, *own)]
    off[place] = misses
    by_lam[place] = np.moveaxis(slopes, 0, -1)[np.ix_(every, *own)]
    return Residuals(white, white(off), white(by_lam))


def _places(
    of: FrequencyResponse | Model, outputs: Sequence[str], inputs: Sequence[str]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Positions of channels in a response or a structure."""
    return (
        np.array([of.outputs.index(name) for name in outputs], dtype=np.intp),
        np.array([of.inputs.index(name) for name in inputs], dtype=np.intp),
    )
