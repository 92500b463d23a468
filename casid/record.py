"""One manoeuvre: inputs and outputs at the instants they were measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, zip_longest
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from casid import regridding, samples
from casid.arrays import Array, BoolArray
from casid.checks import checked_methods, spelling
from casid.display import Shown, listed
from casid.errors import warn
from casid.interpolation_error import warn_of_corners, with_rest_told, with_steps_told

Hold = Literal["foh", "zoh"]

FEWEST = samples.STRETCH
MOST = 10_000_000  # samples that a record is resampled to
REST = 0.5  # s of quiet that a trim should rest on


@checked_methods
@dataclass(frozen=True, eq=False, repr=False)
class Record(Shown):
    """One manoeuvre, SI units and radians.

    Parameters
    ----------
    t : (N,) array
        Instants [s], increasing, not necessarily equidistant. Of samples closer together than 5 %
        of the usual interval, or at one instant, the first is kept, with a `DataWarning`.
    u : (N, nu) array
        Inputs; NaN or a mask where missing: read by ``hold``, long losses left out, with a warning.
    y : (N, ny) array
        Outputs; NaN, or an array's mask, marks a missing sample. Angles that jump by whole turns,
        as a heading does beyond ±180 degrees, are made continuous, with a `DataWarning`.
    inputs, outputs : sequence of str
        Channel names, one a column.
    name : str
        What messages and tables call the manoeuvre.
    hold : {"foh", "zoh"}
        What the inputs do between samples: straight lines or steps.
    trim : mapping
        The value of each channel that was already subtracted.
    units : mapping
        Of channels that are in another SI unit than their name says: ``{"lat": "rad"}``.

    Raises
    ------
    ValueError
        Shapes that disagree, time that does not increase, an input that is hardly known.
    """

    t: Array
    u: Array
    y: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    name: str = ""
    hold: Hold = "foh"
    trim: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def headline(self) -> str:
        """Duration, sampling, channels."""
        lost = float(np.isnan(self.y).mean())
        missing = f", {100 * lost:.2g} % of the outputs missing" if lost else ""
        return (
            f"{self.name!r}, {self.duration:.4g} s, {self.N} samples at {1 / self.dt:.4g} Hz, "
            f"inputs {listed(self.inputs)}, outputs {listed(self.outputs, 10)}{missing}"
        )

    def __post_init__(self) -> None:
        for attribute in ("t", "u", "y"):
            values = samples.real(self.name, attribute, getattr(self, attribute))
            values.setflags(write=False)
            object.__setattr__(self, attribute, values)
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        if self.hold not in get_args(Hold):
            raise ValueError(f'record {self.name!r}: hold={self.hold!r}, expected "foh" or "zoh"')
        names = self.inputs, self.outputs
        tidy = samples.checked(self.name, self.t, self.u, self.y, names, self.hold)
        for attribute, values in zip("tuy", tidy, strict=True):
            values.setflags(write=False)
            object.__setattr__(self, attribute, values)

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
        return np.flatnonzero(np.diff(self.t) > 2.001 * samples.usual_interval(self.t))

    def stretches(self) -> tuple["Record", ...]:
        """The manoeuvre between its gaps in time, where nobody knows what the inputs did.

        Rows that are missing for longer than twice the usual sampling interval make a gap.
        Stretches of fewer than 16 samples are left out; without gaps it is the record itself.
        """
        if not len(gaps := self.gaps()):
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
        return {n: self.channel(n) + self.trim.get(n, 0.0) for n in (*self.inputs, *self.outputs)}

    def total(self) -> "Record":
        """The same manoeuvre in total values: what was subtracted as trim added back.

        The trim of what is no channel stays: it says in which condition the record was flown.
        """
        u, y = (
            values + [self.trim.get(name, 0.0) for name in names]
            for values, names in ((self.u, self.inputs), (self.y, self.outputs))
        )
        other = {k: v for k, v in self.trim.items() if k not in {*self.inputs, *self.outputs}}
        return replace(self, u=u, y=y, trim=other)

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

    def resample(self, dt: float) -> "Record":
        """The same manoeuvre at equidistant instants, every ``dt`` [s].

        Outputs follow a cubic spline, inputs what they do between samples (`hold`); what was lost
        stays lost, between samples of a slower channel too. Where ``dt`` is longer than the
        interval by half or more, all pass a symmetric filter first, so that nothing above the new
        Nyquist frequency is folded back; what it gives is lost, too, where over a tenth of its
        weight is on lost samples. The `stretches` between gaps are resampled each by itself.

        Raises
        ------
        ValueError
            No positive interval, one beyond the record, ten million samples; gaps leave no 16.
        """
        least = self.duration / MOST
        if not least < dt < self.duration:
            raise ValueError(
                f"record {self.name!r}: dt={dt}, expected above {least:.3g} s ({MOST} samples) and "
                f"below {self.duration:g} s, the record's duration"
            )
        if len(self.gaps()):
            return self._resampled_pieces(dt)
        t, values = regridding.resampled(self.t, self._columns(), dt)
        warn_of_corners(self, dt)
        hold: Hold = "foh" if dt >= samples.SLOWER * self.dt else self.hold
        found = replace(self, t=t, u=values[:, : self.nu], y=values[:, self.nu :], hold=hold)
        return with_steps_told(found, self, {})

    def _resampled_pieces(self, dt: float) -> "Record":
        """Every stretch between gaps resampled by itself, and the gaps still told as such."""
        pieces, parts = self.stretches(), []
        for piece, later in zip_longest(pieces, pieces[1:]):
            # At the new interval, too, a gap is longer than two of them.
            end = piece.t[-1] if later is None else min(piece.t[-1], later.t[0] - 2.01 * dt)
            kept = piece.take(piece.t <= end) if end > piece.t[0] + (FEWEST - 1) * dt else None
            parts += [kept.resample(dt)] if kept is not None else []
        if not parts:
            raise ValueError(
                f"record {self.name!r} has gaps in time, and no stretch of {FEWEST} samples every "
                f"{dt:g} s between them; resample it at shorter intervals, or leave it out"
            )
        t, u, y = (np.concatenate([getattr(x, name) for x in parts]) for name in "tuy")
        return replace(self, t=t, u=u, y=y, hold=parts[0].hold)

    def shift(
        self, by: Mapping[str, float], *, drift: Mapping[str, float] | None = None
    ) -> "Record":
        """Channels moved in time [s]: -0.06 for one that is 0.06 s late.

        And by ``drift`` [s/s], 0.05 at most, from the start: -5e-4 if later by 0.5 ms each second.
        Samples at the ends and beside gaps in time that a shifted input does not reach are left
        out. An output stays missing where the sample nearest to it is.
        """
        drift = samples.plausible(drift or {})
        for name in (*by, *drift):
            self.channel(name)

        def late(t: Array) -> list[Array]:
            return [by.get(name, 0.0) + drift.get(name, 0.0) * (t - self.t[0]) for name in names]

        names = (*self.inputs, *self.outputs)
        ends = np.array(late(self.t[[0, -1]]))
        first, last = ends[:, 0].max(initial=0.0) - 1e-9, ends[:, 1].min(initial=0.0) + 1e-9
        kept = self.cut(self.t[0] + first, self.t[-1] + last)
        columns = zip(self._columns(), [*kept.u.T, *kept.y.T], late(kept.t), strict=True)
        x = np.array(
            [
                samples.moved(self.t, x, kept.t - lag, how) if lag.any() else same
                for (x, how), same, lag in columns
            ]
        ).T
        known = ~np.isnan(x[:, : self.nu]).any(axis=1)
        found = replace(kept, t=kept.t[known], u=x[known, : self.nu], y=x[known, self.nu :])
        return with_steps_told(found, self, by)

    def join(self, other: "Record", *, clock: float = 0.0) -> "Record":
        """The record with the channels of another logger, at the instants of this one.

        Of one faster by half or more all but steps are filtered first, as by `resample`. Outputs of
        a slower one are missing between its samples, inputs are filled in or left out.

        Parameters
        ----------
        other : Record
            Of the same flight, with other channels.
        clock : float
            Added to its time [s], so that both run on one clock.

        Raises
        ------
        ValueError
            No time in common, a channel that both have.
        """
        t, hold = other.t + clock, self.hold if self.nu else other.hold
        mine, steps = self.cut(float(t[0]), float(t[-1])), hold == other.hold == "zoh"
        if not steps:
            warn_of_corners(other, mine.dt)
        x = regridding.joined(t, other._columns(), mine.t, mine.dt, steps=steps)
        known = np.asarray(~np.isnan(x[:, : other.nu]).any(axis=1))
        trim, units = {**self.trim, **other.trim}, {**self.units, **other.units}
        mine, x = replace(mine.take(known), trim=trim, units=units), x[known]
        u, y = np.hstack([mine.u, x[:, : other.nu]]), np.hstack([mine.y, x[:, other.nu :]])
        inputs, outputs = self.inputs + other.inputs, self.outputs + other.outputs
        found = replace(mine, u=u, y=y, inputs=inputs, outputs=outputs, hold=hold)
        return with_steps_told(found, other, dict.fromkeys(other.inputs, clock))

    def _columns(self) -> list[tuple[Array, samples.Between]]:
        """Every channel with what it does between samples."""
        held: list[tuple[Array, samples.Between]] = [(x, self.hold) for x in self.u.T]
        return [*held, *((x, "smooth") for x in self.y.T)]

    def rename(self, names: Mapping[str, str]) -> "Record":
        """The same manoeuvre with other names for some channels, ``{"old": "new"}``."""
        for name in names:
            self.channel(name)
        new = {name: names.get(name, name) for name in (*self.inputs, *self.outputs)}
        inputs, outputs = (tuple(new[k] for k in group) for group in (self.inputs, self.outputs))
        trim = {new.get(k, k): value for k, value in self.trim.items()}
        units = {new.get(k, k): unit for k, unit in self.units.items()}
        return replace(self, inputs=inputs, outputs=outputs, trim=trim, units=units)

    def between(self, start: float, end: float) -> "Record":
        """`cut`, by its older name."""
        return self.cut(start, end)

    def cut(self, start: float, end: float) -> "Record":
        """Return the samples with ``start <= t <= end`` [s]."""
        keep = (self.t >= start) & (self.t <= end)
        if (n := int(keep.sum())) < 2:
            raise ValueError(
                f"record {self.name!r} has {n} sample{'s' * (n != 1)} between {start:.12g} s and "
                f"{end:.12g} s; it lasts from {self.t[0]:.12g} s to {self.t[-1]:.12g} s"
            )
        return self.take(keep)

    def mask(self, where: BoolArray) -> "Record":
        """The same manoeuvre with some output samples missing: ``where`` (N, ny) is true."""
        if (shape := np.shape(where)) != self.y.shape:
            wanted = f"expected (N, ny) = {self.y.shape}, true where a sample is to be missing"
            raise ValueError(f"record {self.name!r}: where has shape {shape}, {wanted}")
        return replace(self, y=np.where(where, np.nan, self.y))

    def decimate(self, step: int) -> "Record":
        """Every ``step``-th sample, unfiltered; the hold then applies between these."""
        if not 1 <= step < self.N:
            raise ValueError(f"record {self.name!r}: step={step}, expected 1 to {self.N - 1}")
        return with_rest_told(self.take(slice(None, None, step)), self)

    def quiet_samples(self) -> int:
        """Number of samples before the first input leaves its initial value.

        An input has left when it is more than 2 % of its range away from its first sample or, if
        it is noisy, five deviations of its noise from the mean of its first ten; it began to leave
        behind the last sample before that differs no more than its own noise does.
        """
        return samples.resting(self.u)

    def detrend(self, how: Literal["first", "mean"] | Mapping[str, float] | None) -> "Record":
        """Subtract the trim from every channel and remember it.

        Parameters
        ----------
        how : {"first", "mean"}, mapping or None
            ``"first"``: the mean of the stretch before the first input moves, with a `DataWarning`
            if that is shorter than 0.5 s; ``"mean"``: the mean of the record; a mapping gives the
            trim of every channel (for a record that is excited from its first sample: another
            record's ``trim``); None leaves it as it is.
        """
        if how is None:
            return self
        if how == "first":
            trim = self._means(self._rest())
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
        own = {name: self.trim.get(name, 0.0) + trim[name] for name in names}
        return replace(self, u=u, y=y, trim={**self.trim, **own})

    def with_noise(self, std: Mapping[str, float], rng: np.random.Generator) -> "Record":
        """White Gaussian measurement noise added to the named outputs (standard deviations)."""
        for name in std:
            _position(name, self.outputs, "output", self.name)
        sigma = [std.get(name, 0.0) for name in self.outputs]
        return replace(self, y=self.y + sigma * rng.standard_normal(self.y.shape))

    def _rest(self) -> int:
        """Samples that a trim is taken from, one at least; a warning if they are few."""
        n = max(self.quiet_samples(), 1)
        if n < self.N and (length := float(self.t[n] - self.t[0])) < REST:
            warn(
                f"record {self.name!r}: an input moves {length:.3g} s after the start, so that its "
                f"trim is the mean of {n} sample{'s' * (n > 1)}; take that of another record, or "
                'detrend="mean"'
            )
        return n

    def _means(self, n: int) -> dict[str, float]:
        means = {name: float(self.u[:n, i].mean()) for i, name in enumerate(self.inputs)}
        for i, name in enumerate(self.outputs):
            head = self.y[:n, i]
            if np.isnan(head).all():
                raise ValueError(
                    f"record {self.name!r}: output {name!r} has no sample in its first {n}; "
                    'pass the trim of another record, or detrend="mean" if samples follow'
                )
            means[name] = float(np.nanmean(head))
        return means


def _position(name: str, names: tuple[str, ...], kind: str, record: str) -> int:
    if name not in names:
        raise ValueError(
            f"record {record!r} has no {kind} {name!r}; it has {', '.join(names)}"
            f"{spelling(name, names)}"
        )
    return names.index(name)
