"""Channels at slower, faster or another logger's instants: filtered where need be, none made up."""

from collections.abc import Sequence

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.samples import SLOWER, Between, as_it_is, at_instants

MADE_UP = 0.1  # of a low-pass filter's weight on lost samples: what it gives is lost, too
PASS = 0.8  # of the new Nyquist frequency: what is above it is taken out before sampling slower


def resampled(t: Array, columns: Sequence[tuple[Array, Between]], dt: float) -> tuple[Array, Array]:
    """Instants every ``dt`` [s] and the columns there, (M,) and (M, columns)."""
    grid = t[0] + dt * np.arange(int((t[-1] - t[0]) / dt + 1e-6) + 1)
    read = [regridded(t, x, grid, how, dt, finer=True) for x, how in columns]
    return grid, np.column_stack(read)


def joined(
    t: Array, columns: Sequence[tuple[Array, Between]], instants: Array, dt: float, *, steps: bool
) -> Array:
    """Columns of another logger at a record's instants, (M, columns), ``steps`` unfiltered."""
    read = [
        at_instants(t, x, instants, how)
        if steps and how == "zoh"
        else regridded(t, x, instants, how, dt)
        for x, how in columns
    ]
    return np.reshape(read, (len(columns), len(instants))).T


def regridded(
    t: Array, x: Array, instants: Array, between: Between, dt: float, *, finer: bool = False
) -> Array:
    """One channel x (N,) of instants t (N,) at others (M,), every ``dt`` or so [s].

    Where they are slower than the channel's instants by half or more, it passes a filter first. A
    smooth one that was measured more rarely is NaN but for the instants nearest to its samples: a
    curve between them would pass for measurements of their own. More rarely is than on either
    instants or, where ``finer`` ones are asked for, than on its own.
    """
    values, own = at_instants(t, x, instants, between), float(np.median(np.diff(t)))
    taken = t[~np.isnan(x)]
    usual = own if finer else min(own, dt)
    if between == "smooth" and len(taken) > 1 and np.median(np.diff(taken)) >= SLOWER * usual:
        values = np.where(_nearest(instants, taken, dt), values, np.nan)
    if dt < SLOWER * own or np.isnan(values).all():
        return values
    return np.where(np.isnan(values), np.nan, _filtered(t, x, instants, between, dt))


def _nearest(instants: Array, taken: Array, dt: float) -> BoolArray:
    """Which instants (M,) are the nearest to one that a sample was taken at (n,) [s]."""
    at = np.searchsorted((instants[:-1] + instants[1:]) / 2, taken)
    near = np.zeros(len(instants), dtype=bool)
    near[at[np.abs(instants[at] - taken) <= 0.51 * dt]] = True
    return near


def _filtered(t: Array, x: Array, instants: Array, between: Between, dt: float) -> Array:
    """A channel at slower instants (M,), low-passed; NaN where it is mostly of lost samples."""
    # From the first sample to the last, so that nothing is made up beyond.
    count = round((t[-1] - t[0]) / float(np.median(np.diff(t)))) + 1
    even, own = np.linspace(t[0], t[-1], count, retstep=True)
    fast = at_instants(t, x, even, between)
    lost = np.isnan(fast)
    fast[lost] = np.interp(even[lost], even[~lost], fast[~lost])
    (smooth,) = smoothed(fast[:, None], dt / own).T
    smooth = as_it_is(smooth, fast, float(np.abs(fast).max()))  # what rests does so exactly
    # What was put in for lost samples is no measurement, nor what is mostly made of it.
    share = scipy.ndimage.convolve1d(lost.astype(float), np.abs(taps(dt / own)), mode="constant")
    made = np.interp(instants, even, share) > MADE_UP
    return np.where(made, np.nan, at_instants(even, smooth, instants, "smooth"))


def taps(ratio: float) -> Array:
    """Weights of the low-pass filter of `smoothed`, (taps,), their sum one."""
    half = int(np.ceil(8 * ratio))
    k = np.arange(-half, half + 1)
    weights = np.sinc(PASS * k / ratio) * np.hanning(2 * half + 3)[1:-1]
    return np.asarray(weights / weights.sum())


def smoothed(x: Array, ratio: float) -> Array:
    """Equidistant columns without what an interval ``ratio`` times as long would fold back."""
    # A symmetric filter, so that nothing is late; alike for all channels, so that responses stay.
    weights = taps(ratio)
    half = len(weights) // 2
    padded = np.pad(x, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    return np.column_stack([np.convolve(column, weights, mode="valid") for column in padded.T])
