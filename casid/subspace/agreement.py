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
from casid.records import standard_deviations
from casid.subspace import modal as modes
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.fourier import Spectrum, parts, spectrum
from casid.subspace.refinement import (
    linearised,
    normal_equations,
    refined_system,
    residual_powers,
)
from casid.subspace.weighing import smoothed

# What nonlinear aircraft show between manoeuvres: a fault is larger by `CLEAR` errors. A clock is
# tried at several rates, of which the right one explains all, the coefficient being one.
SLIGHT = {"gain": 0.1, "delay": 0.02, "clock": 0.5}
MISSING = 2.0  # times as much where the model misses dynamics
CLEAR = 2.5
SHARE = 0.4  # of what is left of its channel, or by an input of all: a fault explains that much
TOLD = 0.2  # of a fault's signal: what no other model explains
BAND = 0.3  # in natural logarithms of ω
FASTEST = 0.024  # rate of clocks that are tried, less one
APART = 0.15  # s, by which clocks that are tried differ at the end of a record
SIMPLER = 1.4  # times as much must a clock explain as a delay does
LATEST = 0.3  # s: what is later is no delay
LEAST = 1e-6  # of a channel's deviation over all records: it is not smaller in others
UNTOLD = 1e-6  # of what a record tells by itself: that much do others at least
DECIDED = 0.1  # of what leaving out a record improves: what decides which of two is wrong


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One channel of one record as it may be."""

    record: str
    channel: str
    kind: str  # a key of `SLIGHT`
    size: float  # gain less one, s late, or rate less one
    error: float = 0.0
    against: str = ""  # the record that may be the wrong one as well

    def told(self) -> str:
        """What it is, and what to do."""
        name, size, error = self.channel, self.size, self.error
        what = {
            "gain": f"{name} is {1 + size:.2f} ± {max(error, 0.01):.2f} times what",
            "delay": f"{name} is {1e3 * abs(size):.0f} ± {1e3 * error:.0f} ms "
            f"{'later' if size > 0 else 'earlier'} than",
            "clock": f"the clock of {name} runs {100 * abs(size):.1f} % "
            f"{'slower' if size > 0 else 'faster'} than",
        }[self.kind]
        if self.against:
            return (
                f"Records {self.record} and {self.against} disagree: in {self.record} {what} the "
                f"model of the others predicts. Which of the two is wrong these records do not "
                f"tell: look at sensor and logger of {name} in both, or fly a third."
            )
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

    number: int  # of the record
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
    number: int  # of the record
    count: Array  # (m,) of transforms where a fault shows
    sign: Array  # (m,) 1 of faults of outputs, -1 of inputs, whose gain is seen as 1 - 1/gain

    @property
    def kinds(self) -> np.ndarray:
        """Kinds of the faults, (m,)."""
        return np.array([fault.kind for fault in self.faults])

    def fault(self, k: int, a: float, error: float) -> Fault:
        """A fault with its size, from the coefficient ``a`` of its signal."""
        fault = self.faults[k]
        if fault.kind == "clock":
            return replace(fault, error=error * abs(fault.size))
        if fault.kind == "gain" and self.sign[k] < 0:
            a, error = a / (1 - a), error / (1 - a) ** 2
        return replace(fault, size=a, error=error)


@dataclass(frozen=True, eq=False)
class _Found:
    """A fault as seen, and the number of the record that pulls most against it."""

    fault: Fault
    number: int
    against: int
    gain: float
    share: float  # of what is left that it explains


@dataclass(frozen=True, eq=False)
class _Judge:
    """Pieces of records, by number, with their transforms, and how models of them are made."""

    pieces: list[tuple[int, Record, Spectrum]]
    campaign: Campaign
    windows: Windows
    slack: float

    def lines(self, without: int | None = None) -> list[Spectrum]:
        """Transforms of all records but one."""
        return [lines for number, _, lines in self.pieces if number != without]

    def without(self, number: int, system: StateSpace) -> tuple[StateSpace, float]:
        """The model of the other records, and how much better than ``system`` these agree."""
        campaign, rest = self.campaign, self.lines(number)
        su, sy, mask = campaign.su, campaign.sy, campaign.mask
        records = (*campaign.records[:number], *campaign.records[number + 1 :])
        u, y = standard_deviations(records)  # of one in other units they are not ruled
        own = Campaign(records, np.maximum(u, LEAST * su), np.maximum(y, LEAST * sy), mask)
        start = own.subspace(system.nx, self.windows).system
        model = refined_system(start, rest, su, sy, mask, self.windows.pole, rounds=1)
        omega = np.log(np.concatenate([lines.omega for lines in rest]))
        before, after = (
            float(np.log(_level(each, rest, campaign, omega)).sum()) for each in (system, model)
        )
        return model, before - after

    def worse(self, one: StateSpace, other: StateSpace, without: tuple[int, int]) -> float:
        """How much worse one model than the other does for the records that both were made of."""
        lines = [lines for number, _, lines in self.pieces if number not in without]
        if not lines:
            return 0.0
        omega = np.log(np.concatenate([each.omega for each in lines]))
        first, second = (np.log(_level(m, lines, self.campaign, omega)) for m in (one, other))
        return float(np.sum(first - second))

    def seen(self, system: StateSpace, without: int | None = None) -> list[_Seen]:
        """What tells the faults of every piece; of those of one record by the model of the others.

        The noise is what the other records show, and the model as uncertain as they leave it.
        """
        su, sy, mask = self.campaign.su, self.campaign.sy, self.campaign.mask
        modal, free, data = modes.to_modal(system, su, sy, mask), np.argwhere(mask), self.lines()
        rest, numbers = self.lines(without), [number for number, _, _ in self.pieces]
        weights = [
            1 / np.sqrt(_level(system, rest, self.campaign, np.log(lines.omega))) for lines in data
        ]
        H, _ = normal_equations(modal, data, weights, free)
        if without is not None:
            kept = [w for n, w in zip(numbers, weights, strict=True) if n != without]
            H = normal_equations(modal, rest, kept, free)[0] + UNTOLD * H
        factor, seen = modes.covariance_factor(H), []
        around = linearised(modal, data, weights)
        for (number, record, lines), w, near in zip(self.pieces, weights, around, strict=True):
            if without not in (None, number):
                continue
            G = system.response(lines.omega) * su / sy[:, None]
            piece = _Piece(number, record, lines, w, G, su, sy)
            slopes = modes.tangents(modal, *near, w, free)
            seen.append(_seen(piece, *slopes, factor, given=without is not None))
        return seen

    def moves_most(self, channel: str, without: int) -> int:
        """Number of the record, but for one, that moves a channel most."""
        moved = {-1.0: without}
        for number, record, _ in self.pieces:
            if number != without:
                column = (*record.inputs, *record.outputs).index(channel)
                moved[float(np.std(np.hstack([record.u, record.y])[:, column]))] = number
        return moved[max(moved)]


def _level(system: StateSpace, data: Sequence[Spectrum], campaign: Campaign, at: Array) -> Array:
    """Residual spectra of the data at logarithms of frequencies (K,), smoothed, (K, ny)."""
    omega, power = residual_powers(system, data, campaign.su, campaign.sy)
    floor = 1e-20 * np.vstack([np.abs(lines.Y) ** 2 for lines in data]).mean(axis=0)
    omega = np.log(omega)
    return np.asarray(smoothed(np.clip(at, omega.min(), omega.max()), omega, power) + floor)


def disagreement(
    system: StateSpace, campaign: Campaign, windows: Windows, top: float, *, missing: bool = False
) -> Fault | None:
    """The fault of one channel of one record that explains most; None where nothing clear does.

    ``system`` is refined on the transforms of the records up to ``top`` [rad/s]; dynamics may be
    ``missing`` in it.
    """
    pieces = [
        (number, part, lines)
        for number in range(len(campaign.records))
        for piece in campaign.pieces(windows.pole, slice(number, number + 1))
        for part in parts(piece, top)
        if len((lines := spectrum(part, campaign.su, campaign.sy, top)).omega)
    ]
    if len({number for number, _, _ in pieces}) < 2:
        return None
    judge = _Judge(pieces, campaign, windows, MISSING if missing else 1.0)
    suspect = _clearest(judge.seen(system), judge.slack)
    return None if suspect is None else _judged(judge, suspect, system)


def _judged(judge: _Judge, suspect: _Found, system: StateSpace) -> Fault | None:
    """What a suspect is by models without it, or without the records that stand against it."""
    # A record in another unit rules the model without pulling at it: it moves the channel most.
    most = judge.moves_most(suspect.fault.channel, suspect.number)
    found = []
    for number in sorted({suspect.number, suspect.against, most}):
        try:
            model, better = judge.without(number, system)
            seen = judge.seen(model, number)
        except (ValueError, np.linalg.LinAlgError):
            continue  # the others support no model, or are too short
        found.append((better, number, model, _clearest(seen, judge.slack, given=True)))
    found.sort(key=lambda each: -each[0])
    if len(found) < 2:
        return found[0][3].fault if found and found[0][3] else None
    (most_better, first, without_first, wrong), (_, second, without_second, other) = found[:2]
    worse = judge.worse(without_second, without_first, (first, second))
    told = wrong if worse > 0 else other
    if told and abs(worse) > DECIDED * most_better:
        return told.fault
    seen_so = sorted(filter(None, (wrong, other)), key=lambda each: -each.share)
    if not seen_so:
        return None
    rival = second if seen_so[0].number == first else first
    return replace(seen_so[0].fault, against=judge.campaign.records[rival].name)


def _seen(piece: _Piece, e: Array, J: Array, Q: Array, factor: Array, *, given: bool) -> _Seen:
    """What tells the faults of a piece, from weighted residuals and slopes of `modes.tangents`.

    The model is moved along with the fault, or ``given``.
    """
    ny = len(piece.sy)
    each = e.reshape(ny, -1)
    real, imag = np.split(each, 2, axis=1)
    signals = list(piece.signals(np.asarray((real + 1j * imag).T / piece.w, dtype=complex)))
    faults = [fault for fault, _ in signals]
    X = np.array([modes.stacked(x * piece.w).T.ravel() for _, x in signals]).T
    X -= Q @ (Q.T @ X)
    known = factor.T @ (J.T @ X)
    own = X if given else X - J @ (factor @ known)
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
        number=piece.number,
        count=np.array([len(piece.w) * (1 if fault.channel in left else ny) for fault in faults]),
        sign=np.array([1.0 if fault.channel in left else -1.0 for fault in faults]),
    )


def _clearest(seen: Sequence[_Seen], slack: float, *, given: bool = False) -> _Found | None:
    """The fault that explains most, by a model of all records or by a ``given`` one of others."""
    clear: list[_Found] = []
    for piece in seen:
        rest = [] if given else [each for each in seen if each.number != piece.number]
        others = np.array([-(each.pull @ piece.known) for each in seen if each is not piece])
        others = np.zeros((1, len(piece.faults))) if given or not len(others) else others
        information = np.maximum(piece.size.sum(axis=0), 1e-100)
        score = piece.score.sum(axis=0) + others.sum(axis=0)
        a, gain = score / information, score**2 / information
        error = _errors(piece, a, gain, others, given=given)
        clocks, gains, delays = (piece.kinds == kind for kind in ("clock", "gain", "delay"))
        slight = slack * np.array([SLIGHT[kind] for kind in piece.kinds])
        sure = np.where(clocks, a, np.abs(a)) > slight + CLEAR * error
        sure &= (TOLD * piece.whole < information) & (gain > SHARE * piece.left)
        if given:
            sure &= ~(gains & (np.abs(1 + piece.sign * a) < CLEAR * error))
            sure &= ~(delays & (np.abs(a) > LATEST))
        gain = gain / np.where(clocks, SIMPLER, 1.0)
        for k in np.flatnonzero(sure):
            fault = piece.fault(int(k), float(a[k]), float(error[k]))
            pulls = [-(np.sign(score[k]) * each.pull @ piece.known[:, k]) for each in rest]
            against = rest[int(np.argmax(pulls))].number if rest else piece.number
            share = float(gain[k] / max(piece.left[k], 1e-100))
            clear.append(_Found(fault, piece.number, against, float(gain[k]), share))
    return max(clear, key=lambda each: each.gain, default=None)


def _errors(piece: _Seen, a: Array, gain: Array, others: Array, *, given: bool) -> Array:
    """Errors of estimates (m,) that explain ``gain``, which other records (n, m) pull."""
    information = np.maximum(piece.size.sum(axis=0), 1e-100)
    apart = np.sum((piece.score - a * piece.size) ** 2, axis=0) + np.sum(others**2, axis=0)
    if given:  # the response as it is known scales as the fault does
        scale = np.where(piece.kinds == "gain", 1 + piece.sign * a, 1.0)
        apart += scale**2 * np.sum(piece.known**2, axis=0) / 2
    else:  # who pulls the model most away may be wrong itself
        apart -= np.maximum(np.max(others * np.sign(a), axis=0), 0.0) ** 2
    noise = np.maximum((piece.left - gain) / piece.count, 1.0)
    return np.asarray(np.sqrt(np.maximum(apart / information**2, noise / (2 * information))))
