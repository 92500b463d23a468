"""How much a response depends on the size of the inputs.

Noise differs between manoeuvres that are flown alike; what a nonlinear aircraft does other than a
linear one depends on amplitude (R. Pintelon, J. Schoukens, System Identification: A Frequency
Domain Approach, 2nd ed., chapter 4: the best linear approximation is that of one class of inputs).
Where each axis was flown at two amplitudes, one response is estimated from the smaller and one from
the larger inputs. Linear, their difference is noise, of the size and correlation that both state:
leakage and other bias are alike where manoeuvres are. Two questions are asked: how large the
difference is point by point, and whether it is alike at all frequencies, or at a third of them, as
of a gain that changes, which shows where no single point does. Noise that a controller feeds back
biases the response to small inputs more: where it is told of, stated bias counts as noise, and what
differs is told from twice as much on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.display import Cells, Tabled
from casid.frequency.covariance import whitener
from casid.frequency.estimation import SpectralAnalysis
from casid.frequency.leakage import over_three
from casid.frequency.response import FED_BACK, FrequencyResponse
from casid.record import Record
from casid.records import MANOEUVRE, Records, input_levels, same_channels, stretches
from casid.slow_sources import repeats_known, tell_repeats
from casid.values import storable

RATIO = 1.5  # of two amplitudes, at least
KNOWN = 0.5  # relative errors up to which a point is compared
LEVEL = 3.5  # mean square of a pair's unit errors that noise does not reach in any
TOGETHER = 10.0  # that of a change alike at many frequencies, of two degrees of freedom
FED = 2.0  # times as much where noise is fed back
PARTS = 3  # of a pair's frequencies, whose change is asked by itself
FEWEST = 5  # frequencies of a pair
LINEAR = 25.0  # square of one of them, up to which it counts: single points prove nothing


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Distortion(Tabled):
    """How much of a response's change between amplitudes noise explains.

    Parameters
    ----------
    omega : (K,) array
        Frequencies [rad/s].
    inputs, outputs : tuple of str
        Channel names.
    small, large : (nu,) array
        Root mean square of each input in its two groups of records, at most.
    noise : (K, ny, nu) array
        Standard deviation of the difference of the two responses that noise makes,
        relative to the mean of the two; NaN where either is not known well enough.
    distortion : (K, ny, nu) array
        What the difference is beyond that, likewise, smoothed over three frequencies.
    excess : (ny, nu) array
        Mean square of the difference in independent standard errors, about one if linear, half as
        much counted where noise is fed back; NaN where fewer than five frequencies are known well
        enough.
    together : (ny, nu) array
        Largest mean square, likewise, of a change that is alike at all frequencies or at a third of
        them, of real and imaginary part; by how much the rest differs, where that is more.
    least : (ny, nu) array
        Relative change, alike at all frequencies, that would be told of in half of all flights.
    """

    omega: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    small: Array
    large: Array
    noise: Array
    distortion: Array
    excess: Array
    together: Array
    least: Array

    @property
    def nonlinear(self) -> bool:
        """Whether the response depends on amplitude by more than noise."""
        return bool((np.nan_to_num(self._surely()) > 1).any())

    def _surely(self) -> Array:
        """How far beyond noise each pair is, (ny, nu), told from one on; NaN if not known."""
        return np.asarray(np.maximum(self.excess / LEVEL, self.together / TOGETHER))

    def headline(self) -> str:
        """Its sentence."""
        return self.sentence()

    def cells(self) -> Cells:
        """Heading, and one row an output: what differs beyond noise, and what noise explains."""
        rows = []
        for i, output in enumerate(self.outputs):
            row = [output]
            for j in range(len(self.inputs)):
                differs, noise = self.distortion[:, i, j], self.noise[:, i, j]
                known = np.isfinite(differs) & np.isfinite(noise)
                parts = (100 * np.median(x[known]) for x in (differs, noise)) if known.any() else ()
                row.append(", noise ".join(f"{x:.2g} %" for x in parts) or "not known")
            rows.append(row)
        return ("between two amplitudes, median", *self.inputs), rows

    def sentence(self) -> str:
        """In words, with the pair and frequency at which it is clearest."""
        if not self.nonlinear:
            return self._unseen()
        sure = self._surely()
        i, j = (int(n) for n in np.unravel_index(np.nanargmax(sure), sure.shape))
        share = self.distortion[:, i, j] / np.maximum(self.noise[:, i, j], 0.01)
        k = int(np.nanargmax(share))
        return (
            f"the response depends on amplitude: {self.outputs[i]} after {self.inputs[j]} at "
            f"{self.omega[k]:.2g} rad/s differs by {100 * self.distortion[k, i, j]:.2g} % between "
            f"inputs of {self.small[j]:.2g} and {self.large[j]:.2g} (rms), of which noise explains "
            f"{100 * self.noise[k, i, j]:.2g} %; a linear model holds for one of them"
        )

    def _unseen(self) -> str:
        """What is said where nothing shows: how much would have."""
        if not np.isfinite(self.least).any():
            return (
                "the responses at two amplitudes are not known well enough to say whether they "
                "differ: repeat the manoeuvres, or fly larger ones"
            )
        (i, j), (k, m) = (
            np.unravel_index(at(self.least), self.least.shape)
            for at in (np.nanargmin, np.nanargmax)
        )
        told = f"{100 * self.least[i, j]:.2g} % ({self.outputs[i]} after {self.inputs[j]})"
        if (i, j) != (k, m):
            told += f" to {100 * self.least[k, m]:.2g} % ({self.outputs[k]} after {self.inputs[m]})"
        return (
            "the response at two amplitudes differs by no more than noise, which hides changes of "
            f"a response's gain of less than {told}"
        )


def distortion(records: Records, *, omega: Array | None = None) -> Distortion:
    """Noise and nonlinear distortion of a response, told apart by two amplitudes.

    Parameters
    ----------
    records : sequence of Record
        Manoeuvres of every axis at two amplitudes whose ratio is 1.5 or more, alike in all else:
        repeated sweeps, or 3-2-1-1.
    omega : (K,) array
        Frequencies [rad/s], as of `frequency_response`.

    Raises
    ------
    ValueError
        A manoeuvre that was not flown at two amplitudes.
    """
    flown = stretches(records)
    inputs, outputs = same_channels(flown)
    groups, sizes = _by_amplitude(flown)
    tell_repeats(flown)
    with repeats_known():
        grid = SpectralAnalysis(omega=omega).fit(groups[1]).omega
        low, high = (SpectralAnalysis(omega=grid).fit(group) for group in groups)
    both = (low.random_error < KNOWN) & (high.random_error < KNOWN)
    noise, excess, together, least = _difference(low, high, both)
    mean = np.abs(low.G + high.G) / 2
    squared = np.where(both, np.abs(high.G - low.G) ** 2 / mean**2 / 2 - noise**2, np.nan)
    return Distortion(
        omega=grid, inputs=inputs, outputs=outputs, small=sizes[0], large=sizes[1], noise=noise,
        distortion=np.sqrt(2 * np.maximum(over_three(squared), 0.0)), excess=excess,
        together=together, least=least,
    )  # fmt: skip


def _by_amplitude(
    records: Sequence[Record],
) -> tuple[tuple[list[Record], list[Record]], tuple[Array, Array]]:
    """Records of smaller and of larger inputs, and the root mean squares of these (nu,)."""
    size = np.array([np.std(record.u, axis=0) for record in records])
    level, cosine = input_levels(size)
    groups: tuple[list[int], list[int]] = ([], [])
    left = list(range(len(records)))
    while left:
        own = [k for k in left if cosine[left[0], k] > MANOEUVRE]
        left = [k for k in left if k not in own]
        smallest, largest = level[own].min(), level[own].max()
        if largest < RATIO * smallest:
            raise ValueError(
                f"manoeuvre {records[own[0]].name!r} ({len(own)} records that move the inputs "
                f"alike) was not flown at two amplitudes, the largest is {largest / smallest:.3g} "
                f"times the smallest; give records of {RATIO:g} times the size as well"
            )
        for k in own:
            groups[int(level[k] > np.sqrt(smallest * largest))].append(k)
    small, large = (size[group].max(axis=0) for group in groups)
    return ([records[k] for k in groups[0]], [records[k] for k in groups[1]]), (small, large)


def _difference(
    low: FrequencyResponse, high: FrequencyResponse, both: BoolArray
) -> tuple[Array, Array, Array, Array]:
    """Relative error of the difference of two responses, and of every pair what it says.

    Its mean square in such errors, the largest of a change alike at many frequencies, and that
    which would be told.
    """
    mean = (low.G + high.G) / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        parts = [np.abs(each.G) * _errors(each) / np.abs(mean) for each in (low, high)]
    noise = np.where(both, np.hypot(*parts), np.nan)
    known = {name: (getattr(low, name) + getattr(high, name)) / 2
             for name in ("output_correlation", "input_correlation", "resolution")}  # fmt: skip
    stated = replace(low, G=mean, random_error=noise, leakage=0 * noise, flags={}, **known)
    excess, together, least = (np.full(both.shape[1:], np.nan) for _ in range(3))
    for i, j in np.argwhere(both.sum(axis=0) >= FEWEST):
        alone = np.zeros_like(both)
        alone[:, i, j] = both[:, i, j]
        white = whitener(stated, alone)
        rows = white(high.G - low.G)
        squares = np.concatenate([rows.real, rows.imag]) ** 2
        excess[i, j] = np.mean(np.minimum(squares, LINEAR))
        at = np.flatnonzero(both[:, i, j])
        shapes = np.zeros((*mean.shape, 1 + PARTS), dtype=complex)
        for n, part in enumerate([at, *np.array_split(at, PARTS)]):
            shapes[part, i, j, n] = mean[part, i, j]
        columns = white(shapes)
        sizes = np.linalg.norm(columns, axis=0)
        rest = rows - columns[:, 1:] @ np.linalg.lstsq(columns[:, 1:], rows, rcond=None)[0]
        more = np.sqrt(np.maximum(np.mean(np.abs(rest) ** 2) / 2 * len(at) / (len(at) - PARTS), 1))
        together[i, j] = np.max(np.abs(columns.conj().T @ rows / sizes / more) ** 2) / 2
        least[i, j] = np.sqrt(2 * TOGETHER) * more / sizes[0]
    fed = np.where(_fed_back(low) | _fed_back(high), FED, 1.0)
    return noise, excess / fed, together / fed, least * np.sqrt(fed)


def _errors(response: FrequencyResponse) -> Array:
    """Relative errors of a response that need not be those of another, (K, ny, nu)."""
    error, fed = response.random_error, _fed_back(response)
    return np.where(fed, np.hypot(error, response.leakage), error)


def _fed_back(response: FrequencyResponse) -> BoolArray:
    """Which inputs (nu,) carry noise in which a response is lost."""
    return np.array([FED_BACK.format(name) in response.flags for name in response.inputs])
