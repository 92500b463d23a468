"""How late one signal is after another: the peak of their correlation over lags.

Flight path reconstruction moves by small steps from clocks that nearly agree. Where loggers were
started by hand they may differ by seconds, which would pass there for scales or be named as its
largest skew: these are looked for first, of each attitude against what its rate turns, and of each
velocity against what specific forces, gravity and rates make of it.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.channels import ATTITUDES, RATES, VELOCITIES
from casid.consistency.measured import Flight
from casid.consistency.rigid import NEEDED, terms_of
from casid.repeated_samples import least_step

FARTHEST = 30.0  # s, of clocks
TURN = 0.5  # s: over which turns are compared
ROUNDING = 1e-6  # of the largest size of moves that is none
COARSE = 2.0  # steps in which an attitude is counted that it turns at least
CERTAIN, CLEARLY = 0.95, 0.03  # correlation with another rate than its own, and how much more
COHERENT, MORE = 0.85, 0.1  # correlation of a far lag, and by how much more than a near one's


def correlations(x: Array, y: Array, most: int) -> Array:
    """Correlation of x that many samples later with the middle of y, lags -most to most."""
    inner = y[most : len(y) - most]
    n = len(x) + len(inner)
    across = np.fft.irfft(np.fft.rfft(x, n) * np.fft.rfft(inner, n).conj(), n)[: 2 * most + 1]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    size = np.sqrt(np.sum(inner**2) * (power[len(inner) :] - power[: -len(inner)]).clip(0))
    told = size > ROUNDING * size.max(initial=0.0)  # where x rests it is like nothing
    return np.where(told, across / np.where(told, size, 1.0), 0.0)


def peak(values: Array, k: int) -> float:
    """Where between samples a parabola through three of them has its extreme."""
    a, b, c = values[k - 1 : k + 2]
    return float(k + (a - c) / (2 * (a - 2 * b + c)))


def clocks_apart(
    flights: Sequence[Flight], near: float, labels: Mapping[int, str]
) -> tuple[tuple[str, ...], bool]:
    """Remarks on attitudes and velocities later or earlier than others by more than ``near`` [s].

    Every record that tells of it (``labels`` by number) counts; the last is whether they disagree.
    """
    longest: dict[int, Flight] = {}
    for flight in sorted(flights, key=lambda each: len(each.t)):
        longest[flight.record] = flight
    said, split = [], False
    makes = {angle: f"{rate} turns" for rate, angle in zip(RATES, ATTITUDES, strict=True)}
    makes |= dict.fromkeys(VELOCITIES, "specific forces move")
    for angle, what in makes.items():
        if other := _another(list(longest.values()), angle, near):
            said.append(
                f"{angle} follows what {other} turns rather than what {what}: look at the axes "
                "of both; kinematics unchecked"
            )
            continue
        found = {k: _late(longest[k], angle, near) for k in labels if k in longest}
        told = {labels[k]: one for k, one in found.items() if one is not None}
        far = {name: late for name, (late, _) in told.items() if abs(late) > near}
        if not far:
            continue
        each = ", ".join(f"{name} {late:+.2f} s" for name, (late, _) in told.items())
        if np.ptp([late for late, _ in told.values()]) > near / 2:
            split = True
            said.append(
                f"{angle} comes after what {what} by a different time in each record ({each}): "
                "set the clocks of their loggers record by record (Record.shift, Record.join); "
                "kinematics unchecked"
            )
            continue
        late, alike = map(float, np.mean([*told.values()], axis=0))
        where = "after" if late > 0 else "before"
        said.append(
            f"{angle} comes {abs(late):.2f} s {where} what {what} (correlation "
            f"{alike:.2f}): set the clocks of their loggers first, {-late:+.2f} s for "
            f"{angle} ([channels.join] clock, Record.join); kinematics unchecked"
        )
    return tuple(said), split


def _another(flights: Sequence[Flight], angle: str, near: float) -> str:
    """The rate that an attitude goes with at once, where its own does so at no time; or ""."""
    if angle not in ATTITUDES:
        return ""
    own, votes = RATES[ATTITUDES.index(angle)], set[str]()
    for flight in flights:
        alike = {}
        for name in RATES if angle in flight.values else ():
            found = _correlated(flight, angle, flight.values.get(name), near)
            if found is not None:
                most, reach = (len(found) - 1) // 2, int(near / flight.dt)
                about = found if name == own else found[most - reach : most + reach + 1]
                alike[name] = float(np.abs(about).max())
        best = max(alike, key=alike.__getitem__, default=own)
        if own in alike and alike[best] > CERTAIN:
            votes.add(best if alike[best] > alike[own] + CLEARLY else own)
    return votes.pop() if len(votes) == 1 and own not in votes else ""


def _derivative(flight: Flight, name: str) -> Array | None:
    """What moves an attitude or velocity, of channels that need not be of its clock; if all are."""
    if name in ATTITUDES:
        rate = RATES[ATTITUDES.index(name)]
        return flight.values.get(rate) if name in flight.values else None
    if not NEEDED[name] <= {*flight.values}:
        return None
    factors, rest = terms_of(name, flight)
    return np.asarray(sum((a * flight.values[k] for k, a in factors.items()), rest))


def _late(flight: Flight, angle: str, near: float) -> tuple[float, float] | None:
    """How late one is after what turns or moves it [s], and their correlation, if told."""
    signed = _correlated(flight, angle, _derivative(flight, angle), near)
    if signed is None:
        return None
    most, reach = (len(signed) - 1) // 2, int(near / flight.dt)
    inside = slice(most - reach, most + reach + 1)
    alike = np.abs(signed)
    k, close = int(np.argmax(alike)), alike[inside]
    # Half a period of an oscillation off is no clock, but the other way round.
    if not 0 < k < 2 * most or alike[k] < COHERENT or signed[k] < 0:
        return None
    tops = close[1:-1][(close[1:-1] >= close[:-2]) & (close[1:-1] >= close[2:])]
    late = (peak(alike, k) - most) * flight.dt
    if abs(late) > near and alike[k] < tops.max(initial=0.0) + MORE:
        return None
    return late, float(alike[k])


def _correlated(flight: Flight, angle: str, derivative: Array | None, near: float) -> Array | None:
    """Correlation of an attitude or velocity with what a derivative turns, by lag; or nothing."""
    step = max(1, round(TURN / flight.dt))
    most = int(min(FARTHEST, flight.t[-1] / 4) / flight.dt)
    if derivative is None or most - int(near / flight.dt) < 1:
        return None
    moves = derivative - derivative.mean()
    turned = np.cumsum(moves) - moves / 2
    x, y = (z[step:] - z[:-step] for z in (flight.values[angle], turned))
    if x.std() < COARSE * least_step(flight.values[angle]):
        return None  # it follows its own steps, not what the rate turns
    return correlations(x - x.mean(), y - y.mean(), most)
