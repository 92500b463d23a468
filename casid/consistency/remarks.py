"""Remarks on flights that belong to no single comparison, and the mistake a factor betrays."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, GRAVITY, RATES, VELOCITIES
from casid.consistency.instruments import OWN, Instruments
from casid.consistency.measured import Flight, white_noise
from casid.consistency.random_walks import walked
from casid.consistency.voting import SIGNIFICANT
from casid.display import listed
from casid.record import REST
from casid.samples import root_mean_square

ROUGH = 0.1  # the scale that matters where an equation lacks a channel
ALIKE = 0.2  # how near a factor is to that of a mistake
MUCH = 0.3  # share of an attitude's movement left unexplained that matters
LITTLE = 0.5  # of the movement of all records: what moves less is measured by that
BEYOND = 10.0  # times its movement: a channel that rests
TWICE = 2.0  # times the roll rate: what a bank that turns with it may change by
FASTEST = 10.0  # rad/s of a roll: larger ones are degrees
LEAN = 0.03  # of gravity, that tells the sign of a specific force in trim
ROUNDING = 1e-9  # of a level, by which what stands still may move
AWAY = 0.2  # m: an accelerometer's place that matters
SEEN = 0.5  # m: the largest error of it

COUNTED = "time seems to count in {0} but be read as s: state its unit, {0}"
FACTORS = {
    "it has the opposite sign": -1.0,
    "it seems to be in degrees, or its reference in radians though called degrees": 180 / np.pi,
    "its reference seems to be in degrees": np.pi / 180,
    COUNTED.format("ms"): 1e3,
    COUNTED.format("us"): 1e6,
}
OF_LENGTHS = {  # which no angle and no rate can have
    "it seems to be in g": 1 / GRAVITY,
    "it seems to be in feet": 1 / 0.3048,
    "its reference seems to be in feet": 0.3048,
}


def dead_channels(flights: Sequence[Flight], names: set[str]) -> dict[str, str]:
    """Remarks, by channel, on what never moves while its mate in a kinematic equation does."""
    said = {}
    for one, other in [pair for pair in OWN.items() if {*pair} <= names]:
        for name, mate in ((one, other), (other, one)):
            moves = any(
                np.var(flight.values[mate]) > 4 * white_noise(flight.values[mate]) ** 2
                for flight in flights
            )
            own = [flight.values[name] for flight in flights]
            if moves and all(np.ptp(x) <= ROUNDING * np.abs(x).max() for x in own):
                said[name] = (
                    f"{name} stands still at {own[0][0]:.3g} while {mate} moves: a dead sensor, or "
                    "a column that was never filled; leave it out"
                )
    return said


def turned(flights: Sequence[Flight], names: set[str]) -> tuple[str, ...]:
    """Remarks on attitudes that are no radians."""
    said = []
    for name, limit in (("phi", np.pi), ("theta", np.pi / 2)):
        if name not in names:
            continue
        largest = max(np.abs(flight.values[name]).max() for flight in flights)
        if largest > limit and not (name == "phi" and _rolls(flights)):
            said.append(f"{name} reaches {largest:.3g} rad: is it in degrees? Kinematics unchecked")
    return tuple(said)


def _rolls(flights: Sequence[Flight]) -> bool:
    """Whether banks beyond half a turn are those of a roll, which the roll rate has flown."""
    if not all("p" in flight.values for flight in flights):
        return False
    p = np.concatenate([flight.values["p"] for flight in flights])
    turns = np.concatenate([np.gradient(flight.values["phi"], flight.dt) for flight in flights])
    flown, turned_by = root_mean_square(p), root_mean_square(turns)
    alike = flown / TWICE < turned_by < TWICE * flown
    return bool(alike and np.abs(p).max() < FASTEST)


def mistake(factor: float, channel: str) -> str:
    """The mistake that a factor betrays, if any that this channel can have."""
    turns = channel in RATES + ATTITUDES
    known = FACTORS if turns else FACTORS | OF_LENGTHS
    return next((why for why, each in known.items() if abs(factor / each - 1) < ALIKE), "")


def unexplained(
    solution: Instruments, flights: Sequence[Flight], labels: Mapping[int, str]
) -> dict[str, str]:
    """Remarks on attitudes and velocities that no scale, bias and skew brings into line, by name.

    Record by record (``labels`` by number): of many a sensor is frozen in one, which spoils the
    scale in all. A record in which little moves is measured by half of what moves in the others.
    """
    said, of = dict[str, str](), np.array([flight.record for flight in flights])
    limited = {OWN[name] for name in solution.limits}
    for each, left in solution.left.items():
        if each in limited:  # which is told as such
            continue
        powers = np.array(
            [
                (
                    white_noise(e) ** 2,
                    np.mean(e**2) - walked(each, e, flight, solution),
                    np.var(flight.values[each]),
                )
                for e, flight in zip(left, flights, strict=True)
            ]
        )
        white, rest, moves = np.array([powers[of == k].mean(axis=0) for k in labels]).T
        rest, moves = rest - white, np.maximum(moves - white, 1e-300)
        moves = np.maximum(moves, LITTLE**2 * moves.mean())
        lost = rest > np.maximum(MUCH**2 * moves, 4 * white)
        if lost.any():
            with np.errstate(over="ignore", invalid="ignore"):  # beyond all numbers, maybe both
                share = np.nan_to_num(np.sqrt(rest.clip(0) / moves), nan=np.inf)
            most = share.max()
            much = f"{most:.0%} of its movement is left" if most < BEYOND else "it hardly moves"
            names = [
                name for name, one in zip(labels.values(), share, strict=True) if one > most / 2
            ]
            said[each] = (
                f"{each} does not follow from the other channels{in_some(names, labels)}: {much}; "
                "look at the signs, units and axes of all"
            )
    return said


def in_some(names: Sequence[str], records: Collection[object]) -> str:
    """Which of the records, in words; empty if all."""
    return f" in {listed(names)}" if len(names) < len(records) else ""


def seen_place(solution: Instruments) -> tuple[Array, Array]:
    """Place of the accelerometers and its errors, (3,) each [m], NaN where it is not told."""
    seen = solution.place_errors < SEEN
    place, errors = solution.place, solution.place_errors
    return np.where(seen, place, np.nan), np.where(seen, errors, np.nan)


def misplaced(place: Array, errors: Array) -> tuple[str, ...]:
    """Remark on accelerometers that are not where velocities are measured."""
    if not (np.abs(place) > np.maximum(AWAY, SIGNIFICANT * errors)).any():
        return ()
    axes = zip(place, errors, ("forward", "right", "down"), strict=True)
    where = ", ".join(f"{r:.2f} ± {e:.1g} m {axis}" for r, e, axis in axes if np.isfinite(r))
    return (
        f"ax ay az look like accelerometers {where} of where velocities are measured: move them "
        "to the centre of gravity, or give the structure their place",
    )


def against_gravity(flights: Sequence[Flight], names: set[str]) -> tuple[str, ...]:
    """Remarks on a specific force that in trim is far from what gravity asks for."""
    if not {*FORCES, "phi", "theta"} <= names or {*VELOCITIES} <= names:
        return ()
    said = []
    # Without a quiet stretch the mean of all of it: what the aircraft was flown about.
    ends = [each.quiet if each.quiet * each.dt >= REST else None for each in flights]
    heads = [
        [flight.values[name][:end].mean() for flight, end in zip(flights, ends, strict=True)]
        for name in (*FORCES, "phi", "theta")
    ]
    f, (phi, theta) = np.median(heads[:3], axis=1), np.median(heads[3:], axis=1)
    down = np.cos(theta) * np.array([0.0, np.sin(phi), np.cos(phi)])
    wanted = GRAVITY * (np.array([np.sin(theta), 0.0, 0.0]) - down)
    rests = all(end is not None for end in ends)
    for name, found, due in zip(FORCES, f, wanted, strict=True):
        leans = rests and abs(due) > LEAN * GRAVITY and abs(found / due + 1) < ALIKE
        if abs(found - due) <= ROUGH * GRAVITY and not leans:
            continue
        why = (
            mistake(float(found / due), name) if due else ""
        ) or "look at its sign, unit and bias"
        said.append(
            f"{name} is {found:.3g} m/s^2 in trim, but gravity would make it {due:.3g}: {why}"
        )
    return tuple(said)
