"""Does a record hold the aircraft or its controller: how much of the inputs comes from outside.

A long vector autoregression of z = (y, u), A(q) z = e, splits every input's spectrum into what its
own innovations make and what the outputs' innovations make of it through whatever feeds them back,

    Φ_u = H_uu Σ_u H_uuᴴ + H_uy Σ_y H_uyᴴ,    H = A(e^(jω dt))⁻¹,

once with the outputs before the inputs in the same sample (what both innovations share is feedback)
and once the other way round. Where little comes from outside, a model from u to y is the inverse of
the controller (L. Ljung, System Identification, 2nd ed., section 13.4). Rates cannot jump with a
command, so the first order is the one to believe; the second is what wrong clocks could hide.
Specific forces do jump with it: they come after the inputs, and only what they were is fed back.

Flights with other feedback or other inputs have autoregressions of their own: one of all of them
takes what tells them apart for excitation. Only where Akaike's criterion prefers it, one is fitted
to all; else their spectra are added, by length: an input counts in a flight by its power there.
"""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray
from casid.autoregression import filled
from casid.channels import FORCES, RATES
from casid.display import Shown, instant
from casid.errors import DataWarning
from casid.record import Record
from casid.records import Records, same_channels, stretches
from casid.repeated_samples import without_repeats
from casid.resting_outputs import unanswered
from casid.samples import runs
from casid.threads import one_thread
from casid.values import storable
from casid.vector_autoregression import VectorAutoregression, of_flights, of_records

POINTS = 60  # frequencies
EDGES = 0.05, 0.95  # of an input's power between which it is judged
LITTLE = 0.3  # share from outside below which a band is doubted
JOINTLY = 0.1  # the same of all inputs together
WEAK = 0.003  # power of a combination of inputs of power one, below which it does not move
WIDE = 1.3  # ratio of frequencies that a doubted band spans at least
ANSWER = 0.5  # share of an output that outside inputs make, and
COHERENT = 0.85  # that goes with the inputs, below both of which it does not answer them
APART = 0.4  # of an angular rate: if less goes with the inputs it is disturbed
FEWEST = 3  # samples of a slow sensor
SINGULAR = 1e-9  # relative power of an innovation that no noise drives


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Excitation(Shown):
    """Shares of the inputs' power that do not come back from the outputs.

    Parameters
    ----------
    inputs, outputs : tuple of str
        Channels that move in some record.
    omega : (K,) array
        Frequencies [rad/s].
    lower, upper : (K, nu) array
        Share of each input's power from outside: with all that the innovations of outputs and
        inputs share taken for feedback, and with none of it. Of a controller that saw less noise
        than the record has (noise added afterwards) what it feeds back passes for outside input.
    joint : (K,) array
        The smallest share of any combination of the inputs, each of power one; combinations that
        hardly move at all count as fed back.
    answer, coherence : (ny,) array
        Share of each output's power that the outside part of the inputs makes, and that goes with
        the inputs wherever they come from, beyond what goes with as many inputs by chance.
    within : (K, nu) bool array
        Frequencies between which 90 % of an input's power lies.
    lags : int
        Of the autoregression, the longest of several.
    unanswered : tuple of (str, float, float)
        Record, from and to [s]: inputs move and all outputs rest.
    singular : bool
        Whether the outputs can be predicted without error, as without noise: the spectra are
        singular, and nothing tells feedback from excitation.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    omega: Array
    lower: Array
    upper: Array
    joint: Array
    answer: Array
    coherence: Array
    within: BoolArray
    lags: int
    unanswered: tuple[tuple[str, float, float], ...] = ()
    singular: bool = False

    def headline(self) -> str:
        """The median share of every input from outside, and where it is smallest."""
        if self.singular:
            return "outputs exactly predictable (no noise?): feedback and excitation look alike"
        said = []
        for name, share, inside in zip(self.inputs, self.lower.T, self.within.T, strict=True):
            if inside.any():
                k = int(np.argmin(np.where(inside, share, np.inf)))
                middle = float(np.median(share[inside]))
                said.append(f"{name} {middle:.0%} ({share[k]:.0%} at {self.omega[k]:.2g} rad/s)")
        none = "no input moves enough to tell what share of it comes from outside"
        return f"share of each input that comes from outside: {', '.join(said)}" if said else none

    def ends(self) -> dict[str, float]:
        """Frequency [rad/s] above which an input holds little but what is fed back, by its name.

        Left out are inputs that come from outside up to the highest frequencies, inputs of which
        little does in all of their band (`doubts`), and all where nothing tells feedback from
        excitation.
        """
        found: dict[str, float] = {}
        for name, share, inside in zip(self.inputs, self.lower.T, self.within.T, strict=True):
            if self.singular or not inside.any():
                continue
            first, last = self.omega[inside][[0, -1]]
            above = [a for a, b in wide_bands(self.omega, share < LITTLE) if b >= last]
            if above and above[0] > first:
                found[name] = above[0]
        return found

    def doubts(self) -> tuple[str, ...]:
        """Why a model from these inputs may be one of the controller; empty where it is not."""
        said = [
            f"{name}: at {instant(start)}-{instant(end)} s the inputs move but no output does, "
            "so the aircraft is not flying. Cut that stretch off."
            for name, start, end in self.unanswered
        ]
        if self.singular:
            return tuple(said)
        alone = {i: self._alone(i, name) for i, name in enumerate(self.inputs)}
        doubted = [i for i, each in alone.items() if each]
        said += [*alone.values(), self._together(doubted), self._answer()]
        return tuple(each for each in said if each)

    def fed_back(self, inputs: Sequence[str], omega: Array) -> BoolArray:
        """Where so little of an input that is doubted comes from outside, (K, nu), at omega (K,).

        A response after that input says nothing of the aircraft there. Neither does it where
        inputs are hardly moved apart from outside: a test on one axis moves what feedback holds on
        another, and what tells the two apart is the noise that is fed back.
        """
        found = np.zeros((len(omega), len(inputs)), dtype=bool)
        for i, name in enumerate(self.inputs):
            if name in inputs and not self.singular and self._alone(i, name):
                little = (self.lower[:, i] < LITTLE) | (self.joint < JOINTLY)
                found[:, inputs.index(name)] = np.interp(omega, self.omega, little) > 1 / 2
        return found

    def _alone(self, i: int, name: str) -> str:
        inside = self.within[:, i] & (self.lower[:, i] < LITTLE)
        if not (bands := wide_bands(self.omega, inside)):
            return ""
        low, high = (float(np.median(each[inside, i])) for each in (self.lower, self.upper))
        named = " and ".join(f"{a:.2g}-{b:.2g}" for a, b in bands)
        return (
            f"Of input {name} only {low:.0%} comes from outside at {named} rad/s"
            + f" ({max(low, high):.0%} if it runs ahead of the outputs)" * (high > LITTLE)
            + ": the rest is fed back from the outputs, and a model identified there is the "
            "controller's inverse rather than the aircraft. Fly test inputs there, or leave that "
            "band out."
        )

    def _together(self, doubted: Sequence[int]) -> str:
        """Where that is not so of one of the inputs doubted by itself."""
        alone = (self.lower[:, doubted] < LITTLE).any(axis=1)
        bands = wide_bands(self.omega, self.within.any(axis=1) & (self.joint < JOINTLY) & ~alone)
        if not bands:
            return ""
        named = " and ".join(f"{a:.2g}-{b:.2g}" for a, b in bands)
        return (
            f"At {named} rad/s the inputs {', '.join(self.inputs)} are not moved independently "
            "from outside: fly every axis, one at a time."
        )

    def _answer(self) -> str:
        share = self.coherence
        if self.answer.max(initial=0.0) >= ANSWER or share.max(initial=0.0) >= COHERENT:
            apart = [
                f"{part:.0%} of {name}"
                for name, part in zip(self.outputs, share, strict=True)
                if name in RATES and part < APART
            ]
            return (
                f"The inputs explain only {' and '.join(apart)}: vibration, gusts or something "
                "unmeasured causes the rest. Nothing precise can be estimated from such a rate."
            ) * bool(apart)
        best = self.outputs[int(np.argmax(share))]
        return (
            f"No output responds to the inputs: they explain {share.max():.0%} of {best}, and "
            "less of the others. The aircraft is not flying, or something else moves it."
        )


def wide_bands(omega: Array, where: BoolArray) -> list[tuple[float, float]]:
    """Bands [rad/s] of neighbouring frequencies, from and to, that are wide enough to be told."""
    spans = [(float(omega[a]), float(omega[b - 1])) for a, b in runs(where)]
    return [(a, b) for a, b in spans if b >= WIDE * a]


@dataclass(frozen=True, eq=False, kw_only=True)
class Flights:
    """Autoregressions of flights, each channel z = (y, u) divided by its size."""

    parts: Sequence[Record]  # at equal intervals, all alike, of channels that move
    models: Sequence[VectorAutoregression]
    size: Array  # (ny + nu,) root mean square of each channel

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs that move in some record."""
        return self.parts[0].inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that move in some record."""
        return self.parts[0].outputs

    @property
    def dt(self) -> float:
        """Interval [s] between samples."""
        return self.parts[0].dt

    @property
    def singular(self) -> bool:
        """Whether the outputs can be predicted without error, as without noise."""
        ny = len(self.outputs)
        least = [np.linalg.eigvalsh(each.S[:ny, :ny])[0] for each in self.models]
        return bool(max(least) < SINGULAR)


def flights(records: Records, *, together: bool = False) -> Flights:
    """Autoregressions of records of the same channels; ValueError as of `excitation`.

    One serves all ``together``, or each has its own where they differ. A record without any
    measured output tells nothing of them, unless there is no other.
    """
    whole = stretches(records)
    parts = [even(part) for part in whole if np.isfinite(part.y).any()] or list(map(even, whole))
    same_channels(parts)
    parts = moving(parts)
    dt = max(part.dt for part in parts)
    parts = [part if part.dt > 0.999 * dt else part.resample(dt) for part in parts]
    columns = [z - z.mean(axis=0) for z in (np.hstack([part.y, part.u]) for part in parts)]
    size = np.sqrt(np.mean(np.vstack(columns) ** 2, axis=0))
    size = np.where(size > 0, size, 1.0)
    unit = [z / size for z in columns]
    models = [of_records(unit, dt)] if together else of_flights(unit, dt)
    return Flights(parts=parts, models=models, size=size)


@one_thread
def excitation(
    records: Records, omega: Array | None = None, *, direct: Collection[str] = FORCES
) -> Excitation:
    """How much of the inputs comes from outside and not back from the outputs.

    Parameters
    ----------
    records : Record or sequence of Record
        With the same channels, judged flight by flight unless they agree, and put together. Outputs
        late by a clock make feedback look like excitation, early ones excitation like feedback:
        apply skews that are known (`Record.shift`). Outliers look like excitation, too: mask them
        (`outliers`). Samples that only repeat the one before do not count.
    omega : array
        Frequencies [rad/s]; chosen from the records unless given.
    direct : collection of str
        Outputs that jump with the inputs.

    ValueError: records of different channels, or too short.
    """
    whole = stretches(records)
    flown = flights([at_slowest(without_repeats(part)) for part in whole])
    parts, found, dt = flown.parts, flown.models, flown.dt
    if omega is None:
        longest = max(part.duration for part in parts)
        omega = np.geomspace(min(4 * np.pi / longest, 0.2 / dt), 0.8 * np.pi / dt, POINTS)
    omega, felt = np.asarray(omega, dtype=float), np.isin(flown.outputs, list(direct))
    lower, upper, joint, answers = outside_shares(found, felt, omega * dt)
    # Spectra of p lags scatter as means of N/(2 p) periodograms, with which inputs agree by chance.
    means = sum(each.rows / (2 * len(each.A)) for each in found)
    coherence = 1 - (1 - answers[1]) * means / (means - len(flown.inputs))
    return Excitation(
        inputs=flown.inputs, outputs=flown.outputs, omega=omega,
        lower=lower, upper=np.maximum(lower, upper), joint=joint,
        answer=answers[0], coherence=np.maximum(coherence, 0.0),
        within=occupied_band(parts, omega),
        lags=max(len(each.A) for each in found),
        unanswered=tuple(span for part in whole for span in unanswered(part)),
        singular=flown.singular,
    )  # fmt: skip


def excitation_if_any(records: Records, direct: Collection[str] = FORCES) -> Excitation | None:
    """The excitation of records, None where they are too short or nothing moves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # of gaps, which others tell
        try:
            return excitation(records, direct=direct)
        except ValueError:
            return None


def moving(records: Sequence[Record]) -> list[Record]:
    """The records without channels that rest in all of them; ValueError if nothing is left."""
    first = records[0]
    u, y = (np.max([np.ptp(getattr(each, x), axis=0) for each in records], axis=0) for x in "uy")
    inputs = [name for name, reach in zip(first.inputs, u, strict=True) if reach > 0]
    outputs = [name for name, reach in zip(first.outputs, y, strict=True) if reach > 0]
    if not inputs or not outputs:
        raise ValueError("no input or no output moves in any record: there is nothing to judge")
    return [record.select(inputs, outputs) for record in records]


def at_slowest(record: Record) -> Record:
    """The record at the instants of its slowest output, where the others are measured then, too.

    Between its samples it would be drawn from one that is still to come, and seem to lead inputs.
    What a stick does between two of them, and the second has felt, still looks fed back.
    """
    seen = np.isfinite(record.y)
    together = np.flatnonzero(np.all(seen, axis=1))
    every = max((np.median(np.diff(np.flatnonzero(x))) for x in seen.T if x.sum() > 1), default=1)
    if every == 1 or len(together) < FEWEST or np.median(np.diff(together)) > every:
        return record
    return record.take(np.isin(np.arange(record.N), together))


def even(record: Record) -> Record:
    """The record at equal intervals, lost samples filled in, dead channels at rest."""
    if not record.equidistant:
        record = record.resample(record.dt)
    whole, _ = filled(record)
    return Record(whole.t, whole.u, np.nan_to_num(whole.y), whole.inputs, whole.outputs, whole.name)


def occupied_band(records: Sequence[Record], omega: Array) -> BoolArray:
    """Frequencies between which most of each input's power lies, (K, nu)."""
    grid = np.linspace(0, np.pi / records[0].dt, 2048)[1:]
    power = np.zeros((len(grid), records[0].nu))
    for record in records:
        u = (record.u - record.u.mean(axis=0)) * np.hanning(record.N)[:, None]
        lines = np.abs(np.fft.rfft(u, axis=0))[1:] ** 2
        at = 2 * np.pi / (record.N * record.dt) * np.arange(1, len(lines) + 1)
        total = np.vstack([np.zeros(record.nu), np.cumsum(lines, axis=0)])
        power += np.column_stack([np.interp(grid, [0.0, *at], column) for column in total.T])
    share = power / np.maximum(power[-1], 1e-300)
    inside = (share >= EDGES[0]) & (share <= EDGES[1])
    return np.column_stack([np.interp(omega, grid, each.astype(float)) > 0.5 for each in inside.T])


def outside_shares(
    models: Sequence[VectorAutoregression], felt: BoolArray, phase: Array
) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Lower, upper, joint share from outside, what follows; ``felt``: outputs that feel at once."""
    spectra, ny = [_spectra(each, felt, phase) for each in models], len(felt)
    late, early, whole = (sum(parts) for parts in zip(*spectra, strict=True))
    power = np.einsum("kii->ki", whole).real
    own, at_most = (np.einsum("kii->ki", each).real / power for each in (late, early))
    size = np.sqrt(power[:, ny:])
    scale = size[:, :, None] * size[:, None, :]
    inner = whole[:, ny:, ny:] / scale + WEAK * np.eye(size.shape[1])
    root = np.linalg.inv(np.linalg.cholesky(inner))
    part = root @ (late[:, ny:, ny:] / scale) @ root.conj().swapaxes(1, 2)
    joint = np.maximum(np.linalg.eigvalsh(part)[:, 0], 0.0)
    weight = power[:, :ny] * np.gradient(phase)[:, None]
    answer = np.sum(own[:, :ny] * weight, axis=0) / np.sum(weight, axis=0)
    return own[:, ny:], at_most[:, ny:], joint, (answer, coherent_share(whole, ny, phase))


def _spectra(model: VectorAutoregression, felt: BoolArray, phase: Array) -> tuple[Array, ...]:
    """Spectra (K, n, n) that the inputs' innovations make, last and first in a sample, and all."""
    ny, n = len(felt), len(model.S)
    inputs, before, after = np.arange(ny, n), np.flatnonzero(~felt), np.flatnonzero(felt)
    H = np.linalg.inv(model.polynomial(phase))
    made = []
    for order in (np.r_[before, inputs, after], np.r_[inputs, before, after]):
        root = np.zeros((n, n))
        root[order] = np.linalg.cholesky(model.S[np.ix_(order, order)])
        made.append(H @ root[:, np.isin(order, inputs)])
    made.append(H @ np.linalg.cholesky(model.S))
    return tuple(np.asarray(model.rows * F @ F.conj().swapaxes(1, 2)) for F in made)


def coherent_share(whole: Array, ny: int, phase: Array) -> Array:
    """Multiple coherence of each output with the inputs, weighed by power over the band, (ny,)."""
    power = np.einsum("kii->ki", whole).real
    size = np.sqrt(np.where(power > 0, power, 1.0))[:, ny:]
    across = whole[:, :ny, ny:] / size[:, None, :]
    scale = size[:, :, None] * size[:, None, :]
    inner = whole[:, ny:, ny:] / scale + 1e-9 * np.eye(size.shape[1])
    gain = np.linalg.solve(inner, across.conj().swapaxes(1, 2)).conj().swapaxes(1, 2)
    coherent = np.sum(gain * across.conj(), axis=2).real
    spacing = np.gradient(phase)[:, None]
    return np.asarray(np.sum(coherent * spacing, axis=0) / np.sum(power[:, :ny] * spacing, axis=0))
