"""The columns of a campaign: what subspace identification regresses, block by block.

A column stacks z(0), ..., z(p) of z = (u, y) for one start instant: Laguerre projections, paper
(4), or the samples themselves.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from casid.arrays import Array, BoolArray
from casid.autoregression import filled
from casid.checks import check_known
from casid.record import Record
from casid.records import same_interval
from casid.samples import known_mean, runs
from casid.subspace.laguerre import project_blocks, support
from casid.subspace.predictor import Stack, accumulate, triangular
from casid.values import storable

Feedthrough = bool | Sequence[str] | BoolArray

BLOCK = 4096  # columns held at once
MOVING, EXCITING = 0.9, 0.99  # of an output's and an input's power: below the bandwidth
BAND_END = 1.5  # of the Laguerre pole: the model is not trusted above it
DEPENDENT = 1e-5  # of the largest singular value of channels: they are one fewer than they seem
LONG_GAP = np.pi / BAND_END  # of 1/a, half a period there: a longer loss splits a record


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class Segment:
    """What one stretch of a record gave: ``used`` of its ``duration`` [s] became columns."""

    record: str
    start: float
    duration: float
    used: float
    interpolated: int


def feedthrough_mask(
    feedthrough: Feedthrough, inputs: Sequence[str], outputs: Sequence[str]
) -> BoolArray:
    """(ny, nu) mask from True, False, the names of outputs with a direct term, or the mask."""
    shape = (len(outputs), len(inputs))
    if isinstance(feedthrough, bool):
        return np.full(shape, feedthrough)
    if isinstance(feedthrough, np.ndarray) or not all(isinstance(x, str) for x in feedthrough):
        mask = np.asarray(feedthrough)
        if mask.shape != shape:
            raise ValueError(
                f"feedthrough has shape {mask.shape}, expected {shape}, a row for each of "
                f"{', '.join(outputs)}, or their names"
            )
        return mask.astype(bool)
    check_known("feedthrough names no output", feedthrough, outputs)
    return np.array([[name in feedthrough] * len(inputs) for name in outputs])


def excited_band(records: Sequence[Record]) -> tuple[float, float]:
    """Frequencies [rad/s] where every input is excited in one record at least."""
    # From two periods in the longest record to the frequency above which the input's spectrum (the
    # largest over the records) stays 40 dB below its peak.
    low = 2 * 2 * np.pi / max(record.duration for record in records)
    highs = []
    for j in range(records[0].nu):
        best = max(records, key=lambda record: float(np.std(record.u[:, j])))
        omega, power = spectrum(best.t, best.u[:, j])
        above = omega[power > 1e-4 * power.max()]
        highs.append(float(above.max()) if len(above) else low)
    return float(low), float(max(min(highs), 2 * low))


def output_bandwidth(records: Sequence[Record], *, quiet: bool = False) -> float:
    """Frequency [rad/s] below which the outputs move: 90 % of their power over all records.

    White noise has most of its power at high frequencies; ``quiet`` takes its level off.
    """
    # The median over outputs: neither a drifting one nor one that is mostly noise decides.
    ends = _ends_of_power(records, "y", MOVING, quiet=quiet)
    return float(np.median(ends)) if ends else 2 * np.pi / records[0].duration


def input_bandwidth(records: Sequence[Record], part: float = EXCITING) -> float:
    """Frequency [rad/s] that holds that part of the power of the slowest input over all records."""
    return min(_ends_of_power(records, "u", part))


def _ends_of_power(
    records: Sequence[Record], letter: str, part: float, *, quiet: bool = False
) -> list[float]:
    """Frequency [rad/s] below which that part of a channel's power lies, channel by channel."""
    ends = []
    for column in zip(*(getattr(record, letter).T for record in records), strict=True):
        pairs = [(r.t, v, np.isfinite(v)) for r, v in zip(records, column, strict=True)]
        both = [spectrum(t[seen], v[seen]) for t, v, seen in pairs if seen.sum() > 2]
        if both:
            levels = [_white_level(*each) if quiet else 0.0 for each in both]
            omega = np.concatenate([w for w, _ in both])
            energy = np.concatenate([e - n for (_, e), n in zip(both, levels, strict=True)])
            ascending = np.argsort(omega, kind="stable")
            share = np.cumsum(energy[ascending])
            ends.append(float(omega[ascending][np.argmax(share >= part * share[-1])]))
    return ends


def _white_level(omega: Array, energy: Array) -> float:
    """Mean energy of white noise at a frequency, by the median of the upper half of them."""
    # Energies of noise are distributed exponentially; peaks of vibration do not move their median.
    return float(np.median(energy[2 * omega >= omega[-1]]) / np.log(2))


def spectrum(t: Array, v: Array) -> tuple[Array, Array]:
    """Frequencies above zero and the energy of a windowed signal at each; any sampling."""
    even = np.linspace(t[0], t[-1], len(t))
    v = np.interp(even, t, v)
    v = (v - v.mean()) * np.hanning(len(v))
    h = even[1] - even[0]
    energy = np.abs(np.fft.rfft(v)) ** 2 * h / len(v)
    return 2 * np.pi * np.fft.rfftfreq(len(v), h)[1:], energy[1:]


def gather(
    records: Sequence[Record],
    su: Array,
    sy: Array,
    past: int,
    a: float,
    complete: Sequence[Record] = (),
) -> tuple[Stack, tuple[Segment, ...]]:
    """Triangular factor of all columns of records; a constant per segment projected out.

    ``a`` is the Laguerre pole, NaN for the samples themselves; ``complete`` are the records without
    missing samples, if they are known.
    """
    nz = len(su) + len(sy)
    R: Array = np.zeros((0, (past + 1) * nz))
    count, segments = 0, []
    for record, whole in zip(records, complete or map(completed, records), strict=True):
        for piece, interpolated in pieces_of(record, whole, a):
            blocks = (
                _sample_blocks(piece, su, sy, past)
                if np.isnan(a)
                else _laguerre_blocks(piece, su, sy, past, a)
            )
            part, n = accumulate(blocks, constant=True)
            segments.append(
                Segment(
                    record=record.name,
                    start=float(piece.t[0]),
                    duration=piece.duration,
                    used=n * piece.dt,
                    interpolated=interpolated,
                )
            )
            if n:
                R = triangular(np.vstack([R, part])) if len(R) else part
                count += n
    return Stack(R, len(su), len(sy), past, count), tuple(segments)


def _laguerre_blocks(record: Record, su: Array, sy: Array, past: int, a: float) -> Iterator[Array]:
    v = np.hstack([record.u / su, record.y / sy])
    usable = int(np.searchsorted(record.t, record.t[-1] - support(a, past), side="right"))
    for start, block in project_blocks(record.t, v, a, past + 1, record.hold, BLOCK):
        if start < usable:
            rows = block[: usable - start]
            yield rows.reshape(len(rows), -1)


def _sample_blocks(record: Record, su: Array, sy: Array, past: int) -> Iterator[Array]:
    v = np.hstack([record.u / su, record.y / sy])
    windows = sliding_window_view(v, past + 1, axis=0) if len(v) > past else np.zeros((0, 1, 1))
    for start in range(0, len(windows), BLOCK):
        rows = (
            windows[start : start + BLOCK].transpose(0, 2, 1).reshape(-1, (past + 1) * v.shape[1])
        )
        yield rows[np.isfinite(rows).all(axis=1)]


def completed(record: Record) -> Record:
    """The record with its missing samples filled in: by a short autoregression, or linearly."""
    # The autoregression (`casid.autoregression`) takes equidistant samples.
    if record.equidistant or not np.isnan(record.y).any():
        return filled(record)[0]
    y = record.y.copy()
    for column in y.T:
        gap = np.isnan(column)
        if gap.any() and not gap.all():
            column[gap] = np.interp(record.t[gap], record.t[~gap], column[~gap])
    return replace(record, y=y)


def pieces_of(record: Record, whole: Record, a: float) -> Iterator[tuple[Record, int]]:
    """Stretches of a record without long gaps, and how many samples were filled in in each.

    ``whole`` is the record without missing samples, see `completed`. On samples nothing is filled
    in: columns that touch a missing sample are left out.
    """
    missing = np.isnan(record.y)
    if np.isnan(a) or not missing.any():
        yield record, 0
        return
    bad = _in_long_gap(record.t, missing, LONG_GAP / a) | np.isnan(whole.y).any(axis=1)
    for start, end in runs(~bad):
        if end - start > 1:
            cut = slice(start, end)
            piece = replace(record, t=record.t[cut], u=record.u[cut], y=whole.y[cut])
            yield piece, int(missing[cut].sum())


def check_samples(records: Sequence[Record]) -> None:
    """Raise where samples are not equidistant, or records not of one interval and hold."""
    first = records[0]
    for record in records:
        if not record.equidistant:
            raise ValueError(
                f'record {record.name!r} is not equidistant: transform="none" works on samples; '
                'use transform="laguerre" or resample the record'
            )
        if not same_interval(record, first) or record.hold != first.hold:
            raise ValueError(
                f"records {first.name!r} and {record.name!r} are sampled every {first.dt:g} and "
                f'{record.dt:g} s ("{first.hold}", "{record.hold}"): transform="none" needs one '
                'interval and hold; use transform="laguerre" or resample them'
            )


def check_pole(records: Sequence[Record], a: float) -> None:
    """Raise where no record is sampled fast enough to show Laguerre functions of that pole."""
    fastest = np.pi / min(record.dt for record in records)
    if a > fastest:
        raise ValueError(
            f"pole={a:g}: samples every {np.pi / fastest:g} s show nothing above {fastest:.3g} "
            "rad/s; lower the pole, or leave it to be chosen"
        )


def check_independent(records: Sequence[Record]) -> None:
    """Raise where an input is a sum of multiples of other inputs, or an output of other outputs."""
    # Nothing then tells their effects apart, and the regressions divide by rounding.
    for kind in ("input", "output"):
        values = [record.u if kind == "input" else record.y for record in records]
        whole = np.vstack([v - known_mean(v) for v in values if len(v) > 1])
        whole = whole[np.isfinite(whole).all(axis=1)]
        size = np.linalg.norm(whole, axis=0)
        moving = np.flatnonzero(size > 0)
        if len(moving) < 2 or len(whole) <= len(moving):
            continue
        _, s, Vt = np.linalg.svd(triangular(whole[:, moving] / size[moving]))
        if s[-1] < DEPENDENT * s[0]:
            names = records[0].inputs if kind == "input" else records[0].outputs
            part = np.abs(Vt[-1])
            found = [names[i] for i, s in zip(moving, part, strict=True) if s > 0.1 * part.max()]
            raise ValueError(
                f"{kind}s {' and '.join(found)} depend on one another in all records, one is a "
                "multiple or a sum of the rest: nothing tells them apart; leave one out "
                "(Record.select)"
            )


def _in_long_gap(t: Array, missing: BoolArray, longest: float) -> BoolArray:
    """Samples in a gap of some channel that is longer than allowed, or at a record's end."""
    bad = np.zeros(len(t), dtype=bool)
    for column in missing.T:
        for start, end in runs(column):
            open_end = start == 0 or end == len(t)
            if open_end or t[end] - t[start - 1] > longest:
                bad[start:end] = True
    return bad
