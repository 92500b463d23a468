"""One manoeuvre: inputs and outputs at the instants they were measured."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, TypeAlias, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.errors import warn

Hold = Literal["foh", "zoh"]
T = TypeVar("T")

USUAL = 0.95  # share of sampling intervals that are not longer than the usual one
FEWEST = 16  # samples of a stretch between gaps
QUIET = 0.02  # share of an input's range that still counts as trim


@dataclass(frozen=True, eq=False)
class Record:
    """One manoeuvre, SI units and radians.

    Parameters
    ----------
    t : (N,) array
        Instants [s], strictly increasing, not necessarily equidistant.
    u : (N, nu) array
        Inputs, finite.
    y : (N, ny) array
        Outputs; NaN marks a missing sample.
    inputs, outputs : sequence of str
        Channel names, one a column.
    name : str
        What messages and tables call the manoeuvre.
    hold : {"foh", "zoh"}
        What the inputs do between samples: straight lines or steps.
    trim : mapping
        The value of each channel that was already subtracted.

    Raises
    ------
    ValueError
        Shapes that disagree, time that does not increase, NaN in an input.
    """

    t: Array
    u: Array
    y: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    name: str = ""
    hold: Hold = "foh"
    trim: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for attribute in ("t", "u", "y"):
            values = np.array(getattr(self, attribute), dtype=float)
            values.setflags(write=False)
            object.__setattr__(self, attribute, values)
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        _check_shapes(self)
        _check_values(self)

    @property
    def N(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def dt(self) -> float:
        """Median sampling interval [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def equidistant(self) -> bool:
        """Whether all sampling intervals agree to 1e-3 of their median."""
        steps = np.diff(self.t)
        return bool(np.all(np.abs(steps - self.dt) <= 1e-3 * self.dt))

    def gaps(self) -> NDArray[np.intp]:
        """Samples after which rows are missing for longer than twice the usual interval.

        Usual is the median, or what one interval in twenty exceeds where sampling is irregular.
        """
        steps = np.diff(self.t)
        usual = max(self.dt, float(np.quantile(steps, USUAL)))
        return np.flatnonzero(steps > 2.001 * usual)

    def stretches(self) -> tuple["Record", ...]:
        """The manoeuvre between its gaps in time, where nobody knows what the inputs did.

        Rows that are missing for longer than twice the usual sampling interval make a gap.
        Stretches of fewer than 16 samples are left out; without gaps it is the record itself.
        """
        gaps = self.gaps()
        if not len(gaps):
            return (self,)
        spans = [(a, b) for a, b in pairwise([0, *map(int, gaps + 1), self.N]) if b - a >= FEWEST]
        parts = [self.take(slice(*span)) for span in spans]
        return tuple(replace(each, name=f"{self.name} {k}") for k, each in enumerate(parts, 1))

    def channel(self, name: str) -> Array:
        """Samples of one channel, (N,)."""
        if name in self.inputs:
            return self.u[:, self.inputs.index(name)]
        return self.y[:, _position(name, self.outputs, "channel", self.name)]

    def totals(self) -> dict[str, Array]:
        """Every channel as it was measured: what was subtracted as trim is added back."""
        names = (*self.inputs, *self.outputs)
        return {name: self.channel(name) + self.trim.get(name, 0.0) for name in names}

    def select(
        self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> "Record":
        """The same manoeuvre with the named channels, in that order."""
        inputs = self.inputs if inputs is None else tuple(inputs)
        outputs = self.outputs if outputs is None else tuple(outputs)
        iu = [_position(name, self.inputs, "input", self.name) for name in inputs]
        iy = [_position(name, self.outputs, "output", self.name) for name in outputs]
        return replace(self, u=self.u[:, iu], y=self.y[:, iy], inputs=inputs, outputs=outputs)

    def take(self, rows: slice | BoolArray) -> "Record":
        """The same manoeuvre with some of its samples."""
        return replace(self, t=self.t[rows], u=self.u[rows], y=self.y[rows])

    def between(self, start: float, end: float) -> "Record":
        """Return the samples with ``start <= t <= end`` [s]."""
        keep = (self.t >= start) & (self.t <= end)
        if (n := int(keep.sum())) < 2:
            raise ValueError(
                f"record {self.name!r} has {n} sample{'s' * (n != 1)} between {start:g} s and "
                f"{end:g} s; it lasts from {self.t[0]:g} s to {self.t[-1]:g} s"
            )
        return self.take(keep)

    def mask(self, where: BoolArray) -> "Record":
        """The same manoeuvre with some output samples missing: ``where`` (N, ny) is true."""
        return replace(self, y=np.where(where, np.nan, self.y))

    def decimate(self, step: int) -> "Record":
        """Every ``step``-th sample, unfiltered; the hold then applies between these."""
        if not 1 <= step < self.N:
            raise ValueError(f"record {self.name!r}: step={step}, expected 1 to {self.N - 1}")
        return self.take(slice(None, None, step))

    def quiet_samples(self) -> int:
        """Number of samples before the first input leaves its initial value.

        An input has left when it is more than 2 % of its range away from its first sample.
        """
        away = np.abs(self.u - self.u[0]) > QUIET * np.maximum(np.ptp(self.u, axis=0), 1e-300)
        moved = np.flatnonzero(away.any(axis=1))
        return int(moved[0]) if len(moved) else self.N

    def detrend(self, how: Literal["first", "mean"] | Mapping[str, float] | None) -> "Record":
        """Subtract the trim from every channel and remember it.

        Parameters
        ----------
        how : {"first", "mean"}, mapping or None
            ``"first"``: the mean of the stretch before the first input moves; ``"mean"``: the mean
            of the record; a mapping gives the trim of every channel (for a record that is excited
            from its first sample: another record's ``trim``); None leaves it as it is.
        """
        if how is None:
            return self
        if how == "first":
            trim = self._means(max(self.quiet_samples(), 1))
        elif how == "mean":
            trim = self._means(self.N)
        elif isinstance(how, Mapping):
            trim = dict(how)
        else:
            raise ValueError(f'detrend={how!r}: expected "first", "mean", a mapping or None')
        names = (*self.inputs, *self.outputs)
        if missing := [name for name in names if name not in trim]:
            raise ValueError(f"record {self.name!r}: no trim value for channel {missing[0]!r}")
        u = self.u - [trim[name] for name in self.inputs]
        y = self.y - [trim[name] for name in self.outputs]
        total = {name: self.trim.get(name, 0.0) + trim[name] for name in names}
        return replace(self, u=u, y=y, trim=total)

    def with_noise(self, std: Mapping[str, float], rng: np.random.Generator) -> "Record":
        """White Gaussian measurement noise added to the named outputs (standard deviations)."""
        for name in std:
            _position(name, self.outputs, "output", self.name)
        sigma = np.array([std.get(name, 0.0) for name in self.outputs])
        return replace(self, y=self.y + sigma * rng.standard_normal(self.y.shape))

    def _means(self, n: int) -> dict[str, float]:
        means = {name: float(self.u[:n, i].mean()) for i, name in enumerate(self.inputs)}
        for i, name in enumerate(self.outputs):
            head = self.y[:n, i]
            if np.isnan(head).all():
                raise ValueError(
                    f"record {self.name!r}: output {name!r} has no sample in its first {n}; "
                    'pass detrend="mean" or the trim itself'
                )
            means[name] = float(np.nanmean(head))
        return means


Records: TypeAlias = Record | Sequence[Record]


def several(items: T | Iterable[T]) -> tuple[T, ...]:
    """One value or several alike, as a tuple: what arguments ``records`` and ``target`` take."""
    return tuple(items) if isinstance(items, Iterable) else (items,)


def stretches(records: Records) -> tuple[Record, ...]:
    """Records without gaps in time; every estimator takes its records through here.

    A record with gaps counts as its `Record.stretches`, each with an initial state of its own; a
    `DataWarning` says so.

    Raises
    ------
    ValueError
        A record with nothing but gaps.
    """
    return tuple(piece for record in several(records) for piece in _pieces(record))


def _pieces(record: Record) -> tuple[Record, ...]:
    pieces = record.stretches()
    if len(pieces) == 1 and pieces[0] is record:
        return pieces
    gaps = record.gaps()
    wide = np.diff(record.t)[gaps]
    lost = record.N - sum(piece.N for piece in pieces)
    said = (
        f"record {record.name!r} has {len(gaps)} gap{'s' * (len(gaps) > 1)} in time, the longest "
        f"of {wide.max():.3g} s after {record.t[gaps[np.argmax(wide)]]:.4g} s"
    )
    if not pieces:
        raise ValueError(f"{said}, and no stretch of {FEWEST} samples between them; leave it out")
    warn(
        f"{said}: taken as {len(pieces)} stretches, each with an initial state of its own"
        + f"; {lost} samples in shorter ones are left out" * bool(lost)
    )
    return pieces


def same_channels(records: Records) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Inputs and outputs shared by all records.

    Raises
    ------
    ValueError
        No record, or records whose channels differ in name or order.
    """
    if not (records := several(records)):
        raise ValueError("no records given; at least one is needed")
    first = records[0]
    for record in records[1:]:
        if (record.inputs, record.outputs) != (first.inputs, first.outputs):
            raise ValueError(
                f"record {record.name!r} has channels {record.inputs} -> {record.outputs}, record "
                f"{first.name!r} has {first.inputs} -> {first.outputs}; use Record.select"
            )
    return first.inputs, first.outputs


def standard_deviations(records: Sequence[Record]) -> tuple[Array, Array]:
    """Standard deviation of every input (nu,) and output (ny,) over all records.

    The mean of all samples is removed first; missing samples are left out. A channel that never
    moves (but for rounding) or has no sample has 1, so that dividing by it is harmless.
    """
    u, y = (np.vstack([getattr(record, letter) for record in records]) for letter in "uy")
    return _spread(u), _spread(y)


def _spread(values: Array) -> Array:
    known = np.where(np.isnan(values), 0.0, values)
    count = np.maximum((~np.isnan(values)).sum(axis=0), 1)
    mean = known.sum(axis=0) / count
    centred = np.where(np.isnan(values), 0.0, values - mean)
    spread = np.sqrt((centred**2).sum(axis=0) / count)
    return np.where(spread > 1e-12 * np.abs(mean), spread, 1.0)


def _position(name: str, names: tuple[str, ...], kind: str, record: str) -> int:
    if name not in names:
        raise ValueError(f"record {record!r} has no {kind} {name!r}; it has {', '.join(names)}")
    return names.index(name)


def _check_shapes(record: Record) -> None:
    t, u, y = record.t, record.u, record.y
    if t.ndim != 1 or len(t) < 2:
        raise ValueError(
            f"record {record.name!r}: t has shape {t.shape}, expected (N,) with N >= 2"
        )
    for letter, values, names in (("u", u, record.inputs), ("y", y, record.outputs)):
        if values.shape != (len(t), len(names)):
            raise ValueError(
                f"record {record.name!r}: {letter} has shape {values.shape}, expected "
                f"(N, n{letter}) = ({len(t)}, {len(names)}) for {names}; arrays are time-first: "
                f"pass {letter}.T if time runs along columns"
            )
    names = (*record.inputs, *record.outputs)
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"record {record.name!r}: channel {twice[0]!r} is named twice")
    if record.hold not in get_args(Hold):
        raise ValueError(f'record {record.name!r}: hold={record.hold!r}, expected "foh" or "zoh"')


def _check_values(record: Record) -> None:
    t = record.t
    if not np.isfinite(t).all():
        k = int(np.flatnonzero(~np.isfinite(t))[0])
        raise ValueError(f"record {record.name!r}: t[{k}] = {t[k]}; time must be finite")
    if (back := np.flatnonzero(np.diff(t) <= 0)).size:
        k = int(back[0]) + 1
        raise ValueError(
            f"record {record.name!r}: time does not increase at sample {k} "
            f"({t[k - 1]:g} s, then {t[k]:g} s); sort the samples and drop repeated ones"
        )
    bad = np.argwhere(~np.isfinite(record.u))
    if len(bad):
        k, i = bad[0]
        raise ValueError(
            f"record {record.name!r}: input {record.inputs[i]!r} is {record.u[k, i]} at sample {k} "
            "(inputs must be known everywhere); cut the record there or repair the channel"
        )
    infinite = np.argwhere(np.isinf(record.y))
    if len(infinite):
        k, i = infinite[0]
        raise ValueError(
            f"record {record.name!r}: output {record.outputs[i]!r} is {record.y[k, i]} at sample "
            f"{k}; mark a missing sample with NaN"
        )
