"""Encirclements of -1 by an open loop's response, with what lies below its band.

H. Nyquist, Regeneration Theory, Bell System Technical Journal 11, 1932: closed, a loop has as many
unstable poles as the open one and twice the clockwise encirclements by the half of the curve that
has positive frequencies. These are the passages of the phase through -180° downwards above 0 dB,
less those upwards, from real positive s, where the response is real, along the axis to the last
frequency; one that begins at -180° counts as half a passage. What lies below the band follows from
its lower end, if the gain is above 0 dB there: of a loop without zeros or poles to the right phase
and slope of the gain belong together, -90° to -20 dB a decade (H. W. Bode, Network Analysis and
Feedback Amplifier Design, 1945, chapter 14). Apart by half a turn, and steadily so, they are those
of a loop that is negative where s is small: it encircles -1 by half a turn from there.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from casid.arrays import Array

Beginning = Literal["plain", "reversed", "untold"]

OCTAVES = 2  # at the lower end, which must agree
POINTS = 3  # of a slope at least
SLOPE = 20 / np.log(10)  # dB of a factor e in gain

# Degrees, by loops with known poles, open and closed; `tests/baseline/test_encirclements.py`.
NEAR = 60.0  # between the two ends of an octave's sign, which are 180 apart
STEADY = 45.0  # from octave to octave: poles to the right and light modes turn it by more
LEAD = 10.0  # above zero that are none, and per factor e: unstable poles and leads raise it more
TOLD = 45.0  # from where phase and slope of the gain surely belong together
_PLAIN: tuple[Beginning, float] = ("plain", 0.0)


@dataclass(frozen=True, kw_only=True)
class Encirclements:
    """Clockwise encirclements of -1 at positive frequencies, in halves, and how they begin.

    ``beginning`` is what the lower end of the band says of the frequencies below it: "plain", or
    "reversed" of a loop that is negative there, or "untold" where several would make it so.
    """

    number: float
    beginning: Beginning
    phase: float  # degrees in (-180, 180], at the lowest frequency
    slope: float  # dB a decade, there

    @property
    def unstable(self) -> bool:
        """Whether the loop is unstable when closed, whatever it is when open."""
        return self.number > 0

    @property
    def poles(self) -> int:
        """How many unstable poles an open loop must have that is stable when closed."""
        return max(0, round(-2 * self.number))


def encirclements(x: Array, gain: Array, phase: Array) -> Encirclements:
    """Encirclements by a curve at log ω ``x``, (K,): ``gain`` in dB, ``phase`` unwrapped in °."""
    octaves = [_octave(x, gain, phase, k) for k in range(OCTAVES)]
    first, fall = wrapped(float(phase[0])), octaves[0][0]
    beginning, below = _below(first, octaves) if gain[0] > 0 else _PLAIN
    number = below + _inside(gain, phase)
    return Encirclements(number=number, beginning=beginning, phase=first, slope=-20 * fall)


def wrapped(degrees: float) -> float:
    """An angle in (-180, 180]."""
    return float(180 - (180 - degrees) % 360)


def _octave(x: Array, gain: Array, phase: Array, k: int) -> tuple[float, float, float]:
    """Powers of ω by which the gain falls, phase less what belongs to it, rise of the phase."""
    start, width = x[0] + k * np.log(2), np.log(2)
    at = np.flatnonzero((x >= start - 1e-9) & (x <= start + width + 1e-9))
    if len(at) < POINTS:
        begin = min(int(np.searchsorted(x, start - 1e-9)), len(x) - POINTS)
        at = np.arange(begin, begin + POINTS)
    fall = -float(np.polyfit(x[at], gain[at] / SLOPE, 1)[0])
    rise = float(np.polyfit(x[at], phase[at], 1)[0])
    return fall, float(np.mean(phase[at])) + 90 * fall, rise


def _below(first: float, octaves: list[tuple[float, float, float]]) -> tuple[Beginning, float]:
    """How the curve begins, and its passages from real positive s to the lowest frequency."""
    fall, sign, rise = octaves[0]
    away = max(abs(wrapped(each - 180)) for _, each, _ in octaves)
    if away < NEAR and abs(octaves[-1][1] - sign) < STEADY:
        return "reversed", _passages(180.0, first, fall)
    if -180 < first <= LEAD:
        return _PLAIN
    if abs(wrapped(sign)) < TOLD:
        return "plain", _passages(0.0, first, fall)
    return ("plain" if rise > LEAD else "untold"), 0.0


def _passages(start: float, end: float, fall: float) -> float:
    """Passages through -180° downwards on the arc from real s, to the turn that is next to it."""
    end += 360 * np.round((start - 90 * fall - end) / 360)
    return _level(start) - _level(end)


def _level(phase: float) -> float:
    """Whole turns below a phase from -180° on; in the middle between two where it is one."""
    turns = (phase - 180) / 360
    return float(np.floor(turns) + np.ceil(turns)) / 2


def _inside(gain: Array, phase: Array) -> float:
    """Passages through -180° downwards above 0 dB in the band, less those upwards."""
    turn = np.floor((phase - 180) / 360)
    at = np.flatnonzero(np.diff(turn))
    level = 180 + 360 * np.maximum(turn[at], turn[at + 1])
    part = (level - phase[at]) / (phase[at + 1] - phase[at])
    above = gain[at] + part * (gain[at + 1] - gain[at]) > 0
    return float(np.sum((turn[at] - turn[at + 1])[above]))
