"""Samples of one record: what they must be, and what they are at other instants."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.channels import UNITS
from casid.errors import warn
from casid.instants import check_time, stamp

Between = Literal["zoh", "foh", "smooth"]  # steps, straight lines, a cubic spline

QUIET = 0.02  # share of an input's range that still counts as trim
NOISY = 5.0  # deviations of a resting input's noise that do, too
LEVEL = 10  # first samples of a noisy input, whose mean is its level at rest
FADED = 4.0  # deviations of its noise at rest from which on an input that fades in has begun
FAINT = 0.001  # share of an input's range that a rest which is not exact may wander
ROUNDING = 1e-9  # of an input's largest value: a smaller change is none
FEWEST = 50  # samples that show noise
STRETCH = 16  # samples of a stretch between gaps
BEGUN = 100  # first samples, at rest where there is any
MAD = 1.482602218505602  # standard deviation of a normal distribution over its median deviation
USUAL = 0.95  # share of sampling intervals that are not longer than the usual one
SLOWER = 1.5  # intervals that are longer by this factor need a filter first
CLOSE = 0.05  # of the median interval: a curve through two samples so close swings far beyond both
ABRUPT = 10.0  # times the moves before and after it: a move that is a jump
STEPS = 0.9  # of an input's moves, squared, that are jumps: it moves in steps
BURST = 5  # outliers that make a run, and samples from one to the next there
TURNS = 2 * np.pi, 360.0  # whole turns of angles in radians and degrees
WRAP = 0.8  # of a turn: a step that wrapping makes of the small one that it was
SLOW, STEADY = 0.1, 3.0  # usual step of an angle, in turns; what it was, in usual steps
SMALL = 0.005  # of a turn: a step that may have been, however steady the angle
DRIFT = 0.05  # s/s: no clock runs slower or faster than another by more


def runs(marks: BoolArray) -> NDArray[np.intp]:
    """First and one past the last sample of every run of marked samples (N,), (runs, 2)."""
    padded = np.concatenate([[False], marks, [False]]).astype(np.int8)
    return np.flatnonzero(np.diff(padded)).reshape(-1, 2)


def bursts(t: Sequence[float] | Array, dt: float) -> list[tuple[float, float, int]]:
    """First and last instant and number of those (n,) that follow each other closely: runs."""
    parts = np.split(np.asarray(t), 1 + np.flatnonzero(np.diff(t) > BURST * dt))
    return [(float(x[0]), float(x[-1]), len(x)) for x in parts if len(x) >= BURST]


def plausible(drift: Mapping[str, float]) -> Mapping[str, float]:
    """Drifts of clocks [s/s] by channel; ValueError for one that no clock has."""
    for name, value in drift.items():
        if abs(value) > DRIFT:
            raise ValueError(
                f"drift of {name!r} is {value:g} s/s, at most {DRIFT:g} is a clock's (5e-4: half a "
                "millisecond a second); if it counts in another unit of time, state that where it "
                "is read"
            )
    return drift


def known_mean(x: Array) -> Array:
    """Mean of every column (N, n) over the samples that are there, (n,); 0 where there is none."""
    return np.asarray(np.ma.masked_invalid(x).mean(axis=0).filled(0.0))


def root_mean_square(values: Array) -> float:
    """Root of the mean square; infinite where a value is no number, or too large to be squared."""
    with np.errstate(over="ignore"):
        size = float(np.sqrt(np.mean(values**2)))
    return size if np.isfinite(size) else np.inf


def autocorrelation(x: Array, lags: int) -> Array:
    """Of samples (N,), mean removed, at lags of 0 to ``lags`` samples, (lags + 1,); 1 at 0."""
    x = x - x.mean()
    products = np.array([float(x[lag:] @ x[: len(x) - lag]) for lag in range(lags + 1)])
    return np.asarray(products / max(products[0], 1e-300))


def noise(x: Array) -> Array:
    """Standard deviation of white noise on every smooth column (N, n), by third differences."""
    if len(x) < FEWEST:
        return np.zeros(x.shape[1])
    return np.asarray(MAD * np.median(np.abs(np.diff(x, 3, axis=0)), axis=0) / np.sqrt(20))


def off_rest(u: Array) -> BoolArray:
    """Where every column (N, n) is away from its first level by more than rest and noise do."""
    # That level is the first sample or, of noise, the mean of those before, of ten at most.
    first = np.cumsum(u[:LEVEL], axis=0)
    means = first / np.arange(1, len(first) + 1)[:, None]
    level = means[np.clip(np.arange(len(u)) - 1, 0, len(means) - 1)]
    whole, begun = noise(u), noise(u[:BEGUN])
    # What is flown may be as rough as noise: then that of the rest before is clearly less.
    least = QUIET * np.ptp(u, axis=0)
    most = NOISY * np.where(begun < whole / 2, begun, whole)
    level = np.where(most > least, level, u[0])
    return np.asarray(np.abs(u - level) > np.maximum(np.maximum(least, most), 1e-300))


def resting(u: Array) -> int:
    """Number of samples before the first column (N, n) begins to leave its rest.

    From where `off_rest` has it away, each is followed back to the last sample that its own rest
    explains: what fades in has left long before.
    """
    away = off_rest(u)
    ends = (_begun(x, int(np.argmax(off))) for x, off in zip(u.T, away.T, strict=True) if off.any())
    return min(ends, default=len(u))


def _begun(x: Array, found: int) -> int:
    """The sample at which a channel (N,), found away from its rest, began to leave it."""
    n, exact = found, ROUNDING * np.abs(x).max()
    while n >= 2 * LEVEL:  # its first half tells the rest: again, while it may have moved there
        head = x[: n // 2]
        spread = FADED * head.std()
        rest = max(spread, FAINT * np.ptp(x)) if spread > exact else exact
        begun = int(np.flatnonzero(np.abs(x[:n] - head.mean()) <= rest)[-1]) + 1
        if begun < found / 2 and spread > exact:
            return found  # it wanders all along, as a controller lets it
        if begun == n:
            break
        n = begun
    return n


def jumps(x: Array) -> Array:
    """Jumps (n,) within one sample of a channel (N,) that moves in steps; none if it does not."""
    moves = np.abs(np.diff(x))
    beside = np.maximum(np.append(0.0, moves[:-1]), np.append(moves[1:], 0.0))
    found: Array = np.diff(x)[moves > ABRUPT * beside]
    return found if found @ found > STEPS * (moves @ moves) else found[:0]


def unwrapped(x: Array) -> Array | None:
    """An angle (N,) whose jumps by whole turns are taken out; None if it has none.

    One that is kept within a turn jumps from edge to edge where it moved a little: by whole turns,
    in radians or degrees, but for steps as those around it.
    """
    there = np.flatnonzero(np.isfinite(x))
    known = x[there]
    if len(known) < 2 or np.ptp(known) < WRAP * min(TURNS):
        return None
    steps = np.abs(np.diff(known))
    for turn in TURNS:
        wrap = steps > WRAP * turn
        if not wrap.any() or wrap.all() or np.ptp(known) > (1 + SMALL) * turn:
            continue
        if _lost(steps, wrap):
            continue
        usual, odd = steps[~wrap].mean(), np.median(np.abs(steps[wrap] - turn))
        if usual < SLOW * turn and odd < STEADY * usual + SMALL * turn:
            done = x.copy()
            done[there] = np.unwrap(known, discont=WRAP * turn, period=turn)
            return done
    return None


def _lost(steps: Array, wrap: BoolArray) -> bool:
    """Whether a channel that moves elsewhere stands still between two jumps: it was lost there."""
    still = steps == 0
    between = np.split(still, np.flatnonzero(wrap))[1:-1]  # each begins with the jump itself
    stands = any(len(part) > 2 and part[1:].all() for part in between)
    return stands and bool(still[~wrap].mean() < 1 / 2)


def usual_interval(t: Array) -> float:
    """The median interval, or what one in twenty exceeds where sampling is irregular."""
    steps = np.diff(t)
    return max(float(np.median(steps)), float(np.quantile(steps, USUAL)))


def at_instants(t: Array, x: Array, instants: Array, between: Between) -> Array:
    """One channel x (N,) of instants t (N,) at others (M,) [s], NaN where it was not measured."""
    # That is before its first and after its last sample, and wherever its samples (which may be
    # rarer than the record's) lie more than twice their usual interval apart.
    known = ~np.isnan(x)
    t, x = t[known], x[known]
    if len(t) < 4:
        return np.full(len(instants), np.nan)
    usual = usual_interval(t)
    slack = 1e-6 * usual
    after = np.clip(np.searchsorted(t, instants + slack, side="right"), 1, len(t) - 1)
    before = after - 1
    if between == "smooth":
        values = scipy.interpolate.make_interp_spline(t, x, k=3)(instants)
        # It swings on, ever less, where the channel rests: what nobody sees there is rest.
        rests = x[before] == x[after]
        values = np.where(rests, as_it_is(values, x[before], np.abs(x).max()), values)
    elif between == "foh":
        values = np.interp(instants, t, x)
    else:
        values = np.where(instants + slack >= t[-1], x[-1], x[before])
    on = np.minimum(np.abs(instants - t[before]), np.abs(instants - t[after])) <= slack
    lost = (t[after] - t[before] > 2.001 * usual) & ~on
    lost |= (instants < t[0] - slack) | (instants > t[-1] + slack)
    return np.where(lost, np.nan, values)


def as_it_is(found: Array, known: Array, size: float) -> Array:
    """Values (N,) that were computed, those known in their place that are off by rounding alone.

    That is by less than a billionth of the channel's ``size``.
    """
    return np.where(np.abs(found - known) <= ROUNDING * size, known, found)


def moved(t: Array, x: Array, instants: Array, between: Between) -> Array:
    """`at_instants`, NaN also where the sample nearest to the instant is: no values are added."""
    # Of two equally near the later one, so that rounding does not choose.
    slack = 1e-6 * float(np.median(np.diff(t)))
    nearest = np.searchsorted((t[:-1] + t[1:]) / 2, instants + slack)
    return np.where(np.isnan(x[nearest]), np.nan, at_instants(t, x, instants, between))


def real(record: str, letter: str, values: Any) -> Array:  # noqa: ANN401 - whatever the user has
    """A copy as real numbers, what is masked NaN; ValueError for what is none, or more than one."""
    array = np.ma.asanyarray(values) if np.ma.isMaskedArray(values) else np.asarray(values)
    if array.dtype.kind in "cmM":
        kind = "complex numbers" if array.dtype.kind == "c" else "dates or times"
        raise ValueError(
            f"record {record!r}: {letter} holds {kind}, expected real numbers"
            + "; of instants take seconds: (t - t[0]) / np.timedelta64(1, 's')" * (letter == "t")
        )
    return np.array(np.ma.filled(array.astype(float), np.nan))


def checked(
    record: str,
    t: Array,
    u: Array,
    y: Array,
    names: tuple[tuple[str, ...], tuple[str, ...]],
    hold: Literal["foh", "zoh"],
) -> tuple[Array, Array, Array]:
    """A record's time, inputs and outputs as they count: `check_samples`, `completed`, `tidied`."""
    check_samples(record, t, u, y, names)
    return tidied(record, *completed(record, t, u, y, names[0], hold), names[1])


def check_samples(
    record: str, t: Array, u: Array, y: Array, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> None:
    """Refuse arrays that are no record: shapes, time that goes back, values that are none."""
    if t.ndim != 1 or len(t) < 2:
        raise ValueError(f"record {record!r}: t has shape {t.shape}, expected (N,) with N >= 2")
    for letter, values, own in zip("uy", (u, y), names, strict=True):
        if values.shape != (len(t), len(own)):
            raise ValueError(
                f"record {record!r}: {letter} has shape {values.shape}, expected "
                f"(N, n{letter}) = ({len(t)}, {len(own)}) for {own}; arrays are time-first: "
                f"pass {letter}.T if time runs along columns"
            )
    every = (*names[0], *names[1])
    if twice := [name for name in every if every.count(name) > 1]:
        raise ValueError(f"record {record!r}: channel {twice[0]!r} is named twice")
    check_time(record, t, np.hstack([u, y]))
    _check_values(record, u, y, names)


def known_inputs(t: Array, u: Array, held: Sequence[Between]) -> tuple[Array, BoolArray]:
    """Inputs (N, nu) with samples between those of slower channels, and where all are known (N,).

    What an input did between its own samples ``held`` says; where it lacks samples for longer than
    twice its usual interval nobody knows, nor before its first and after its last.
    """
    if not np.isnan(u).any():
        return u, np.ones(len(t), dtype=bool)
    lost = [np.isnan(x) for x in u.T]
    columns = [
        np.where(gone, at_instants(t, x, t, how), x) if gone.any() else x
        for x, how, gone in zip(u.T, held, lost, strict=True)
    ]
    u = np.column_stack(columns)
    return u, np.asarray(~np.isnan(u).any(axis=1))


def completed(
    record: str, t: Array, u: Array, y: Array, inputs: Sequence[str], hold: Literal["foh", "zoh"]
) -> tuple[Array, Array, Array]:
    """Samples at which all inputs are known, those of slower inputs filled in as they are held.

    A `DataWarning` says so. ValueError: an input that is hardly known.
    """
    lost = np.isnan(u).mean(axis=0)
    if not lost.any():
        return t, u, y
    worst = inputs[int(np.argmax(lost))]
    if len(t) < STRETCH:
        k = int(np.isnan(u[:, inputs.index(worst)]).argmax())
        raise ValueError(
            f"record {record!r}: input {worst!r} is nan at sample {k}, and {len(t)} samples are "
            f"too few to tell what it did there, expected {STRETCH} or more; leave them out"
        )
    u, known = known_inputs(t, u, [hold] * u.shape[1])
    if known.sum() < STRETCH:
        raise ValueError(
            f"record {record!r}: input {worst!r} is missing nearly everywhere; leave it out, or "
            "join it from where it was recorded (Record.join)"
        )
    shares = ", ".join(f"{n} {share:.1%}" for n, share in zip(inputs, lost, strict=True) if share)
    left = f"; {len(t) - known.sum()} samples without inputs are left out" * bool(~known.all())
    warn(f"record {record!r}: inputs lack samples ({shares}), read by their hold, {hold}{left}")
    return t[known], u[known], y[known]


def tidied(
    record: str, t: Array, u: Array, y: Array, outputs: Sequence[str]
) -> tuple[Array, Array, Array]:
    """Time, inputs and outputs without rows that hardly follow others, angles continuous; warns."""
    if (close := close_together(t)).any():
        rows = np.flatnonzero(close)  # a curve through both would swing
        named = ", ".join(map(str, rows[:5])) + " ..." * (len(rows) > 5)
        warn(
            f"record {record!r}: {len(rows)} of {len(t)} samples follow the one before within "
            f"{CLOSE:.0%} of the usual interval of {_median_step(t):.3g} s and are left out (rows "
            f"{named}, the first at {stamp(t, rows[0])} s); look at the clocks of the log"
        )
        t, u, y = merged(t, u, y, close)
    angles = [i for i, name in enumerate(outputs) if UNITS.get(name, "rad") == "rad"]  # maybe
    goes_on = {i: x for i in angles if (x := unwrapped(y[:, i])) is not None}
    if goes_on:
        names = ", ".join(outputs[i] for i in goes_on)
        warn(
            f"record {record!r}: {names} jumps by whole turns where the angle goes on, and is made "
            "continuous"
        )
        y = y.copy()
        y[:, [*goes_on]] = np.column_stack([*goes_on.values()])
    return t, u, y


def close_together(t: Array) -> BoolArray:
    """Samples (N,) that follow the last one kept at hardly any distance."""
    least = CLOSE * _median_step(t)
    close = np.zeros(len(t), dtype=bool)
    last = t[0]
    for k in range(1, len(t)) if (np.diff(t) < least).any() else ():
        close[k] = t[k] - last < least
        last = last if close[k] else t[k]
    return close


def _median_step(t: Array) -> float:
    """The median interval of instants (N,) that are apart."""
    steps = np.diff(t)
    return float(np.median(steps[steps > 0]))


def merged(t: Array, u: Array, y: Array, close: BoolArray) -> tuple[Array, Array, Array]:
    """Samples without those marked; outputs missing in the one before are taken from them."""
    # Of several sensors on nearly the same clock nothing is lost.
    y = y.copy()
    for k in np.flatnonzero(close)[::-1]:
        y[k - 1] = np.where(np.isnan(y[k - 1]), y[k], y[k - 1])
    return t[~close], u[~close], y[~close]


def _check_values(
    record: str, u: Array, y: Array, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> None:
    for kind, own, values in zip(("input", "output"), names, (u, y), strict=True):
        for k, i in np.argwhere(np.isinf(values))[:1]:
            raise ValueError(
                f"record {record!r}: {kind} {own[i]!r} is {values[k, i]} at sample {k}; mark a "
                "missing sample with NaN"
            )
