"""Whether records agree: what a channel of one of them is, seen from the model of all.

A record may hold a channel of another gain, that is late or whose clock runs at another rate. Each
such fault adds to the residuals of the refined black box, to first order, a known signal, which
least squares tell from what another model would do: the score test of one more parameter. What the
black box misses is no noise, so that the errors come from how far bands of frequency and the other
records pull an estimate apart, and a fault must explain most of what is left of its channel.
Source: C. R. Rao, Linear Statistical Inference and Its Applications, 2nd ed., section 6e; errors by
H. White, Econometrica 50, 1982.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace import modal as modes
from casid.subspace.campaign import Campaign
from casid.subspace.fourier import Spectrum, parts, spectrum
from casid.subspace.refinement import linearised, noise_weights, normal_equations

# What nonlinear aircraft show between manoeuvres: a fault is larger by `CLEAR` errors. A clock is
# tried at several rates, of which the right one explains all, the coefficient being one.
SLIGHT = {"gain": 0.1, "delay": 0.02, "clock": 0.5}
MISSING = 2.0  # times as much where the model misses dynamics
CLEAR = 2.5
FAR = {"gain": 0.6, "delay": 0.3, "clock": np.inf}  # beyond, what first order says is no size
SHARE = 0.4  # of what is left of its channel, or by an input of all: a fault explains that much
TOLD = 0.2  # of a fault's signal: what no other model explains
BAND = 0.3  # in natural logarithms of ω
FASTEST = 0.024  # rate of clocks that are tried, less one
APART = 0.15  # s, by which clocks that are tried differ at the end of a record
SIMPLER = 1.4  # times as much must a clock explain as a delay does


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One channel of one record as it may be."""

    record: str
    channel: str
    kind: str  # a key of `SLIGHT`
    size: float  # gain less one, s late, or rate less one
    error: float = 0.0

    def told(self) -> str:
        """What it is, and what to do."""
        name, size, error = self.channel, self.size, self.error
        if abs(size) > FAR[self.kind]:
            how = "gain, sign or unit" if self.kind == "gain" else "delay"
            return (
                f"Record {self.record}, or another that moves {name} as much, disagrees with the "
                f"others: {name} is of another {how} than their model predicts. Look at sensor and "
                "logger of these records: leave out the wrong one, or mend the channel."
            )
        what = {
            "gain": f"{name} is {1 + size:.2f} ± {error:.2f} times what",
            "delay": f"{name} is {1e3 * abs(size):.0f} ± {1e3 * error:.0f} ms "
            f"{'later' if size > 0 else 'earlier'} than",
            "clock": f"the clock of {name} runs {100 * abs(size):.1f} % "
            f"{'slower' if size > 0 else 'faster'} than",
        }[self.kind]
        return (
            f"Record {self.record} disagrees with the others: {what} their model predicts. "
            f"Look at sensor and logger of this record, and of others that move {name} as much: "
            "leave out the wrong one, or mend the channel."
        )


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of a record, its transforms, their weights, and responses (K, ny, nu) of the model.

    Channels are scaled by ``su`` and ``sy``.
    """

    record: Record
    lines: Spectrum
    w: Array
    G: ComplexArray
    su: Array
    sy: Array

    def signals(self, e: ComplexArray) -> Iterator[tuple[Fault, ComplexArray]]:
        """Every possible fault, and what it adds to the outputs' transforms (K, ny).

        ``e`` (K, ny) is what the model leaves of these.
        """
        record, s = self.record, 1j * self.lines.omega[:, None]
        y = record.y / self.sy
        ends = (y[-3:].mean(axis=0) - y[:3].mean(axis=0)) / np.sqrt(record.duration)
        Y = self.lines.Y - e
        yield from self._outputs("gain", 1.0, Y)
        yield from self._outputs("delay", 1.0, -s * Y - ends)  # of a derivative from end to end
        for rate in _rates(record.duration):
            yield from self._outputs("clock", rate, self.lines.Y - self._read(1 + rate))
        for name, g, u in zip(
            record.inputs, self.G.transpose(2, 0, 1), self.lines.U.T, strict=True
        ):
            for kind, x in (("gain", -g * u[:, None]), ("delay", s * g * u[:, None])):
                yield Fault(record=record.name, channel=name, kind=kind, size=1.0), x

    def _outputs(
        self, kind: str, size: float, signals: ComplexArray
    ) -> Iterator[tuple[Fault, ComplexArray]]:
        for o, name in enumerate(self.record.outputs):
            alone = np.zeros_like(signals)
            alone[:, o] = signals[:, o]
            yield Fault(record=self.record.name, channel=name, kind=kind, size=size), alone

    def _read(self, rate: float) -> ComplexArray:
        """Transforms of the outputs read at another rate than that of their clock."""
        t, top = self.record.t - self.record.t[0], float(self.lines.omega[-1])
        at = np.clip(rate * t, 0.0, t[-1])
        y = np.column_stack([np.interp(at, t, x) for x in self.record.y.T])
        return spectrum(replace(self.record, y=y), self.su, self.sy, top * (1 + 1e-9)).Y


def _rates(duration: float) -> list[float]:
    """Rates of clocks less one that are tried."""
    some = np.arange(0.0, FASTEST, max(APART / duration, FASTEST / 12))[1:]
    return [*map(float, -some), *map(float, some)]


@dataclass(frozen=True, eq=False)
class _Seen:
    """The possible faults (m) of a piece of a record, and what tells them."""

    faults: list[Fault]
    known: Array  # (rank, m) of their signals, what other models explain
    pull: Array  # (rank,) of the residuals on the model
    size: Array  # (bands, m) squares of the signals, less what other models explain
    score: Array  # (bands, m) products with the residuals
    left: Array  # (m,) squared residuals where a fault shows
    whole: Array  # (m,) squares of the signals


def disagreement(
    system: StateSpace, campaign: Campaign, pole: float, top: float, *, missing: bool = False
) -> Fault | None:
    """The fault of one channel of one record that explains most; None where nothing clear does.

    ``system`` is refined on the transforms of the records up to ``top`` [rad/s]; dynamics may be
    ``missing`` in it.
    """
    su, sy, mask = campaign.su, campaign.sy, campaign.mask
    records = [part for piece in campaign.pieces(pole) for part in parts(piece, top)]
    pairs = [(record, spectrum(record, su, sy, top)) for record in records]
    pairs = [(record, lines) for record, lines in pairs if len(lines.omega)]
    data = [lines for _, lines in pairs]
    if len(data) < 2:
        return None
    modal, free = modes.to_modal(system, su, sy, mask), np.argwhere(mask)
    weights = noise_weights(modal, data)
    factor = modes.covariance_factor(normal_equations(modal, data, weights, free)[0])
    seen = []
    around = linearised(modal, data, weights)
    for (record, lines), w, near in zip(pairs, weights, around, strict=True):
        piece = _Piece(record, lines, w, system.response(lines.omega) * su / sy[:, None], su, sy)
        slopes = modes.tangents(modal, *near, w, free)
        seen.append(_seen(piece, *slopes, factor))
    return _clearest(seen, MISSING if missing else 1.0)


def _seen(piece: _Piece, e: Array, J: Array, Q: Array, factor: Array) -> _Seen:
    """What tells the faults of a piece, from weighted residuals and slopes of `modes.tangents`."""
    ny = len(piece.sy)
    each = e.reshape(ny, -1)
    real, imag = np.split(each, 2, axis=1)
    signals = list(piece.signals(np.asarray((real + 1j * imag).T / piece.w, dtype=complex)))
    faults = [fault for fault, _ in signals]
    X = np.array([modes.stacked(x * piece.w).T.ravel() for _, x in signals]).T
    X -= Q @ (Q.T @ X)
    known = factor.T @ (J.T @ X)
    own = X - J @ (factor @ known)
    bands = np.floor(np.log(piece.lines.omega / piece.lines.omega[0]) / BAND)
    which = np.tile(bands, 2 * ny) == np.unique(bands)[:, None]
    left = dict(zip(piece.record.outputs, np.sum(each**2, axis=1), strict=True))
    return _Seen(
        faults,
        known,
        pull=factor.T @ (J.T @ e),
        size=which @ (X * own),
        score=which @ (own * e[:, None]),
        left=np.array([left.get(fault.channel, e @ e) for fault in faults]),
        whole=np.sum(X**2, axis=0),
    )


def _clearest(seen: Sequence[_Seen], slack: float) -> Fault | None:
    clear: list[tuple[float, Fault]] = []
    for piece in seen:
        others = np.array([-(each.pull @ piece.known) for each in seen if each is not piece])
        information = np.maximum(piece.size.sum(axis=0), 1e-100)
        score = piece.score.sum(axis=0) + others.sum(axis=0)
        a, gain = score / information, score**2 / information
        apart = np.sum((piece.score - a * piece.size) ** 2, axis=0) + np.sum(others**2, axis=0)
        error = np.sqrt(np.maximum(apart / information**2, 1 / (2 * information)))
        slight = slack * np.array([SLIGHT[fault.kind] for fault in piece.faults])
        clocks = np.array([fault.kind == "clock" for fault in piece.faults])
        sure = np.where(clocks, a, np.abs(a)) > slight + CLEAR * error
        sure &= (TOLD * piece.whole < information) & (gain > SHARE * piece.left)
        gains = np.array([fault.kind == "gain" for fault in piece.faults])
        sure &= ~gains | (np.abs(1 + a) > CLEAR * error)  # or it follows something else, as gusts
        gain = gain / np.where(clocks, SIMPLER, 1.0)
        for k in np.flatnonzero(sure):
            tried = piece.faults[k].size
            size = tried if clocks[k] else float(a[k])
            fault = replace(piece.faults[k], size=size, error=float(error[k]) * abs(tried))
            clear.append((float(gain[k]), fault))
    return max(clear, key=lambda each: each[0], default=(0.0, None))[1]
