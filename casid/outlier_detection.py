"""Outliers: samples of outputs that nothing around them bears out.

Expected is what a short autoregression makes of all other samples (`casid.autoregression`). A fit
that sees what all channels do at once, a long run of one or many of its jumps, follows: these are
looked for by their jumps and called by a fit without them.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.autoregression import LAGS, SPAN, apart, autoregression, filled, slow, unsure
from casid.record import Record
from casid.repeated_samples import least_step
from casid.samples import MAD, runs
from casid.threads import one_thread

PASSES = 8  # at most, in which outliers are looked for
FEWEST = 50  # samples of a channel in which outliers are looked for
PULSE = 0.2  # of an input's range
GAP = 10  # samples in a row that are lost, of all outputs: nothing after follows from before
FAR = 6.0  # deviations of a normal distribution that make an outlier
GROSS = 10.0  # of one that no fit may see, as it would follow what all channels do at once
LATE = 0.3  # s after a step of an input within which outputs may jump, too
BRIEF, FEW = 0.08, 4  # s and samples that such a jump lasts at most
MANY = 0.01  # of a channel's samples that jump: fits that see them follow
LONG, LEAP = 80, 0.5  # samples between jumps of a run; these, in the channel's deviations
COUNTS = 1.5  # steps of a channel that is counted in such: to the next one is no jump
MOSTLY = 0.25  # of a channel between such jumps: that is its way
ABSURD = 5.0  # times the range of all other samples, as far as a value is from their middle
SLIGHT = 0.05  # of a channel's deviation: what is less does no harm


@one_thread
def outliers(record: Record) -> BoolArray:
    """Samples of outputs that neither their neighbours nor the other channels confirm.

    A sample is compared with what an autoregression makes of all others, lost ones left out: six
    robust deviations (median of absolute deviations) of the innovations away, and of this
    difference, which is the larger the fewer samples there are around, (N, ny). What lasts, as a
    gust or a step does, is none.
    """
    found = np.zeros(record.y.shape, dtype=bool)
    # Channels sampled less often are no help to the others: an autoregression would have to be
    # fitted to what lies between their samples. They are judged at their own samples.
    often = np.flatnonzero(~slow(np.isnan(record.y)))
    found[:, often] = _far(record.select(outputs=[record.outputs[i] for i in often]))
    sound = record.mask(found)
    for i in set(range(record.ny)) - set(often.tolist()):
        rows = np.isfinite(record.y[:, i])
        names = [record.outputs[j] for j in (*often, i)]
        if rows.sum() > FEWEST:
            found[rows, i] = _far(sound.select(outputs=names).take(rows))[:, -1]
    return found


def _far(record: Record) -> BoolArray:
    """Outliers of channels that are sampled alike, (N, ny)."""
    seen = [x[np.isfinite(x)] for x in record.y.T]
    there = np.flatnonzero([len(x) > FEWEST and np.ptp(x) > 0 for x in seen])
    found = np.zeros(record.y.shape, dtype=bool)
    if not len(there) or record.N < FEWEST:
        return found
    part, own = _regular(record.select(outputs=[record.outputs[i] for i in there]))
    # What lasts after a step of an input answers it, after a delay that no short fit may know.
    width = _width(part)
    lasts = np.column_stack([_steady(x, width) for x in part.y.T])
    lasts[~(_stepped(part) & (width > 3))] = np.nan  # of slow samples lags reach far enough
    marks = np.column_stack([_no_value(x) for x in part.y.T])
    marks |= _runs(part.mask(marks))
    marks |= _jumps(part.mask(marks), lasts)
    for _ in range(PASSES):
        whole, lost = filled(part.mask(marks))
        off, limit, p = _judged(whole, lost)
        answers = np.abs(part.y - lasts) < limit
        size = np.where(lost | answers, 0.0, np.abs(off) / limit)
        # An outlier spoils what is expected of all channels around it: the largest one first.
        around = scipy.ndimage.maximum_filter1d(size.max(axis=1), 2 * p + 1)
        far = (size > 1) & (size == around[:, None])
        if not far.any():
            break
        marks |= far
    found[:, there] = marks[own]
    return found


def _no_value(x: Array) -> BoolArray:
    """Samples (N,) of one value far beyond all others: what recorders write where there is none."""
    marks, seen = np.zeros(len(x), dtype=bool), x[np.isfinite(x)]
    for value in (seen.min(), seen.max()) if len(seen) else ():
        others = seen[seen != value]
        reach = np.ptp(others) if len(others) else 0.0
        often = 1 < len(seen) - len(others) <= MOSTLY * len(seen)
        if often and 0 < ABSURD * reach < np.abs(value - np.median(others)):
            marks |= x == value
    return marks


def _jumps(record: Record, lasts: Array) -> BoolArray:
    """Samples off what was around them and is expected there, of several channels or many, (N, ny).

    Channels that jump together bear each other out, and so do many jumps of one, which spoil what
    is expected next and widen the limits: least squares follow. So these are looked for in each
    channel alone, by its running median, and called if a fit without them says so too, but for
    what ``lasts`` (N, ny) where it answers an input.
    """
    width = _width(record)
    marks = np.column_stack([_brief(x, width) for x in record.y.T])
    # A pulse of an input moves them all, and without its rows nobody would know.
    off = np.abs(record.u - scipy.ndimage.median_filter(record.u, (width, 1), mode="nearest"))
    pulses = np.any(off > _large(record.u, off), axis=1)
    marks &= ~scipy.ndimage.maximum_filter1d(pulses, 2 * width + 1)[:, None]
    # Many brief answers to steps are none of them: there are many where no input steps.
    still = marks[~_stepped(record)]
    many = still.sum(axis=0) > MANY * max(len(still), FEWEST)
    marks &= many | (marks.sum(axis=1, keepdims=True) > 1)
    if marks.any():
        far, _, limit = _unexpected(record, marks)
        marks &= far & ~(np.abs(record.y - lasts) < GROSS / FAR * limit)
    return np.asarray(marks & (many | (marks.sum(axis=1, keepdims=True) > 1)))


def _runs(record: Record) -> BoolArray:
    """Samples of runs, between jumps of a channel there and back, far off what is expected there.

    A fit that sees a long run follows it. So all that lies between jumps is expected without it,
    and called where it is far off at both ends: what the aircraft flies begins within a sample's
    noise of what it did before. The longer the run, the less is known of what is expected.
    """
    marks = np.column_stack([_between(x, _stepped(record)) for x in record.y.T])
    if not marks.any():
        return marks
    far, expected, limit = _unexpected(record, marks)
    rest = np.where(marks, np.nan, record.y)  # no model is believed that diverges from it
    far &= (expected > np.nanmin(rest, axis=0) - limit) & (
        expected < np.nanmax(rest, axis=0) + limit
    )
    for i, column in enumerate(marks.T):
        for a, b in runs(column):
            column[a:b] &= far[a:b, i] & bool(far[a, i] and far[b - 1, i])
    return marks


def _unexpected(record: Record, marks: BoolArray) -> tuple[BoolArray, Array, Array]:
    """Samples far off what a fit without the marked ones expects (N, ny), that, and its limits."""
    whole, lost = filled(record.mask(marks))
    limit = np.nanmedian(np.where(lost, np.nan, _judged(whole, lost)[1]), axis=0)
    wide = FAR * unsure(whole, lost, marks)
    far = np.abs(record.y - whole.y) > GROSS / FAR * np.hypot(limit, wide)
    return np.asarray(far), whole.y, limit


def _stepped(record: Record) -> BoolArray:
    """Samples (N,) about which an input jumps, as what follows from it may, later by its delay."""
    moves = np.abs(np.diff(record.u, axis=0, prepend=record.u[:1]))
    marks = (moves > _large(record.u, moves)).any(axis=1)
    around = scipy.ndimage.maximum_filter1d(marks, 2 * FEW + 1)
    late = round(LATE / record.dt)
    after = scipy.ndimage.maximum_filter1d(marks, late + 1, origin=late // 2, mode="constant")
    return np.asarray(around | after)


def _large(u: Array, moves: Array) -> Array:
    """From where on moves (N, nu) of inputs are large (nu,): one that only jitters makes none."""
    typical = np.median(np.abs(moves), axis=0)
    return np.asarray(np.maximum(PULSE * np.ptp(u, axis=0), GROSS * MAD * typical))


def _between(x: Array, stepped: BoolArray) -> BoolArray:
    """Samples (N,) from a jump of a channel to the last of those that follow soon.

    Where an input jumps, a jump begins or ends a run only with another that no input explains. One
    near an end of the record that no other belongs to may end or begin a run there.
    """
    marks, at = np.zeros(len(x), dtype=bool), np.flatnonzero(np.isfinite(x))
    moves = np.abs(np.diff(x[at]))
    least = max(GROSS * MAD * np.median(moves), LEAP * np.std(x[at]), COUNTS * least_step(x[at]))
    jumps = 1 + np.flatnonzero((moves > least) & (np.diff(at) <= FEW))
    answers, edges = jumps[stepped[at[jumps]]], jumps[~stepped[at[jumps]]]
    for part in np.split(edges, 1 + np.flatnonzero(np.diff(edges) > LONG)):
        ends = [*part]
        if len(ends) == 1 and len(answers):
            near = answers[np.argmin(np.abs(answers - part))]
            ends += [near] if abs(near - part[0]) <= LONG else []
        if len(ends) == 1 and min(part[0], len(at) - part[0]) <= LONG:
            ends.append(0 if part[0] <= LONG else len(at))
        if len(ends) > 1:
            marks[at[int(min(ends)) : int(max(ends))]] = True
    return marks if marks.sum() <= MOSTLY * len(at) else np.zeros_like(marks)


def _width(record: Record) -> int:
    """Samples of a running median that no brief jump moves."""
    return 2 * int(np.clip(round(BRIEF / record.dt), 1, FEW)) + 1


def _steady(x: Array, width: int) -> Array:
    """Running median (N,) of the ``width`` samples around, lost ones left out."""
    steady, at = np.full(len(x), np.nan), np.flatnonzero(np.isfinite(x))
    steady[at] = scipy.ndimage.median_filter(x[at], width, mode="nearest")
    return steady


def _brief(x: Array, width: int) -> BoolArray:
    """Samples (N,) far from the running median."""
    steady = _steady(x, width)
    off = np.nan_to_num(np.abs(x - steady))
    typical = np.median(off[np.isfinite(steady)])
    counted = COUNTS * least_step(x[np.isfinite(x)])
    return np.asarray(off > max(GROSS * MAD * typical, SLIGHT * np.nanstd(steady), counted))


def _regular(record: Record) -> tuple[Record, NDArray[np.intp]]:
    """The record with rows that are missing put in, empty, and where its own are now (N,)."""
    # Of longer gaps as many as make both sides independent.
    steps = np.clip(np.round(np.diff(record.t) / record.dt), 1, LAGS[1] + 2).astype(int)
    own = np.concatenate([[0], np.cumsum(steps)])
    if own[-1] == record.N - 1:
        return record, own
    k = np.arange(own[-1] + 1)
    u = [np.interp(k, own, x) for x in record.u.T]
    y = np.full((len(k), record.ny), np.nan)
    y[own] = record.y
    t = record.t[0] + record.dt * k
    return replace(record, t=t, u=np.reshape(u, (record.nu, -1)).T, y=y), own


def _judged(whole: Record, lost: BoolArray) -> tuple[Array, Array, int]:
    """Smoothing residuals, limits that make an outlier of a sample, (N, ny), and the lags p.

    Nothing after a gap follows from before it: what is between gaps is judged by itself, its first
    p samples, which have nothing before them, back in time. Between gaps of up to p samples there
    is no saying.
    """
    model = autoregression(whole, whole.y, lost)
    p = len(model.A)
    back = replace(whole, u=whole.u[::-1], y=whole.y[::-1])
    behind = autoregression(back, back.y, lost[::-1])
    off, std = np.zeros(lost.shape), np.full(lost.shape, np.inf)
    for a, b in runs(~_gap(lost)):
        if b - a > p:
            part, first = np.arange(a, b), np.arange(a, min(b, a + SPAN * p))[::-1]
            off[part], std[part] = apart(model, whole, lost, part)
            early = np.array(apart(behind, whole, lost, first))[:, -p:]
            off[first[-p:]], std[first[-p:]] = early
    seen = np.where(lost | np.isinf(std), np.nan, 1.0)
    std = std * np.maximum(MAD * np.nanmedian(seen * np.abs(off) / std, axis=0), 1.0)
    e = np.abs(model.innovations(whole.u, whole.y))
    # What is counted in steps is off by up to half of one.
    step = [least_step(x) / np.sqrt(12) for x in np.where(lost, np.nan, whole.y).T]
    std = np.maximum(std, step)
    limit = FAR * np.maximum(std, MAD * np.nanmedian(seen[p:] * e, axis=0))
    return off, np.maximum(limit, SLIGHT * np.std(whole.y, axis=0)), p


def _gap(lost: BoolArray) -> BoolArray:
    """Rows of gaps (N,): all outputs lost for over `GAP` samples.

    What inputs did there is not known, and `_regular` makes a long one shorter than it was.
    """
    gap = np.zeros(len(lost), dtype=bool)
    for a, b in runs(np.asarray(lost.all(axis=1))):
        gap[a:b] = b - a > GAP
    return gap
