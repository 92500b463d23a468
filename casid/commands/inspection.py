"""What records hold, and whether a structure could be identified from them; nothing is fitted."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array, BoolArray
from casid.channels import UNITS
from casid.consistency.kinematics import KinematicCheck, kinematic_check
from casid.consistency.measured import strays, white_noise
from casid.consistency.plausibility import unit_doubts
from casid.display import Cells, Shown, counted, in_a_row, instant, listed
from casid.excitations import Excitation, excitation_if_any
from casid.model import Bounds, Model
from casid.record import REST, Record
from casid.records import Records, same_channels, several, steps_told, still, twins_told
from casid.repeated_samples import repeated, source_interval
from casid.report.tables import cells
from casid.samples import bursts, usual_interval
from casid.saturation import longest_stop, saturated
from casid.seams import seams_told
from casid.structure.identifiability import Identifiability, identifiability
from casid.stuck_channels import Frozen, frozen

ALIKE = 0.8  # correlation of two inputs over all records
WEAK = 3.0  # signal over noise
GAP = 0.05  # of the time that was recorded
SHARES = (0.05, 0.5, 0.95)  # of a channel's power
NOISY = 0.05  # of an input's deviation: noise that biases what follows from it
PER_PERIOD = 5.0  # samples in a period of the fastest input


@dataclass(frozen=True, eq=False, kw_only=True)
class ChannelFacts:
    """One channel of one record."""

    name: str
    unit: str  # of the channel's usual name
    lowest: float
    highest: float
    deviation: float
    noise: float  # standard deviation, from third differences
    missing: float  # share of the samples at its own rate
    outliers: tuple[float, ...]  # instants [s] of samples that nothing around or beside bears out
    source: float  # interval [s] of the slower source whose samples are repeated, 0 if none are
    clipped: int  # longest run of equal samples at an extreme, if saturated
    band: Array  # (3,) [rad/s] below which 5, 50, 95 % of its power lie; NaN at rest


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordFacts:
    """One record: sampling, gaps (instant and length [s]), quiet start [s] and its channels."""

    name: str
    samples: int
    duration: float
    interval: float
    equidistant: bool
    quiet: float
    gaps: tuple[tuple[float, float], ...]
    channels: tuple[ChannelFacts, ...]
    frozen: tuple[Frozen, ...]  # stretches that are stuck or copied


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Inspection(Shown):
    """All that `inspect_records` found.

    Parameters
    ----------
    records : tuple of RecordFacts
        One a record.
    inputs, outputs : tuple of str
        Channels.
    correlation : (nu, nu) array
        Of the inputs over all records, means removed; NaN for one that never moves.
    kinematics : KinematicCheck
        Whether the channels agree with each other.
    identifiability : Identifiability or None
        Of the structure, if one was given.
    excitation : Excitation or None
        How much of the inputs comes from outside; None of records too short to tell.
    advice : tuple of str
        What to mend or to know before an identification; empty if nothing is in its way.
    """

    records: tuple[RecordFacts, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    correlation: Array
    kinematics: KinematicCheck
    excitation: Excitation | None
    identifiability: Identifiability | None
    advice: tuple[str, ...]

    def headline(self) -> str:
        """Records, channels, and how much there is to mend or to know."""
        return (
            f"{counted(len(self.records), 'record')}, inputs {listed(self.inputs)}, outputs "
            f"{listed(self.outputs)}; {counted(len(self.advice), 'thing')} to mend or to know"
        )

    @property
    def usable(self) -> bool | None:
        """Whether the records can tell the structure's parameters apart; None without one."""
        return None if self.identifiability is None else self.identifiability.identifiable


@cells.register
def _(value: Inspection) -> Cells:
    return ("advice",), [[said] for said in value.advice or ("nothing is in the way",)]


def inspect_records(
    records: Records,
    *,
    model: Model | None = None,
    fixed: Collection[str] = (),
    bounds: Bounds | None = None,
    time: str = "t",
    stated: Collection[str] = (),
) -> Inspection:
    """Look at records before anything is identified from them.

    Parameters
    ----------
    records : Record or sequence of Record
        With the same channels, trim removed or not.
    model, fixed, bounds
        Structure whose identifiability is judged; as in `identifiability`.
    time : str
        Name of the time column.
    stated : collection of str
        Columns whose unit was stated when they were read, or that by column; others are doubted.

    Raises
    ------
    ValueError, ModelError
        No record, records with different channels, a channel the model needs and the records lack.
    """
    records = several(records)
    inputs, outputs = same_channels(records)
    marks = [strays(record) for record in records]
    facts = tuple(_facts(*each) for each in zip(records, marks, strict=True))
    # What no instrument measured says nothing about units, kinematics and excitation.
    records = tuple(record.mask(where) for record, where in zip(records, marks, strict=True))
    correlation = _correlation(records)
    kinematics = kinematic_check(records)
    found = None
    if model is not None:
        found = identifiability(model, records, fixed=fixed, bounds=bounds)
    advice = unit_advice(records, time, stated)
    advice += [said for each in facts for said in _record_advice(each, inputs)]
    advice += [f"{each.name}: {said}" for each in records for said in seams_told(each)]
    advice += steps_told(records, inputs) + twins_told(records)
    advice += _excitation_advice(facts, inputs, still(records, (*inputs, *outputs)))
    advice += _correlation_advice(correlation, inputs)
    advice += list(kinematics.remarks)
    moves = kinematics.shifts_of(outputs)[0]  # what comes late looks like feedback
    least = 3 * max(map(abs, moves.values()), default=0.0)  # s of what can be moved
    outside = excitation_if_any([r.shift(moves) if r.duration > least else r for r in records])
    advice += [] if outside is None else outside.doubts()
    if model is not None and found is not None:
        advice += _model_advice(type(model).__name__, found)
    return Inspection(
        records=facts,
        inputs=inputs,
        outputs=outputs,
        correlation=correlation,
        kinematics=kinematics,
        excitation=outside,
        identifiability=found,
        advice=tuple(dict.fromkeys(advice)),
    )


def _facts(record: Record, marks: BoolArray) -> RecordFacts:
    steps = np.diff(record.t)
    quiet = record.t[min(record.quiet_samples(), record.N - 1)] - record.t[0]
    held = repeated(record)
    slow = {
        name: source_interval(record, held, i) if held[:, i].any() else 0.0
        for i, name in enumerate((*record.inputs, *record.outputs))
    }
    far = {
        name: tuple(record.t[mark].tolist())
        for name, mark in zip(record.outputs, marks.T, strict=True)
    }
    return RecordFacts(
        name=record.name,
        samples=record.N,
        duration=record.duration,
        interval=record.dt,
        equidistant=record.equidistant,
        quiet=float(quiet),
        gaps=tuple((float(record.t[k]), float(steps[k])) for k in record.gaps()),
        channels=tuple(
            _channel(record, name, far.get(name, ()), source) for name, source in slow.items()
        ),
        frozen=frozen(record),
    )


def _channel(record: Record, name: str, far: tuple[float, ...], source: float) -> ChannelFacts:
    raw = record.channel(name) + record.trim.get(name, 0.0)
    own, known = UNITS | dict(record.units), ~np.isnan(raw)
    missing = _missing(known)
    known &= ~np.isin(record.t, far)
    t, values = record.t[known], raw[known]
    if len(values) < 4:  # nothing can be said
        numbers = ("lowest", "highest", "deviation", "noise")
        empty: dict[str, Any] = dict.fromkeys(numbers, np.nan) | {"band": np.full(3, np.nan)}
        unit = own.get(name, "")
        known_: Any = {"missing": missing, "outliers": (), "clipped": 0, "source": 0.0}
        return ChannelFacts(name=name, unit=unit, **known_, **empty)
    return ChannelFacts(
        name=name,
        unit=own.get(name, ""),
        lowest=float(values.min()),
        highest=float(values.max()),
        deviation=float(values.std()),
        noise=_noise(values),
        missing=missing,
        outliers=far,
        source=source,
        clipped=longest_stop(values, stick=name in record.inputs),
        band=_band(t, values),
    )


def _missing(known: BoolArray) -> float:
    """Share of a channel's samples that are missing; a slower one has but every n-th."""
    every = max(1, int(np.median(np.diff(np.flatnonzero(known))))) if known.sum() > 1 else 1
    return float(max(0.0, 1 - known.sum() / np.ceil(len(known) / every)))


def _noise(values: Array) -> float:
    """Deviation of white noise; none on what rests or moves evenly for most of the time."""
    steps = np.abs(np.diff(values, 3))
    return white_noise(values) if np.median(steps) > 1e-9 * np.ptp(values) else 0.0


def _band(t: Array, values: Array) -> Array:
    """Frequencies [rad/s] below which the shares of a channel's power lie; NaN where it rests.

    Of the longest stretch between gaps that straight lines across them would tell of, at the
    channel's own interval, which may be several of the record's.
    """
    own = float(np.median(np.diff(t)))
    gap = max(GAP * len(t) * own, 2.001 * usual_interval(t))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(t) > gap) + 1, [len(t)]])
    k = int(np.argmax(np.diff(edges)))
    t, values = t[edges[k] : edges[k + 1]], values[edges[k] : edges[k + 1]]
    duration = float(t[-1] - t[0])
    even = np.interp(np.linspace(t[0], t[-1], round(duration / own) + 1), t, values)
    centred = (even - even.mean()) * np.hanning(len(even))
    power = np.abs(np.fft.rfft(centred))[1:] ** 2
    total = np.cumsum(power)
    if not np.ptp(values) > 1e-12 * np.abs(values).max():
        return np.full(3, np.nan)
    places = np.searchsorted(total, np.array(SHARES) * total[-1])
    return np.asarray(2 * np.pi / duration * (places + 1))


def _correlation(records: Sequence[Record]) -> Array:
    u = np.vstack([record.u - record.u.mean(axis=0) for record in records])
    size = np.sqrt(np.sum(u**2, axis=0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(u.T @ u / np.outer(size, size))


def unit_advice(records: Sequence[Record], time: str, stated: Collection[str]) -> list[str]:
    """One line a column whose unit is probably another, from the first record that shows it."""
    said: dict[str, str] = {}
    for record in records:
        for doubt in unit_doubts(record, time, stated):
            asked = doubt.advice(f", {doubt.asked()}")
            said.setdefault(doubt.channel, f"{record.name}: {doubt.said}; {asked}")
    return list(said.values())


def _record_advice(facts: RecordFacts, inputs: Sequence[str]) -> list[str]:
    said = []
    if facts.gaps:
        start, length = max(facts.gaps, key=lambda gap: gap[1])
        said.append(
            f"{facts.name}: {counted(len(facts.gaps), 'gap')} in time, the longest of "
            f"{length:.3g} s at {instant(start)} s; split the record at long ones (Record.cut)"
        )
    if facts.quiet < REST:
        said.append(
            f"{facts.name}: an input moves within {REST:g} s of the start, so there is no trim; "
            "take that of another record (detrend)"
        )
    said += [f"{facts.name}: {stretch.told()}" for stretch in facts.frozen]
    for channel in facts.channels:
        if channel.clipped:
            stick = channel.name in inputs
            said.append(saturated(facts.name, channel.name, channel.clipped, stick=stick))
        if n := len(channel.outliers):
            rows = bursts(channel.outliers, facts.interval)
            said.append(
                f"{facts.name}: {channel.name} has {n} outlier{'s' * (n > 1)}, the first at "
                f"{instant(channel.outliers[0])} s{in_a_row(rows)}; mark as missing what no "
                "instrument measures (Record.mask)"
            )
        if channel.source:
            rates = f"{1 / channel.source:.3g} Hz, logged at {1 / facts.interval:.3g} Hz"
            said.append(
                f"{facts.name}: {channel.name} repeats samples: its source has {rates}; treat "
                'the repeated ones as missing ([channels] repeats = "mask", without_repeats)'
            )
        if channel.missing:
            said.append(f"{facts.name}: {channel.name} lacks {channel.missing:.1%} of its samples")
    return said


def _excitation_advice(
    facts: Sequence[RecordFacts], inputs: Sequence[str], resting: Collection[str]
) -> list[str]:
    said = []
    for i in range(len(facts[0].channels)):
        seen = [each.channels[i] for each in facts]
        best = max(seen, key=lambda channel: np.nan_to_num(channel.deviation))
        name = best.name
        if name in resting:
            why = "fly it" if name in inputs else "look at its sensor, or leave it out"
            said.append(f"{name} never moves: {why}")
        elif name in inputs:
            interval = max(each.interval for each in facts)
            if (share := _noise_share(facts, i)) > NOISY:
                said.append(
                    f"the noise of {name} is {share:.0%} of its movement in all records: if its "
                    "instrument causes that, and not a controller that passes on sensor noise, "
                    f"gains come out too small by up to {share**2:.1%} and standard errors too "
                    "small, because estimators assume that inputs are known exactly; filter all "
                    "channels alike (Record.resample), or record the command to the actuator"
                )
            darts = {part.channel for each in facts for part in each.frozen if part.dart}
            if best.band[2] * interval * PER_PERIOD > 2 * np.pi and name not in darts:
                said.append(
                    f"{name} has power up to {best.band[2]:.3g} rad/s, less than {PER_PERIOD:g} "
                    f"samples a period at {interval:g} s: record faster"
                )
        elif best.deviation < WEAK * best.noise:
            said.append(
                f"{name} is mostly noise: {best.noise:.2g} of a deviation of {best.deviation:.2g} "
                "in the record where it moves most; fly larger inputs or leave it out"
            )
    return said


def _noise_share(facts: Sequence[RecordFacts], channel: int) -> float:
    """Noise of a channel in its deviation, of all records' power: where it rests it biases none."""
    power = np.zeros(2)
    for each in facts:
        seen = each.channels[channel]
        power += each.samples * np.nan_to_num([seen.noise**2, seen.deviation**2])
    return min(float(np.sqrt(power[0] / max(power[1], 1e-300))), 1.0)


def _correlation_advice(correlation: Array, inputs: Sequence[str]) -> list[str]:
    return [
        f"{inputs[i]} and {inputs[j]} move together (correlation {correlation[i, j]:+.2f} over all "
        "records), so their effects cannot be told apart well: move one at a time"
        for i in range(len(inputs))
        for j in range(i)
        if abs(correlation[i, j]) > ALIKE
    ]


def _model_advice(name: str, found: Identifiability) -> list[str]:
    lines = [f"{name}: {line}" for line in str(found).splitlines()[1:]]
    if found.identifiable:
        return lines
    return [f"these records cannot tell all parameters of {name} apart", *lines]
