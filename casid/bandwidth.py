"""What the standard errors of a fit make of its handling qualities.

First order, as in `casid.bands`. A model's response is known at any frequency: it is read where it
is evaluated, not interpolated between the frequencies that were given.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.bands import checked_frequencies
from casid.baseline.handling import HandlingQualities, handling_qualities
from casid.display import Shown
from casid.fit import AnyFit
from casid.frequency.response import FrequencyResponse
from casid.model import Model
from casid.propagation import spread
from casid.threads import one_thread
from casid.undermodelling import Undermodelling

DRAWS = 100  # of what a structure misses
FAR = 4.0  # standard deviations of readings that belong elsewhere
OFTEN = 0.05  # of the draws, for which a remark says so
FINE = 0.02  # of log ω, that frequencies are apart at most between which nothing is passed over
MET = 1e-10  # of log ω, from a reading to a frequency of the response: interpolation is exact
ROUNDS = 60  # of frequencies put where a response is read


@dataclass(frozen=True, kw_only=True, repr=False)
class HandlingBand(Shown):
    """Bandwidth and phase delay of a fit with standard deviations.

    Parameters
    ----------
    bandwidth, bandwidth_std : float
        [rad/s], ADS-33.
    phase_delay, phase_delay_std : float
        [s].
    remarks : tuple of str
        What to know before believing the numbers, and why one is missing (NaN).
    """

    bandwidth: float
    bandwidth_std: float
    phase_delay: float
    phase_delay_std: float
    remarks: tuple[str, ...] = ()

    def headline(self) -> str:
        """Both, with their standard deviations, or why not."""
        told = f"bandwidth {self.bandwidth:.3g} ± {self.bandwidth_std:.2g} rad/s"
        if np.isfinite(self.phase_delay):
            told += f", phase delay {self.phase_delay:.3g} ± {self.phase_delay_std:.2g} s"
        return "; ".join((f"{told} (1σ)", *self.remarks))


@one_thread
def handling_band(
    fit: AnyFit,
    pair: tuple[str, str],
    omega: Array,
    *,
    error: Undermodelling | None = None,
    **reading: Any,  # noqa: ANN401 - as `handling_qualities` takes them
) -> HandlingBand:
    """Bandwidth and phase delay of a fit's attitude response with their standard deviations.

    Of a nonlinear structure's fit they are those of the linearisation at its reference condition.

    Parameters
    ----------
    fit : Fit
        With a covariance.
    pair : (output, input)
        Attitude, or rate, and stick.
    omega : (K,) array
        Frequencies [rad/s] to read between, from the least to the largest, beyond twice the one
        where the phase passes -180°. How close they are does not matter.
    error : Undermodelling
        What the structure misses, from `structure_error`: its part comes from 100 draws.
    **reading
        ``kind`` ("attitude" or "rate"), ``sign``, ``attitude_command`` of `handling_qualities`.

    Raises
    ------
    ValueError
        A fit without covariance, an open loop, and what `handling_qualities` raises.
    """
    if reading.get("kind") == "loop":
        raise ValueError(
            'kind="loop": expected "attitude" or "rate", as a loop has no bandwidth; read its '
            "margins with handling_qualities, on each of sample_models for their spread"
        )

    def qualities(omega: Array, G: ComplexArray) -> HandlingQualities:
        return handling_qualities(_exact(fit.model, omega, G), pair, **reading)

    def read(G: ComplexArray) -> Array:
        return _numbers(qualities(omega, G))

    def of(model: Model) -> Array:
        with suppress(ValueError):  # a phase that does not pass -180° any more
            return _numbers(_settled(model, omega, qualities))
        return np.full(2, np.nan)

    omega = checked_frequencies(omega)
    omega = np.union1d(omega, _between(omega))
    error = None if error is None else error.of(fit)
    found = _settled(fit.model, omega, qualities)
    std, G = spread(fit, of), fit.model.system().response(omega)
    said = found.remarks
    if (np.isnan(std) & np.isfinite(_numbers(found))).any():
        said += (
            "models next to the estimate have no such reading in the band, so its standard "
            "deviation is unknown: extend the grid, or fix what the records hardly determine",
        )
    if error is not None:
        drawn = _drawn(read, G, error.drawn(omega, G, DRAWS))
        ends = np.array([_typical(column[np.isfinite(column)]) for column in drawn.T])
        wide = np.ptp(ends, axis=1) / 2
        std, said = np.hypot(std, wide), (*said, *_elsewhere(drawn, ends.mean(axis=1), wide))
    of_bandwidth, of_delay = std.tolist()
    errors = {"bandwidth_std": of_bandwidth, "phase_delay_std": of_delay}
    read_off = {name: getattr(found, name) for name in ("bandwidth", "phase_delay")}
    return HandlingBand(**read_off, **errors, remarks=said)


def _numbers(found: HandlingQualities) -> Array:
    """Bandwidth and phase delay, (2,)."""
    return np.array([found.bandwidth, found.phase_delay])


def _between(omega: Array) -> Array:
    """Frequencies from the least to the largest, so close that no crossing is passed over."""
    low, high = float(omega.min()), float(omega.max())
    return np.geomspace(low, high, 1 + int(np.ceil(np.log(high / low) / FINE)))


def _settled(
    model: Model, omega: Array, qualities: Callable[[Array, ComplexArray], HandlingQualities]
) -> HandlingQualities:
    """What is read of a model's response, known wherever it is read and not interpolated there."""
    system, top = model.system(), omega[-1]
    found = qualities(omega, G := system.response(omega))
    for _ in range(ROUNDS):
        at = np.array([found.omega_180, found.bandwidth_phase, found.bandwidth_gain])
        at = np.append(at, 2 * found.omega_180)
        at = np.unique(at[at <= top])  # a NaN is not
        at = at[np.abs(np.log(at[:, None] / omega)).min(axis=1) > MET]
        if not len(at):
            break
        order = np.argsort(omega := np.append(omega, at))
        omega, G = omega[order], np.concatenate([G, system.response(at)])[order]
        found = qualities(omega, G)
    return found


def _typical(values: Array) -> Array:
    """Between which values as many are as within a standard deviation of a normal number, (2,)."""
    if not len(values):
        return np.full(2, np.nan)
    return np.asarray(np.quantile(values, scipy.special.ndtr([-1.0, 1.0])))


def _elsewhere(drawn: Array, center: Array, wide: Array) -> tuple[str, ...]:
    """That of draws (n, 2) many could not be read, or elsewhere: no deviation says that."""
    # Where a phase comes near a line again, a small change of it makes a large one of the reading.
    off = ~(np.abs(drawn - center) <= FAR * np.maximum(wide, 1e-300)) & ~np.isnan(center)
    count = DRAWS - len(drawn) + int(off.any(axis=1).sum())
    if count <= OFTEN * DRAWS:
        return ()
    return (
        f"of {DRAWS} responses that the structure's error allows, {count} have no bandwidth or "
        "phase delay near these: the standard deviations are those of the others",
    )


def _drawn(read: Callable[[ComplexArray], Array], G: ComplexArray, errors: ComplexArray) -> Array:
    """What is read of a response with each of its errors, where anything is."""
    found = []
    for error in errors:
        with suppress(ValueError):  # a phase that never passes -180°
            found.append(read(G + error))
    if len(found) < len(errors) / 2:
        raise ValueError(
            "what the structure misses may be as large as the response itself, so neither "
            "bandwidth nor phase delay is known; try a richer structure"
        )
    return np.array(found)


def _exact(model: Model, omega: Array, G: ComplexArray) -> FrequencyResponse:
    """A response in a model's channels as a measured one without error."""
    ones = np.ones(G.shape)
    return FrequencyResponse(
        omega=omega,
        G=G,
        coherence=ones,
        random_error=0 * ones,
        inputs=model.inputs,
        outputs=model.outputs,
        input_std=np.ones(G.shape[2]),
        output_std=np.ones(G.shape[1]),
    )
