"""Fourier transforms of whole records, as the frequency-domain likelihood takes them.

On the lines z = e^{j2πk/N}, k = 1 … N/2, of an equidistant record of N samples

    Y = (1/√N) Σ_n y_n z^{-n},

so that white noise has its variance on every line; at k = 0, which is left out, stand the biases.
Between samples the inputs are what the record's hold makes of them, delayed exactly: the three
signals of `casid.intersample.DelayedInput`, transformed, stand behind one another.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.autoregression import filled
from casid.intersample import ROUNDING, DelayedInput, delayed_input
from casid.record import Record
from casid.records import same_interval

LOST = 0.2  # share of an output's samples that may be filled in
FEWEST = 8  # lines of a record at least
ALIKE = 1.5  # ratio of durations of records of one kind


@dataclass(frozen=True, eq=False)
class Lines:
    """One record in the frequency domain."""

    record: Record
    dt: float  # its sampling interval [s]
    kind: int  # number of the kind of manoeuvre, whose records share a noise spectrum
    z: ComplexArray  # (K,)
    omega: Array  # (K,) [rad/s]
    weight: Array  # (K,) how many of two conjugate lines it stands for: 2, 1 at Nyquist's
    Y: ComplexArray  # (K, ny), 0 where the output was not measured
    seen: BoolArray  # (ny,) outputs that were
    inputs: "HeldLines" = field(repr=False)

    def below(self, omega: float) -> "Lines":
        """The same up to a frequency [rad/s], or its first few lines."""
        K = max(FEWEST, int(np.searchsorted(self.omega, omega, side="right")))
        z, Y = self.z[:K], self.Y[:K]
        return replace(self, z=z, Y=Y, omega=self.omega[:K], weight=self.weight[:K])


def transformed(records: Sequence[Record]) -> list[Lines]:
    """Records on their lines, sorted into kinds: one sampling interval, durations that are alike.

    ValueError: an uneven sampling, an output with more than a fifth of its samples missing.
    """
    each = zip(records, kinds(records), strict=True)
    return [_lines(record, kind) for record, kind in each]


def kinds(records: Sequence[Record]) -> list[int]:
    """Number of each record's kind: one sampling interval, durations that are alike."""
    order = sorted(range(len(records)), key=lambda i: (records[i].dt, records[i].duration))
    found, last, kind = [0] * len(records), records[order[0]], 0
    for i in order:
        if not same_interval(records[i], last) or records[i].duration > ALIKE * last.duration:
            kind, last = kind + 1, records[i]
        found[i] = kind
    return found


def _lines(record: Record, kind: int) -> Lines:
    if not record.equidistant:
        raise ValueError(
            f"record {record.name!r} is not sampled evenly, as transforms need it: resample() it, "
            'or estimate in the time domain, domain="time"'
        )
    lost = np.isnan(record.y).mean(axis=0)
    seen = lost < 1
    for name, share in zip(record.outputs, lost, strict=True):
        if LOST < share < 1:
            raise ValueError(
                f"record {record.name!r}: {share:.0%} of the samples of {name!r} are missing, too "
                'many for a transform; leave the channel out, or estimate with domain="time"'
            )
    whole = filled(record)[0]
    N = record.N
    k = np.arange(1, N // 2 + 1)
    Y = np.fft.rfft(np.where(seen, whole.y, 0.0), axis=0)[1:] / np.sqrt(N)
    angle = 2 * np.pi * k / N
    weight = np.where(2 * k == N, 1.0, 2.0)
    held = replace(record, y=whole.y)
    return Lines(
        held, record.dt, kind, np.exp(1j * angle), angle / record.dt, weight, Y, seen,
        HeldLines(held),
    )  # fmt: skip


class HeldLines:
    """Delayed inputs of one record on its lines.

    Between two whole numbers of samples they are linear in the delay: transformed once there.
    """

    def __init__(self, record: Record) -> None:
        self._record = record
        self._kept: tuple[bytes, ComplexArray, Array] | None = None
        t, k = record.t, np.arange(record.N)
        h = (t[-1] - t[0]) / (record.N - 1)
        self._step = float(h) if np.abs(t - t[0] - h * k).max() <= ROUNDING * h / 4 else None

    def at(self, tau: Array, within: Array, count: int) -> tuple[ComplexArray, Array]:
        """Value, slope and jump of every delayed input on ``count`` lines (K, 3 nu), its rest [s].

        Delayed by tau (nu,) [s], breaks and samples in the order that they have ``within``.
        """
        record, h = self._record, self._step
        if h is None or (within < 0).any():
            held = delayed_input(record.t, record.u, tau, record.hold, within)
            return _transformed(held, record.N, count)
        end = h * np.ceil(within / h - ROUNDING)
        if self._kept is None or self._kept[0] != end.tobytes():
            held = delayed_input(record.t, record.u, end, record.hold, within)
            self._kept = end.tobytes(), *_transformed(held, record.N, record.N)
        _, whole, rest = self._kept
        nu, S, earlier = len(tau), whole[:count].copy(), end - tau
        S[:, :nu] += S[:, nu : 2 * nu] * earlier
        return S, rest + earlier


def _transformed(held: DelayedInput, n: int, count: int) -> tuple[ComplexArray, Array]:
    """On ``count`` lines of ``n`` samples, but that of zero.

    In an equidistant record the breaks of one input lie equally far before the next sample: the
    rest, (nu,), 0 where there is none.
    """
    nu = held.value.shape[1]
    jumps, rest = np.zeros((n, nu)), np.zeros(nu)
    jumps[held.step, held.channel] = held.jump
    for j in range(nu):
        mine = held.rest[held.channel == j]
        rest[j] = mine.mean() if len(mine) else 0.0
    signals = np.hstack([held.value, held.slope, jumps])
    return np.fft.rfft(signals, axis=0)[1 : count + 1] / np.sqrt(n), rest
