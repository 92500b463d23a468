"""Errors of poles so fast that samples of held inputs hardly show them.

Samples see of a mode its E = exp(λh), of steps with the gain g = -c b/λ times (1 - E)/(z - E),
which is g/z and no longer depends on λ where E vanishes. Between samples the response
g/(1 + jω τ), τ = -1/λ, does, but hardly: τ is between none and the fraction of an interval from
which on E shows. To first order the error of τ, that of E times h/(E ln² E), would grow beyond all
bounds; what E with its error allows, τ = -h/ln E, does not.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.subspace.fourier import Spectrum
from casid.subspace.modal import Modal

CURVED = 2.0  # of -ln E: above, errors of τ to first order are no less than those of E allow
UNSEEN = 4.0  # E of 2 %: τ up to a quarter of an interval is never excluded but by slopes


def held_interval(data: Sequence[Spectrum]) -> float | None:
    """The shortest interval [s] at which steps are held; None unless all inputs are such steps."""
    known = [s.h for s in data if s.h is not None and s.hold == "zoh"]
    return min(known) if known and len(known) == len(data) else None


def bounded(rows: Array, sizes: Array, modal: Modal, h: float) -> Array:
    """Errors (parameters, m) of a modal model, those of time constants of fast modes bounded.

    ``sizes`` (parameters,) are standard deviations. At fixed gains, -c b/λ, λ moves no farther than
    to the τ that E and its error allow, at most the interval ``h`` [s].
    """
    found = rows.copy()
    for k in np.flatnonzero(modal.real & (modal.lam.real < -CURVED / h)):
        rate = -float(modal.lam[k].real)
        most = h / np.clip(rate * h - np.log1p(h * sizes[k]), 1.0, min(UNSEEN, rate * h))
        share = min(1.0, (most - 1 / rate) * rate**2 / max(sizes[k], 1e-300))
        first = modal.order + modal.place(modal.D.shape[1])[0][k]
        found[first] -= np.outer(modal.B[k].real / -rate, (1 - share) * rows[k])
        found[k] *= share
    return found
