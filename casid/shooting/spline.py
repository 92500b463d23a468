"""Delayed inputs, smooth in the delay.

The delayed input u(t - τ) is read off the interpolating cubic spline through the samples, so its
derivative with respect to τ is continuous and no Padé states are needed. On equidistant samples
this is the sum of taps B3(i - τ/h) on the cubic B-spline coefficients (Unser, IEEE Signal
Processing Magazine 16(6), 1999); the spline itself serves any spacing. The samples are padded with
the first value before the coefficients are computed: the input rests before the record.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from casid.arrays import Array
from casid.record import Record

PAD = 12  # samples before the longest delay; a knot's influence falls by 0.27 a sample


class DelayedInput:
    """The inputs of one record at t - τ.

    Parameters
    ----------
    record : Record
        Whose inputs are delayed.
    longest : float
        Longest delay to come [s].
    """

    def __init__(self, record: Record, longest: float) -> None:
        h = record.dt
        count = int(np.ceil(max(longest, 0.0) / h)) + PAD
        before = record.t[0] - h * np.arange(count, 0, -1)
        t = np.concatenate([before, record.t])
        u = np.concatenate([np.repeat(record.u[:1], count, axis=0), record.u])
        self._t = record.t
        self._first = t[0]
        self._splines = [CubicSpline(t, column, bc_type="natural") for column in u.T]

    def at(self, tau: Array) -> tuple[Array, Array]:
        """Inputs (N, nu) at the record's instants for the delays τ (nu,), and their τ-derivatives.

        An input with delay zero comes out as its samples.
        """
        pairs = self._pairs(tau)
        u = np.array([spline(t) for spline, t in pairs]).T
        return u, -np.array([spline(t, 1) for spline, t in pairs]).T

    def bend(self, tau: Array) -> Array:
        """Second τ-derivatives (N, nu)."""
        return np.array([spline(t, 2) for spline, t in self._pairs(tau)]).T

    def _pairs(self, tau: Array) -> list[tuple[CubicSpline, Array]]:
        at = [np.maximum(self._t - d, self._first) for d in tau]
        return list(zip(self._splines, at, strict=True))
