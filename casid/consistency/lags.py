"""How late one signal is after another: the peak of their correlation over lags.

Flight path reconstruction moves by small steps from clocks that nearly agree. Where loggers were
started by hand they may differ by seconds, which would pass there for scales or be named as its
largest skew: these are looked for first, of each attitude against what its rate turns.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.channels import ATTITUDES, RATES
from casid.consistency.measured import Flight

FARTHEST = 30.0  # s, of clocks
TURN = 0.5  # s: over which turns are compared
COHERENT, MORE = 0.85, 0.1  # correlation of a far lag, and by how much more than a near one's


def correlations(x: Array, y: Array, most: int) -> Array:
    """Correlation of x that many samples later with the middle of y, lags -most to most."""
    inner = y[most : len(y) - most]
    n = len(x) + len(inner)
    across = np.fft.irfft(np.fft.rfft(x, n) * np.fft.rfft(inner, n).conj(), n)[: 2 * most + 1]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    size = np.sqrt(np.sum(inner**2) * (power[len(inner) :] - power[: -len(inner)]).clip(0))
    return np.asarray(across / np.maximum(size, 1e-300))


def peak(values: Array, k: int) -> float:
    """Where between samples a parabola through three of them has its extreme."""
    a, b, c = values[k - 1 : k + 2]
    return float(k + (a - c) / (2 * (a - 2 * b + c)))


def clocks_apart(flights: Sequence[Flight], near: float) -> tuple[str, ...]:
    """Remarks on attitudes that come later or earlier than rates by more than ``near`` [s]."""
    flight = max(flights, key=lambda each: len(each.t), default=None)
    if flight is None:
        return ()
    step = max(1, round(TURN / flight.dt))
    most = int(min(FARTHEST, flight.t[-1] / 4) / flight.dt)
    inside = slice(most - int(near / flight.dt), most + int(near / flight.dt) + 1)
    said = []
    for rate, angle in zip(RATES, ATTITUDES, strict=True):
        if not {rate, angle} <= {*flight.values} or inside.start < 1:
            continue
        moves = flight.values[rate] - flight.values[rate].mean()
        turned = np.cumsum(moves) - moves / 2
        x, y = (z[step:] - z[:-step] for z in (flight.values[angle], turned))
        signed = correlations(x - x.mean(), y - y.mean(), most)
        alike = np.abs(signed)
        k, close = int(np.argmax(alike)), alike[inside]
        tops = close[1:-1][(close[1:-1] >= close[:-2]) & (close[1:-1] >= close[2:])]
        if not 0 < k < 2 * most or alike[k] < max(COHERENT, tops.max(initial=0.0) + MORE):
            continue
        if signed[k] < 0:  # half a period of an oscillation off, and no clock
            continue
        late = (peak(alike, k) - most) * flight.dt
        if abs(late) > near:
            where = "after" if late > 0 else "before"
            said.append(
                f"{angle} comes {abs(late):.2f} s {where} what {rate} turns (correlation "
                f"{alike[k]:.2f}): set the clocks of their loggers first, {-late:+.2f} s for "
                f"{angle} ([channels.join] clock, Record.join); kinematics unchecked"
            )
    return tuple(said)
