"""Kinematics of a rigid body: what rates and specific forces make of attitudes and velocities."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, GRAVITY, RATES, VELOCITIES
from casid.consistency.instruments import CLOCKS, OWN
from casid.consistency.measured import Flight, read_later

TURNED = ("phi", "theta")  # attitudes that stand in products
NEEDED = {  # channels without which an equation means nothing
    "phi": {"phi", "p"},
    "theta": {"theta", "q"},
    "psi": {"psi", *RATES, "phi", "theta"},
    **{name: {*VELOCITIES, *FORCES, *RATES, "phi", "theta"} for name in VELOCITIES},
}
WHOLE = NEEDED | {  # without which something is missing in it
    "phi": {"phi", "theta", *RATES},
    "theta": {"phi", "theta", "q", "r"},
}

Moved = Mapping[str, tuple[Array, Array]]  # channels and their slopes
Values = Mapping[str, Array]
Terms = tuple[dict[str, Array], Array]  # factors of rates and forces, the rest


def spoiled(equation: str, odd: Collection[str]) -> bool:
    """Whether an equation needs one of the attitudes and velocities that are odd."""
    return not NEEDED[equation].isdisjoint(odd)


def terms_of(equation: str, flight: Flight, turned: Mapping[str, Array] | None = None) -> Terms:
    """Factor of each rate and force in the derivative of an attitude or velocity; the rest.

    ``turned`` are attitudes and velocities that stand in for the flight's own.
    """
    n = len(flight.values[equation])
    zero, one = np.zeros(n), np.ones(n)
    known = flight.values if turned is None else turned
    phi, theta = (known.get(name, zero + flight.level.get(name, 0.0)) for name in TURNED)
    s, c, tan = np.sin(phi), np.cos(phi), np.tan(theta)
    if equation == "phi":
        return {"p": one, "q": s * tan, "r": c * tan}, zero
    if equation == "theta":
        return {"q": c, "r": -s}, zero
    if equation == "psi":
        return {"q": s / np.cos(theta), "r": c / np.cos(theta)}, zero
    u, v, w = (known.get(name, flight.values[name]) for name in VELOCITIES)
    return {
        "u": ({"ax": one, "r": v, "q": -w}, -GRAVITY * np.sin(theta)),
        "v": ({"ay": one, "p": w, "r": -u}, GRAVITY * np.cos(theta) * s),
        "w": ({"az": one, "q": u, "p": -v}, GRAVITY * np.cos(theta) * c),
    }[equation]


def tilted(equation: str, known: Values) -> dict[str, Array]:
    """Slopes of the derivative of an attitude or velocity by attitudes and velocities in it.

    ``known`` are φ and θ, and those channels of the equation that are there.
    """
    phi, theta = (known[name] for name in TURNED)
    s, c, sin, cos = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    p, q, r = (known.get(name, np.zeros(len(phi))) for name in RATES)
    if equation in ATTITUDES:
        turn, off = q * s + r * c, q * c - r * s
        return {
            "phi": {"phi": off * sin / cos, "theta": turn / cos**2},
            "theta": {"phi": -turn},
            "psi": {"phi": off / cos, "theta": turn * sin / cos**2},
        }[equation]
    return {
        "u": {"theta": -GRAVITY * cos, "v": r, "w": -q},
        "v": {"phi": GRAVITY * cos * c, "theta": -GRAVITY * sin * s, "w": p, "u": -r},
        "w": {"phi": -GRAVITY * cos * s, "theta": -GRAVITY * sin * c, "u": q, "v": -p},
    }[equation]


def lever_of(moved: Moved) -> Array:
    """L of a_s − a = L r, (3, N, 3), for r from the centre of gravity."""
    (p, dp), (q, dq), (r, dr) = (moved[name] for name in RATES)
    rows = [
        [-(q**2 + r**2), p * q - dr, p * r + dq],
        [p * q + dr, -(p**2 + r**2), q * r - dp],
        [p * r - dq, q * r + dp, -(p**2 + q**2)],
    ]
    return np.moveaxis(np.array(rows), 1, 2)


@dataclass(frozen=True, eq=False)
class Sides:
    """Right-hand sides of kinematic equations, every term at the time of the left-hand side.

    A channel is late by its skew against what it turns or moves, which is late by its own clock:
    where an equation is of another clock, it is read at skew + clock − the equation's clock. Clocks
    that are known of this flight alone come on top.
    """

    flight: Flight
    pieces: Mapping[str, Array]  # splines of rates, forces and what stands in products
    table: Mapping[str, Array]  # gain, bias and skew of rates and forces
    equations: Collection[str]
    clocks: Array  # (3,) of `CLOCKS`, later than φ [s]; last, how late the one is that is alone
    place: Array  # (3,) of the accelerometers [m]
    alone: str = ""  # an attitude or velocity with a clock of its own
    knots: Array = field(default_factory=lambda: np.zeros(0))  # tan θ if it is not known
    apart: float = 1.0  # from one to the next [s]
    _at: dict[float, tuple[Moved, Moved, Moved, Values]] = field(default_factory=dict)

    def of(self, equation: str) -> tuple[list[Array], Array]:
        """Slopes by gain, bias, skew of its channels, by clocks, place, knots; the side (N,)."""
        clock = self._clock(equation)
        moved, turned, true, known = self._seen(clock)
        factors, _ = terms_of(equation, self.flight, known)
        slopes, later = [], {}
        for name in (each for each in self.table if each in factors):
            later[name] = factors[name] * true[name][1]
            slopes += [factors[name] * moved[name][0], -factors[name], later[name]]
        tilts = tilted(equation, known)
        later |= {name: tilts[name] * rate for name, (_, rate) in turned.items() if name in tilts}
        slopes += [self._later(equation, clock, later) for clock in CLOCKS]
        if self.alone:
            slopes.append(self._alone_later(equation, later))
        f = self._sum(equation, known)
        if equation in VELOCITIES:
            arms = -lever_of(true)[VELOCITIES.index(equation)]
            return [*slopes, *arms.T], f + arms @ self.place
        if equation == "phi":  # by tan θ, in which it is linear
            slopes += [*(tilts["theta"] * np.cos(known["theta"]) ** 2 * self._hats())]
        return slopes, f

    def coupling(self, equation: str) -> Array:
        """What the side of an attitude has beyond φ' = p, θ' = q, ψ' = r, (N,)."""
        *_, known = self._seen(self._clock(equation))
        level = dict.fromkeys(TURNED, np.zeros(len(self.flight.t)))
        return self._sum(equation, known) - self._sum(equation, {**known, **level})

    def _seen(self, clock: float) -> tuple[Moved, Moved, Moved, Values]:
        """Channels at the instants of a clock, all that share it at once.

        Rates and forces with their slopes; so attitudes and velocities that stand in products;
        rates and forces without gain and bias; and all of them.
        """
        if clock not in self._at:
            moved, turned = self._moved(clock), self._turned(clock)
            true = self._true(moved)
            level = np.zeros(len(self.flight.t))
            tilt = {name: level + self.flight.level.get(name, 0.0) for name in TURNED}
            if self.flight.tilts:
                tilt["theta"] = np.arctan(self.knots @ self._hats())
            now = {name: x for name, (x, _) in (true | turned).items()}
            self._at[clock] = moved, turned, true, tilt | self.flight.values | now
        return self._at[clock]

    def _hats(self) -> Array:
        """What each knot has of every instant, (knots, N): none where θ is known."""
        at = (self.flight.start + self.flight.t) / self.apart
        off = np.abs(at - np.arange(len(self.knots))[:, None])
        return np.asarray(np.maximum(0.0, 1.0 - off) * self.flight.tilts)

    def _moved(self, clock: float) -> dict[str, tuple[Array, Array]]:
        """Rates and forces at the instants of a clock."""
        return {
            name: self._read(name, skew + self._late(name) + self._clock(self._owner(name)) - clock)
            for name, (_, _, skew) in self.table.items()
        }

    def _turned(self, clock: float) -> dict[str, tuple[Array, Array]]:
        """Attitudes likewise."""
        return {
            name: self._read(name, self._clock(name) - clock)
            for name in self.pieces
            if name not in self.table
        }

    def _true(self, moved: Moved) -> dict[str, tuple[Array, Array]]:
        """Rates and forces without gain and bias."""
        return {
            name: (gain * moved[name][0] - bias, gain * moved[name][1])
            for name, (gain, bias, _) in self.table.items()
        }

    def _sum(self, equation: str, known: Values) -> Array:
        factors, f = terms_of(equation, self.flight, known)
        return sum((a * known[name] for name, a in factors.items() if name in known), f)

    def _later(self, equation: str, clock: str, later: Mapping[str, Array]) -> Array:
        """Slope by a clock: what it delays is read later, in its own equations all is earlier."""
        own = [x for name, x in later.items() if clock_of(self._owner(name)) == clock]
        all_of_it = later.values() if clock_of(equation) == clock else ()
        return np.zeros(len(self.flight.t)) + sum(own) - sum(all_of_it)

    def _alone_later(self, equation: str, later: Mapping[str, Array]) -> Array:
        """Likewise by the clock of the one that has its own."""
        own = [x for name, x in later.items() if self._owner(name) == self.alone]
        all_of_it = later.values() if equation == self.alone else ()
        return np.zeros(len(self.flight.t)) + sum(own) - sum(all_of_it)

    def _owner(self, name: str) -> str:
        """Against what a channel is late: φ, where what it turns is not recorded."""
        owner = OWN.get(name, name)
        return owner if owner in self.equations else "phi"

    def _clock(self, name: str) -> float:
        mate = name if name in self.equations else "phi"
        of, own = clock_of(mate), float(self.clocks[-1]) if mate == self.alone else 0.0
        shared = float(self.clocks[CLOCKS.index(of)]) if of else 0.0
        return own + shared + self._late(mate)

    def _late(self, name: str) -> float:
        """How late it is known to be in this flight alone."""
        return self.flight.late.get(name, 0.0)

    def _read(self, name: str, later: float) -> tuple[Array, Array]:
        return read_later(self.pieces[name], later, self.flight.dt)


def clock_of(name: str) -> str:
    """Which of `CLOCKS` an attitude or velocity has; none if that of φ."""
    return "velocities" if name in VELOCITIES else name if name in CLOCKS else ""
