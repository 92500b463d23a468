"""What was measured in flight, as kinematics looks at it: total values on equidistant instants."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray
from casid.autoregression import filled, slow
from casid.channels import AIR, ATTITUDES, FORCES, RATES, VELOCITIES
from casid.frequency.sampling import equidistant
from casid.outlier_detection import FAR, outliers
from casid.record import Record
from casid.repeated_samples import least_step, repeated
from casid.samples import BURST, MAD, at_instants, runs

MOST = 60_000  # samples that are looked at
SHORTEST = 20  # samples
GAPS = 0.2  # share of missing samples above which a channel is left out
COARSE = 0.03  # rounding, of what a channel moves: more is seen in its scale
CROSSED = "++-+++---+-"  # signs of eleven channels, turned on from one of twelve draws to the next
COLUMNS = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "u", "v", "w")
MATES = {"psi": "ax"}  # of which no equation has both
LONGEST = 1.0  # s that a channel is lost within a stretch: nobody knows what it did in more


@dataclass(frozen=True, eq=False)
class Flight:
    """Total values of the channels of one record on equidistant instants."""

    dt: float
    quiet: int
    values: dict[str, Array]
    rows: dict[str, NDArray[np.intp]] = field(default_factory=dict)  # own samples of slow channels
    level: dict[str, float] = field(default_factory=dict)  # attitudes that were not recorded
    record: int = 0  # of which it is a stretch
    start: float = 0.0  # from that of the record [s]
    held: float = 0.0  # for how long inputs are held from sample to sample [s]
    late: dict[str, float] = field(default_factory=dict)  # clocks already known [s]

    @property
    def t(self) -> Array:
        """Instants from the first sample [s]."""
        n = len(next(iter(self.values.values())))
        return np.asarray(self.dt * np.arange(n))

    @property
    def tilts(self) -> bool:
        """Whether its pitch attitude is neither recorded nor given."""
        return "theta" not in self.values and not self.level.get("theta")

    def own(self, name: str) -> Array:
        """A channel at its own samples, of which slower ones have fewer."""
        return self.values[name][self.rows[name]] if name in self.rows else self.values[name]

    def step(self, name: str) -> float:
        """Instants from one sample of a channel to its next."""
        return float(np.median(np.diff(self.rows[name]))) if name in self.rows else 1.0

    def scatter(self, rng: np.random.Generator) -> dict[str, Array]:
        """Noise as there is on each channel; straight lines between samples of a slow one."""
        found: dict[str, Array] = {}
        for name, x in self.values.items():
            own = self.own(name)
            drawn = white_noise(own) * rng.standard_normal(len(own))
            at = self.rows[name] if name in self.rows else np.arange(len(x))
            found[name] = np.asarray(np.interp(np.arange(len(x)), at, drawn))
        return found

    def only(self, names: Collection[str]) -> "Flight":
        """The same flight with some of its channels, in the order they have."""
        return replace(self, values={k: x for k, x in self.values.items() if k in names})


def noisier(flights: Sequence[Flight], rng: np.random.Generator) -> Iterator[list[Flight]]:
    """Flights with as much noise again, of signs whose mean leaves each channel's own square.

    What is odd in it and products of two channels, which are nothing but chance, cancel: R. L.
    Plackett, J. P. Burman, The design of optimum multifactorial experiments, Biometrika 33, 1946.
    """
    row = np.array([1.0 if sign == "+" else -1.0 for sign in CROSSED])
    more = [flight.scatter(rng) for flight in flights]
    for signs in (*(np.roll(row, k) for k in range(len(row))), -np.ones(len(row))):
        of = dict(zip(COLUMNS, signs, strict=True))
        of |= {name: of[mate] for name, mate in MATES.items()}
        yield [
            replace(each, values={k: x + of.get(k, 1.0) * add[k] for k, x in each.values.items()})
            for each, add in zip(flights, more, strict=True)
        ]


def strays(record: Record) -> BoolArray:
    """Outliers (N, ny); samples repeated of a slower source are such where what they repeat is.

    A channel that is held moves in steps, which nothing around bears out.
    """
    held = repeated(record)[:, record.nu :]
    if not held.any():
        return outliers(record)
    found = outliers(record.mask(held))
    rows = np.arange(record.N)[:, None]
    source = np.maximum.accumulate(np.where(held | np.isnan(record.y), 0, rows), axis=0)
    return np.where(held, np.take_along_axis(found, source, axis=0), found)


def coarse_step(flights: Sequence[Flight], name: str) -> float:
    """Step of a channel that is too coarse for how it moves in these flights; 0 if it is not.

    It rests on each step for several samples: no noise blurs what was lost to rounding.
    """
    own = [flight.own(name) for flight in flights]
    step = max(map(least_step, own))
    rests = float(np.median(np.abs(np.concatenate([np.diff(x) for x in own])))) == 0.0
    moves = float(np.sqrt(np.mean([np.var(x) for x in own])))
    return step if rests and step / np.sqrt(12) > COARSE * moves else 0.0


def looked_at(records: Sequence[Record]) -> list[tuple[int, Record]]:
    """Stretches without long gaps, and of which record each is; cut where there are too many."""
    pieces = [
        (k, each)
        for k, record in enumerate(records)
        for each in record.stretches()
        if each.N >= SHORTEST
    ]
    share = min(1.0, MOST / max(sum(piece.N for _, piece in pieces), 1))
    return [(k, piece.take(slice(max(int(share * piece.N), SHORTEST)))) for k, piece in pieces]


def measured_parts(record: Record) -> list[Record]:
    """What a stretch is cut into where a channel is lost for long, or from the start or to the end.

    But for slow ones, whose samples are no losses, and those that are hardly there.
    """
    lost = np.isnan(record.y)
    lost &= ~slow(lost) & (lost.mean(axis=0) <= GAPS)
    unknown = np.zeros(record.N, dtype=bool)
    for a, b in (each for column in lost.T for each in runs(column)):
        inside = a > 0 and b < record.N
        unknown[a:b] |= b - a > (max(LONGEST / record.dt, BURST) if inside else BURST)
    parts = [
        record.take(slice(a, b))
        for a, b in runs(~unknown)
        if b - a >= SHORTEST and (lost[a:b].mean(axis=0) <= GAPS).all()
    ]
    return parts or [record]


def signals(
    record: Record, trim: Mapping[str, float], which: int = 0, start: float = 0.0
) -> Flight:
    """Total values of a stretch on equidistant instants, no sample missing.

    It begins ``start`` [s] after record ``which``.
    """
    quiet, held = record.quiet_samples(), record.dt if record.hold == "zoh" else 0.0
    # A slow channel is judged at its own samples: what lies between them carries no noise.
    lost = np.isnan(record.y)
    rare = slow(lost)
    taken = {record.outputs[i]: record.t[~lost[:, i]] for i in np.flatnonzero(rare)}
    if not record.equidistant:
        record = equidistant(record, 0.0)
    record = _expected(record, rare)
    values = {}
    for i, name in enumerate(record.outputs):
        if name not in {*RATES, *FORCES, *ATTITUDES, *VELOCITIES, *AIR}:
            continue
        y = record.y[:, i] + record.trim.get(name, 0.0) + trim.get(name, 0.0)
        missing = np.isnan(y)
        if rare[i]:  # nothing is lost: it is sampled less often than others
            y = at_instants(record.t, y, record.t, "smooth")
            missing = np.isnan(y)
        if missing.mean() > GAPS:
            continue
        values[name] = np.interp(record.t, record.t[~missing], y[~missing])
    if {*AIR} <= set(values) and not {*VELOCITIES} <= set(values):
        values |= _velocities(values)
        slowest = min({*AIR} & {*taken}, key=lambda name: len(taken[name]), default="")
        taken |= dict.fromkeys(VELOCITIES, taken[slowest]) if slowest else {}
    level = {
        name: record.trim.get(f"{name}0", trim.get(f"{name}0", 0.0))
        for name in {"phi", "theta"} - {*values}
    }
    rows = {
        name: np.unique(np.round((t - record.t[0]) / record.dt)).astype(int).clip(0, record.N - 1)
        for name, t in taken.items()
    }
    return Flight(record.dt, quiet, values, rows, level, which, start, held)


def _expected(record: Record, rare: BoolArray) -> Record:
    """The record with what it lost in a row as all others let expect it: a line would turn it."""
    lost = np.isnan(record.y) & ~rare
    lost[:, lost.mean(axis=0) > GAPS] = False
    if not any(b - a > BURST for column in lost.T for a, b in runs(column)):
        return record
    return replace(record, y=np.where(lost, filled(record)[0].y, record.y))


def _velocities(values: Mapping[str, Array]) -> dict[str, Array]:
    """Body velocities from speed and flow angles."""
    V, alpha, beta = (values[name] for name in AIR)
    along = V * np.cos(beta)
    return {"u": along * np.cos(alpha), "v": V * np.sin(beta), "w": along * np.sin(alpha)}


def white_noise(x: Array) -> float:
    """Standard deviation of white noise on a smooth signal, from its third differences."""
    # Differences beyond six robust deviations are those of outliers, and left out.
    size = np.abs(np.diff(x, 3))
    limit = FAR * MAD * np.median(size)
    return float(np.sqrt(np.mean(size[size <= limit] ** 2 if limit else size**2) / 20))


def read_later(pieces: Array, skew: float, dt: float) -> tuple[Array, Array]:
    """A channel (4, N - 1) so much later, but within its flight, and its slope, (N,)."""
    # All samples lie alike between those of the channel: slices of it, and no look for pieces.
    last, n = pieces.shape[1], int(np.floor(skew / dt))
    first, end = np.clip([-n, last - n], 0, last + 1)
    found = np.empty((2, last + 1))
    for rows, part, s in (
        (slice(first), pieces[:, :1], 0.0),
        (slice(first, end), pieces[:, first + n : end + n], skew - n * dt),
        (slice(end, None), pieces[:, -1:], dt),
    ):
        a, b, c, d = part
        found[0, rows] = ((a * s + b) * s + c) * s + d
        found[1, rows] = (3 * s * a + 2 * b) * s + c
    return found[0], found[1]
