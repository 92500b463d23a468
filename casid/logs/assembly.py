"""Records of a log: all channels at equal intervals on one clock, and how late topics are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.consistency.lags import correlations, peak
from casid.display import counted, listed
from casid.logs.conventions import continuous
from casid.logs.sources import Source, moves
from casid.record import FEWEST, MOST, Hold, Record
from casid.samples import Between, as_it_is, at_instants, jumps, unwrapped
from casid.studies.preparation import with_inputs

FASTEST = 0.01  # s, the shortest interval that is chosen
STEPPED = 0.005  # s, the same where inputs move by steps, whose corners a filter would round
SLOWER = 1.5  # intervals: what is sampled more slowly is empty between its samples
ROUGHLY = 0.01  # of an interval: intervals nearer to each other are the same
ALIGNED = 0.1  # of an interval: samples of a slower or apart clock nearer to a record's are on it
MOSTLY = 0.95  # of the samples of a clock that is on the record's
APART = 1.0  # s without the inputs that end a record
LATE = 0.5  # s, the largest delay looked for
LONGEST = 60.0  # s of a log that are compared for delays
COHERENT = 0.8  # correlation above which two topics hold the same


@dataclass(frozen=True, kw_only=True)
class Lateness:
    """By how much one topic's column comes after another's that holds the same [s].

    It is what ages that the log states of samples leave: records are freed of those.
    """

    late: str
    than: str
    seconds: float
    correlation: float


def usual_dt(
    inputs: Mapping[str, Source], outputs: Mapping[str, Source], hold: Hold | None = None
) -> float:
    """The interval [s] that inputs and rates allow, rounded; never less than 10 ms.

    A held input is known at all times: where all are, the rates decide, down to 5 ms, among the
    intervals that divide that of the inputs.
    """
    rates = max(outputs[name].topic.interval for name in ("p", "q", "r") if name in outputs)
    slowest = max(source.topic.interval for source in inputs.values())
    fastest = min(source.topic.interval for source in inputs.values())
    wanted = max(rates, STEPPED) * (1 - ROUGHLY)
    held = hold == "zoh" or (hold is None and stepped(inputs) == {*inputs})
    if fastest > wanted and held:
        return float(f"{fastest / int(fastest / wanted):.2g}")
    return max(FASTEST, float(f"{max(slowest, rates):.2g}"))


def in_steps(source: Source) -> bool:
    """Whether an input's samples are those of a value that is held."""
    return bool(len(jumps(source.values[np.isfinite(source.values)])))


def stepped(inputs: Mapping[str, Source]) -> set[str]:
    """Inputs that count as held: of a message of which one moves by steps, all.

    They were sent together. What moves smoothly looks like lines, held or not, and says nothing.
    """
    topics = {id(source.topic) for source in inputs.values() if in_steps(source)}
    return {name for name, source in inputs.items() if id(source.topic) in topics}


def hold_of(inputs: Mapping[str, Source], outputs: Mapping[str, Source], dt: float) -> Hold:
    """What the inputs of records every ``dt`` [s] do between samples.

    They are held where all move by steps at instants of the record; a filter for slower records, or
    steps between its instants, make lines of them.
    """
    start = max(float(source.topic.t[0]) for source in inputs.values())
    faster = min(source.topic.interval for source in (*inputs.values(), *outputs.values()))
    same = faster > (1 - ROUGHLY) * dt
    on = all(
        (same and abs(source.topic.interval - dt) < ROUGHLY * dt) or _on(source, start, dt)
        for source in inputs.values()
    )
    return "zoh" if on and stepped(inputs) == {*inputs} else "foh"


def _on(source: Source, start: float, dt: float) -> bool:
    """Whether a channel's samples are at instants of a record that begins at ``start``."""
    places = (source.topic.t - start) / dt
    near = np.abs(places - np.round(places)) < ALIGNED
    return bool(near.mean() > MOSTLY)


def hold_told(
    inputs: Mapping[str, Source],
    outputs: Mapping[str, Source],
    dt: float,
    hold: Hold | None = None,
) -> list[str]:
    """What is taken of every input between its samples, and what that changes, a sentence each."""
    held = (hold or hold_of(inputs, outputs, dt)) == "zoh"
    said, steps = [], stepped(inputs)
    for name, source in inputs.items():
        half = f"half its interval, {500 * source.topic.interval:.3g} ms,"
        if hold == "zoh" or (hold is None and name in steps):
            how = 'held between its samples (hold "zoh")' if held else "lines through their middles"
            mates = [n for n in steps if inputs[n].topic is source.topic and in_steps(inputs[n])]
            does = "moves by steps"
            if mates and name not in mates:
                does = f"counts as moving by steps, as {listed(sorted(mates))} beside it does"
            said.append(f"{name} {does}: {how}; if it were lines, delays would be {half} longer")
        else:
            said.append(
                f'{name} is taken as lines between its samples (hold "foh"); if it were held '
                f'from one to the next ("zoh"), delays would be {half} shorter'
            )
    return said


def hold_doubt(inputs: Mapping[str, Source], hold: Hold | None = None) -> list[str]:
    """What delays owe to what inputs are taken to do between their samples, [] if to none.

    Not of a log so fast that records are no faster, nor if lines are asked for.
    """
    steps = {*inputs} if hold == "zoh" else stepped(inputs)
    slow = {
        name: source.topic.interval
        for name, source in inputs.items()
        if source.topic.interval >= STEPPED * (1 - ROUGHLY) and moves(source)
    }
    held, lines = ({n: x for n, x in slow.items() if (n in steps) == own} for own in (True, False))
    said = []
    if held and hold != "foh":
        said.append(
            f"{_taken(held)} as held between samples, {_apart(held)}: if what drove the aircraft "
            "moved in between, as with a controller faster than the log, delays are "
            f"{_half(held)} longer than estimated: import the log as lines, too (casid import "
            "--hold foh), and compare"
        )
    if lines and hold is None:
        said.append(
            f"{_taken(lines)} as lines between samples, {_apart(lines)}: if each was held from "
            "one to the next, as with a controller no faster than the log, delays are "
            f"{_half(lines)} shorter than estimated: import the log as held, too (casid import "
            "--hold zoh), and compare"
        )
    return said


def _taken(names: Mapping[str, float]) -> str:
    return f"{listed([*names])} {'counts' if len(names) == 1 else 'count'}"


def _apart(intervals: Mapping[str, float]) -> str:
    return f"{1000 * max(intervals.values()):.3g} ms apart"


def _half(intervals: Mapping[str, float]) -> str:
    return f"some {500 * max(intervals.values()):.3g} ms, half an interval,"


def assemble(
    inputs: Mapping[str, Source],
    outputs: Mapping[str, Source],
    dt: float,
    name: str,
    hold: Hold | None = None,
) -> list[Record]:
    """Records of a log's channels every ``dt`` [s], one a stretch in which inputs were logged.

    Outputs stand at the instants their samples were taken, inputs at those they were sent. Faster
    channels pass one filter, but for inputs that stay held; slower outputs are empty between their
    samples. Where lines are made of an input that is held, they run through means of its steps,
    but through its samples if lines are asked for by ``hold``.
    """
    clocks = {id(source.topic): source.topic for source in inputs.values()}
    start = max(float(topic.t[0]) for topic in clocks.values())
    end = min(float(topic.t[-1]) for topic in clocks.values())
    records = []
    losses = [
        (float(topic.t[k]), float(topic.t[k + 1]))
        for topic in clocks.values()
        for k in np.flatnonzero(np.diff(topic.t) > APART)
    ]
    for lost, back in sorted([*losses, (end, end)]):
        if lost - start >= FEWEST * dt:
            records += _records(inputs, outputs, (start, min(lost, end)), (dt, hold), name)
        start = max(start, back)
    return records


def _records(
    inputs: Mapping[str, Source],
    outputs: Mapping[str, Source],
    span: tuple[float, float],
    how_sampled: tuple[float, Hold | None],
    name: str,
) -> list[Record]:
    every, (dt, asked) = {**inputs, **outputs}, how_sampled
    step = min(dt, *(source.topic.interval for source in every.values()))
    step = dt / max(1, int(dt / step + 0.5))
    if (n := int((span[1] - span[0]) / step)) > MOST:
        raise ValueError(
            f"{name}: {counted(n, 'sample')} every {step:g} s in one stretch, at most {MOST}"
        )
    t = span[0] + step * np.arange(n + 1)
    hold = asked or hold_of(inputs, outputs, dt)
    columns, steps = [], stepped(inputs)
    for channel, source in every.items():
        own = source.topic.t
        taken = own if channel in inputs else source.topic.taken
        near = (own >= span[0] - APART) & (own <= span[1] + APART)
        x = source.values[near]
        x = continuous(x) if channel in ("phi", "psi") else x
        how: Between = hold if channel in inputs else "smooth"
        if near.sum() <= 3:
            columns.append(np.nan * t)
        elif channel in inputs and hold == "foh" and asked is None and channel in steps:
            columns.append(_means(own[near], x, t, step))
        else:
            columns.append(at_instants(taken[near], x, t, how))
    whole = Record(t, np.zeros((len(t), 0)), np.column_stack(columns), (), tuple(every), name, hold)
    if not np.isfinite(whole.y[:, : len(inputs)]).all(axis=1).sum() >= FEWEST:
        return []
    even = whole.resample(dt) if step < dt else whole
    if step < dt and hold == "zoh":
        held = [_picked(source, even.t, dt) for source in inputs.values()]
        even = replace(even, hold=hold, y=np.column_stack([*held, even.y[:, len(inputs) :]]))
    empty = np.column_stack([_between(source, even.t, dt) for source in every.values()])
    empty[:, : len(inputs)] = False
    parts = with_inputs(even.mask(empty), tuple(inputs)).stretches()
    return [part for part in parts if np.isfinite(part.y).any()]


def _means(t: Array, x: Array, instants: Array, width: float) -> Array:
    """Means about instants (M,), ``width`` [s] wide, of a signal held from one sample to the next.

    Its steps are neither early nor late then, wherever they lie between the instants.
    """
    t, x = t[np.isfinite(x)], x[np.isfinite(x)]
    if len(t) < FEWEST:
        return np.full(len(instants), np.nan)
    ends = np.array([t[0] - width, *t, t[-1] + width])
    area = np.append(0.0, np.cumsum(np.append(x[0], x) * np.diff(ends)))
    later, earlier = (np.interp(instants + side * width / 2, ends, area) for side in (1, -1))
    held = at_instants(t, x, instants, "zoh")
    means = as_it_is((later - earlier) / width, held, float(np.abs(x).max()))
    return np.where(np.isnan(held), np.nan, means)


def _picked(source: Source, instants: Array, dt: float) -> Array:
    """A held input at instants (M,) of the record, each of its samples at the nearest of them."""
    nearest = instants[0] + dt * np.round((source.topic.t - instants[0]) / dt)
    kept = np.flatnonzero(np.diff(nearest, append=np.inf) > dt / 2)  # the later of two at one
    return at_instants(nearest[kept], source.values[kept], instants, "zoh")


def _between(source: Source, t: Array, dt: float) -> BoolArray:
    """Instants of the record that are none of a slower channel's, (N,)."""
    topic = source.topic
    if topic.interval < SLOWER * dt:
        return np.zeros(len(t), dtype=bool)
    place = np.round((topic.taken - t[0]) / dt)
    own = place[(place >= 0) & (place < len(t))].astype(int)
    empty = np.ones(len(t), dtype=bool)
    empty[own] = False
    return empty


def lateness(taken: Source, other: Source) -> Lateness | None:
    """How late one column is after another that holds the same; None if they are not alike."""
    step = min(taken.topic.interval, other.topic.interval, 0.01)
    start = max(taken.topic.taken[0], other.topic.taken[0])
    end = min(taken.topic.taken[-1], other.topic.taken[-1])
    middle, half = (start + end) / 2, min(end - start, LONGEST) / 2
    t = np.arange(middle - half, middle + half, step)
    lags = int(LATE / step)
    if len(t) < 8 * lags:
        return None
    x, y = (_steady(_lines(each, t)) for each in (taken, other))
    across = correlations(y, x, lags)
    k = int(np.argmax(across))
    if across[k] < COHERENT or not 0 < k < len(across) - 1:
        return None
    late = (peak(across, k) - lags) * step
    names = {"late": other.place, "than": taken.place}
    return Lateness(**names, seconds=late, correlation=float(across[k]))


def _lines(source: Source, t: Array) -> Array:
    """Known samples at other instants, an angle without its jumps by whole turns."""
    x = source.values
    x = x if (turned := unwrapped(x)) is None else turned
    known = np.isfinite(x)
    return np.interp(t, source.topic.taken[known], x[known]) if known.any() else np.nan * t


def _steady(x: Array) -> Array:
    """A signal without its mean, unknown samples at rest."""
    return np.nan_to_num(x - np.nanmean(x)) if np.isfinite(x).any() else np.zeros(len(x))


def delays(log_columns: Sequence[tuple[Source, Sequence[Source]]]) -> list[Lateness]:
    """Delays between topics that hold the same quantity."""
    found = (lateness(taken, other) for taken, rest in log_columns for other in rest)
    return [each for each in found if each is not None]
