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
from casid.subspace import likelihood
from casid.subspace import modal as modes
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.fourier import Spectrum, parts, spectrum, transformed
from casid.subspace.jackknife import Jackknife
from casid.subspace.pooled_spectra import alike
from casid.subspace.slopes import linearised, normal_equations

# What nonlinear aircraft show between manoeuvres: a fault is larger by `CLEAR` errors. A clock is
# tried at several rates, of which the right one explains all, the coefficient being one.
SLIGHT = {"gain": 0.1, "delay": 0.02, "clock": 0.5}
MISSING = 2.0  # times as much where the model misses dynamics
CLEAR = 2.5
FAR = 0.3  # s: beyond, what first order says of a delay is no size
LARGE = 0.8  # of a gain less one: beyond, first order does not tell which record is wrong
SHARE = 0.65  # of what is left of its channel, or by an input of all: a fault explains that much
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
    other: str = ""  # the only record that tells it, which may as well be the wrong one

    def told(self) -> str:
        """What it is, and what to do."""
        name, size, error = self.channel, self.size, self.error
        what = {
            "gain": f"{name} is {1 + size:.3g} ± {error:.2g} times what",
            "delay": f"{name} is {1e3 * abs(size):.0f} ± {1e3 * error:.0f} ms "
            f"{'later' if size > 0 else 'earlier'} than",
            "clock": f"the clock of {name} runs {100 * abs(size):.1f} % "
            f"{'slower' if size > 0 else 'faster'} than",
        }[self.kind]
        if self.kind == "delay" and abs(size) > FAR:
            what = f"{name} is of another delay than"
        if self.other:
            return (
                f"Records {self.record} and {self.other} disagree: in {self.record} {what} the "
                "model of the others predicts, and no third record tells which of the two is "
                "wrong. Look at sensor and logger of both: leave out the wrong one, or mend the "
                "channel."
            )
        return (
            f"Record {self.record} disagrees with the others: {what} their model predicts. "
            "Look at sensor and logger of this record: leave it out, or mend the channel."
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

    def faults(self, e: ComplexArray) -> Iterator[tuple[list[Fault], Sequence[int], Array]]:
        """Possible faults of each output, then of all inputs, and what they add to the residuals.

        ``e`` (K, ny) is what the model leaves of the outputs' transforms. The additions (outputs,
        2 K, faults) are weighted as those of `modes.tangents`, to the outputs that are given.
        """
        record, s, w = self.record, 1j * self.lines.omega[:, None], self.w
        y = record.y / self.sy
        ends = (y[-3:].mean(axis=0) - y[:3].mean(axis=0)) / np.sqrt(record.duration)
        Y = self.lines.Y - e
        kinds = [("gain", 1.0), ("delay", 1.0)]
        made: list[ComplexArray] = [Y, -s * Y - ends]  # a delay's: of a derivative from end to end
        for rate in _rates(record.duration):
            kinds.append(("clock", rate))
            made.append(self.lines.Y - self._read(y, 1 + rate))
        weighted = modes.by_turns(np.asarray([each * w for each in made])).transpose(2, 1, 0)
        for o, name in enumerate(record.outputs):
            own = [self._fault(name, kind, size) for kind, size in kinds]
            yield own, [o], weighted[[o]]
        named, rows = [], []
        for name, g, u in zip(
            record.inputs, self.G.transpose(2, 0, 1), self.lines.U.T, strict=True
        ):
            named += [self._fault(name, kind, 1.0) for kind in ("gain", "delay")]
            rows += [modes.by_turns(x * u[:, None] * w) for x in (-g, s * g)]
        yield named, range(record.ny), np.array(rows).transpose(2, 1, 0)

    def _fault(self, channel: str, kind: str, size: float) -> Fault:
        return Fault(record=self.record.name, channel=channel, kind=kind, size=size)

    def _read(self, y: Array, rate: float) -> ComplexArray:
        """Transforms of the scaled outputs read at another rate than that of their clock."""
        t = self.record.t - self.record.t[0]
        at = np.clip(rate * t, 0.0, t[-1])
        i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
        along = ((at - t[i]) / (t[i + 1] - t[i]))[:, None]
        before = y.take(i, axis=0)
        read = before + along * (y.take(i + 1, axis=0) - before)
        return transformed(t, read, len(self.w), even=self.lines.h is not None)


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
    system: StateSpace,
    campaign: Campaign,
    pole: float,
    top: float,
    *,
    windows: Windows | None = None,
    missing: bool = False,
) -> Fault | None:
    """The fault of one channel of one record that explains most; None where nothing clear does.

    ``system`` is refined on the transforms of the records up to ``top`` [rad/s]; dynamics may be
    ``missing`` in it. Models of fewer records are made with ``windows``.
    """
    jackknife = windows and Jackknife(
        system=system, campaign=campaign, pole=pole, top=top, windows=windows
    )
    gain = jackknife.other_gain() if jackknife and len(campaign.records) > 1 else None
    if gain:
        name, size = campaign.records[gain.record].name, gain.gain - 1
        found: Fault | None = Fault(
            record=name, channel=gain.channel, kind="gain", size=size, error=gain.error
        )
    else:
        found = _by_score(system, campaign, pole, top, missing)
    if not (found and jackknife):
        return found
    names = [record.name for record in campaign.records]
    other = jackknife.rival(names.index(found.record), found.channel)
    return found if other is None else replace(found, other=names[other])


def _by_score(
    system: StateSpace, campaign: Campaign, pole: float, top: float, missing: bool
) -> Fault | None:
    """The slight fault that explains most."""
    su, sy, mask = campaign.su, campaign.sy, campaign.mask
    records = [part for piece in campaign.pieces(pole) for part in parts(piece, top)]
    pairs = [(record, spectrum(record, su, sy, top)) for record in records]
    pairs = [(record, lines) for record, lines in pairs if len(lines.omega)]
    data = [lines for _, lines in pairs]
    if len(data) < 2:
        return None
    modal, free = modes.to_modal(system, su, sy, mask), np.argwhere(mask)
    weights = likelihood.noise_weights(modal, data)
    known = likelihood.parts(modal, alike(data, weights))
    factor = modes.covariance_factor(normal_equations(modal, known, free)[0], modal)
    seen = []
    around = linearised(modal, known)
    for (record, lines), w, near in zip(pairs, weights, around, strict=True):
        piece = _Piece(record, lines, w, system.response(lines.omega) * su / sy[:, None], su, sy)
        seen.append(_seen(piece, modes.tangents(modal, *near, w, free), factor))
    return _clearest(seen, MISSING if missing else 1.0)


def _seen(piece: _Piece, near: modes.Tangents, factor: Array) -> _Seen:
    """What tells the faults of a piece, from weighted residuals and their slopes."""
    # A fault has rows X of one output, or of all. What transients and other models explain of it,
    # Q g and J c, has all rows: of these the products over each band are enough.
    e, n, every = near.e, len(near.QJ), range(len(near.e))
    bands = np.floor(np.log(piece.lines.omega / piece.lines.omega[0]) / BAND)
    starts = (2 * np.flatnonzero(np.diff(bands, prepend=-1.0))).tolist()  # a line has two rows
    Q = np.array([rows[:, :n] for rows in near.rows])
    both = near.products(np.concatenate([Q, e[..., None]], axis=2), every, starts)
    QS, eS = both[..., :-1].swapaxes(1, 2), both[..., -1]
    left = dict(zip(piece.record.outputs, np.sum(e**2, axis=1), strict=True))
    faults, columns = [], []
    residuals = (e[:, ::2] + 1j * e[:, 1::2]).T / piece.w
    for some, outputs, X in piece.faults(np.asarray(residuals, dtype=complex)):
        SX = near.products(X, outputs, starts)
        d = SX.sum(axis=0)
        g, known = d[:n].copy(), factor.T @ d[n:]
        d[n:] = factor @ known
        power = np.sum(np.add.reduceat(X**2, starts, axis=1), axis=0)
        met = np.sum(np.add.reduceat(X * e[outputs, :, None], starts, axis=1), axis=0)
        size = power - np.sum(SX * d, axis=1) + np.sum((QS @ d - SX[:, :n]) * g, axis=1)
        score = met - eS @ d
        columns.append((known, size, score, power.sum(axis=0) - np.sum(g**2, axis=0)))
        faults += some
    known, size, score, whole = (np.concatenate(x, axis=-1) for x in zip(*columns, strict=True))
    showing = np.array([left.get(fault.channel, np.sum(e**2)) for fault in faults])
    return _Seen(faults, known, factor.T @ eS[:, n:].sum(axis=0), size, score, showing, whole)


def _clearest(seen: Sequence[_Seen], slack: float) -> Fault | None:
    clear: list[tuple[float, Fault]] = []
    pulls = np.array([each.pull for each in seen])
    for i, piece in enumerate(seen):
        others = -np.delete(pulls, i, axis=0) @ piece.known
        information = np.maximum(piece.size.sum(axis=0), 1e-100)
        score = piece.score.sum(axis=0) + others.sum(axis=0)
        a, gain = score / information, score**2 / information
        apart = np.sum((piece.score - a * piece.size) ** 2, axis=0)
        apart += np.sum(others**2, axis=0)
        error = np.sqrt(np.maximum(apart / information**2, 1 / (2 * information)))
        slight = slack * np.array([SLIGHT[fault.kind] for fault in piece.faults])
        clocks = np.array([fault.kind == "clock" for fault in piece.faults])
        sure = np.where(clocks, a, np.abs(a)) > slight + CLEAR * error
        sure &= (TOLD * piece.whole < information) & (gain > SHARE * piece.left)
        gains = np.array([fault.kind == "gain" for fault in piece.faults])
        sure &= ~gains | (np.abs(a) < LARGE)  # or it follows something else, as gusts
        gain = gain / np.where(clocks, SIMPLER, 1.0)
        for k in np.flatnonzero(sure):
            tried = piece.faults[k].size
            size = tried if clocks[k] else float(a[k])
            fault = replace(piece.faults[k], size=size, error=float(error[k]) * abs(tried))
            clear.append((float(gain[k]), fault))
    return max(clear, key=lambda each: each[0], default=(0.0, None))[1]
