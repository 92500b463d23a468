"""Records, grid and window lengths made fit for spectra, or refused."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from casid.arrays import Array
from casid.autoregression import slow
from casid.errors import warn
from casid.excitations import excitation_if_any
from casid.record import Record
from casid.regridding import regridded
from casid.samples import moved
from casid.subspace.columns import excited_band, spectrum

GRID = 40  # frequencies unless given
BELOW_NYQUIST = 0.9  # where they end at the latest
BAND = 1.1  # ratio of frequencies over which an input's power is averaged
BELOW, BEYOND = 50, 3  # such bands on either side of the end that is looked for
CLEAR = 3.0  # times the power of what is fed back: two thirds come from outside
FEW_PERIODS = 2.0  # periods a window must hold to be trusted, T&R (7.41)


def excited_ends(records: Sequence[Record]) -> dict[str, float]:
    """Frequency [rad/s] above which an input is little but fed back noise, by its name.

    Noise that a controller feeds back looks like excitation and is coherent with the outputs: a
    response found from it is the controller's inverse (`casid.excitations`). Few lags smear the
    end of a sweep: it is where the input's own spectrum comes down to what is fed back above. An
    input whose spectrum does not come down is left out.
    """
    found = excitation_if_any(records)
    ends = {} if found is None else found.ends()
    clear = {name: _last_clear(records, name, end) for name, end in ends.items()}
    return {name: end for name, end in clear.items() if end > 0}


def _last_clear(records: Sequence[Record], name: str, end: float) -> float:
    """Frequency [rad/s] up to which an input's power is well above that beyond ``end``, or zero."""
    edges = end * BAND ** np.arange(-BELOW, BEYOND + 1.0)
    lines = [spectrum(record.t, record.channel(name)) for record in records]
    omega, energy = (np.concatenate(each) for each in zip(*lines, strict=True))
    power = np.histogram(omega, edges, weights=energy)[0] / np.diff(edges)
    clear = np.flatnonzero(power[:BELOW] > CLEAR * power[BELOW:].mean())
    return float(edges[clear[-1]]) if len(clear) else 0.0


def default_grid(records: Sequence[Record], ends: Mapping[str, float]) -> Array:
    """Frequencies [rad/s] from two periods of the longest window to what the inputs excite.

    ``ends`` as of `excited_ends`.
    """
    durations = [record.duration for record in records]
    low = FEW_PERIODS * 2 * np.pi / min(max(durations) / 2, sum(durations) / 5)
    nyquist = np.pi / max(record.dt for record in records)
    high = min(excited_band(records)[1], BELOW_NYQUIST * nyquist, *ends.values())
    return np.geomspace(low, max(high, 2 * low), GRID)


def default_windows(records: Sequence[Record], omega: Array, count: int = 5) -> tuple[float, ...]:
    """Window lengths [s] by the rules of T&R section 10.3."""
    # From 20 periods of the highest frequency to min(half the longest record, a fifth of all
    # records together, so that at least five windows are averaged), in equal ratios and over a
    # factor of two at least.
    total = sum(record.duration for record in records)
    longest = min(max(record.duration for record in records) / 2, total / 5)
    shortest = min(20 * 2 * np.pi / omega[-1], longest / 2)
    return tuple(float(length) for length in np.geomspace(shortest, longest, count))


def checked_grid(omega: Array, records: Sequence[Record]) -> Array:
    """The frequencies, increasing and below Nyquist's; a warning where they are too fine."""
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    if omega.ndim != 1 or not (omega > 0).all() or (np.diff(omega) <= 0).any():
        raise ValueError("omega: expected increasing frequencies above 0 rad/s, (K,)")
    slowest = max(records, key=lambda record: record.dt)
    if omega[-1] >= np.pi / slowest.dt:
        raise ValueError(
            f"omega reaches {omega[-1]:g} rad/s, but record {slowest.name!r} is sampled every "
            f"{slowest.dt:g} s: end the grid below Nyquist's {np.pi / slowest.dt:g} rad/s"
        )
    longest = max(record.duration for record in records)
    apart = 1 + (omega[-1] - omega[0]) * longest / (2 * np.pi)
    if len(omega) > apart:
        warn(
            f"{len(omega)} frequencies between {omega[0]:g} and {omega[-1]:g} rad/s are finer than "
            f"a record of {longest:g} s allows (about {apart:.0f}): neighbours repeat each other"
        )
    return omega


def equidistant(record: Record, highest: float) -> Record:
    """The record on equidistant instants, by a cubic spline where it is not so already.

    Inputs that are held by steps stay steps. An output is missing where the sample nearest to the
    instant is; a slow one is there at the instants nearest to its own samples, as it was before.
    ``highest`` is the frequency up to which it must hold [rad/s].
    """
    if record.equidistant:
        return record
    gap = float(np.diff(record.t).max())
    if highest >= np.pi / gap:
        at = float(record.t[np.argmax(np.diff(record.t))])
        raise ValueError(
            f"record {record.name!r} has a gap of {gap:g} s at t = {at:g} s (median interval "
            f"{record.dt:g} s), too long to interpolate up to {highest:g} rad/s; split the record "
            "there with cut()"
        )
    t = record.t[0] + record.dt * np.arange(int(record.duration / record.dt + 1e-6) + 1)
    if record.hold == "zoh":
        u = record.u[np.searchsorted(record.t, t + 1e-9 * record.dt, side="right") - 1]
    else:
        u = scipy.interpolate.make_interp_spline(record.t, record.u, k=3)(t)
    rare = slow(np.isnan(record.y))
    y = [
        regridded(record.t, x, t, "smooth", record.dt)
        if seldom
        else moved(record.t, x, t, "smooth")
        for x, seldom in zip(record.y.T, rare, strict=True)
    ]
    return replace(record, t=t, u=u, y=np.reshape(y, (record.ny, len(t))).T)


def checked_windows(
    windows: Sequence[float] | None, records: Sequence[Record], omega: Array
) -> list[float]:
    """Window lengths [s], increasing, within the longest record; the rules' unless given."""
    lengths = sorted(default_windows(records, omega) if windows is None else map(float, windows))
    longest = max(record.N * record.dt for record in records)
    if not lengths or not all(0 < length <= longest * (1 + 1e-9) for length in lengths):
        raise ValueError(
            f"windows={windows}: expected lengths between 0 and {longest:g} s, the longest record"
        )
    if omega[-1] < 2 * np.pi / lengths[-1]:
        raise ValueError(
            f"the longest window, {lengths[-1]:g} s, does not hold one period of the highest "
            f"frequency, {omega[-1]:g} rad/s; ask for higher frequencies or give longer records"
        )
    return lengths
