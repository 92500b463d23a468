"""Which channel has the opposite sign or velocities which unit: what makes all others agree.

A reconstruction finds rates and specific forces that are upside down, as gains about −1. Attitudes
and velocities have no gain there: each is turned in its place, and all is reconstructed anew. What
must have been turned by the fewest mistakes is believed. Reflections do not change kinematics,

    (p, r, φ, ψ, v, ay) → −(p, r, φ, ψ, v, ay),        (q, r, θ, ψ, u, ax) → −(q, r, θ, ψ, u, ax),

so that φ upside down looks like p and r upside down where there are no velocities: of one mistake
and two the one is told, and of two that explain as much both. Velocities of another unit leave
gravity where it is, so that no gains of specific forces make up for it: they are tried likewise.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.channels import ATTITUDES, FORCES, GRAVITY, MEASURES, VELOCITIES
from casid.consistency.attitude_clocks import reconstruct_level
from casid.consistency.flightpath import GAINS
from casid.consistency.innovations import innovations
from casid.consistency.instruments import Instruments
from casid.consistency.measured import Flight
from casid.consistency.remarks import against_gravity, unexplained
from casid.consistency.voting import SIGNIFICANT

LIKELY = 50.0  # by which -2 log likelihood may differ of what explains as much
EXACT = 1e-6  # of a channel's movement: no record is more exact
FLOWN = {"v": "beta", "w": "alpha"}  # what velocities were made of
SPEEDS = {"ft/s": "ft/s", "km/h": "km/h", "knots": "kt"}  # units that velocities may be in
FAR = 0.2  # of one: gains that matter beside what is left


@dataclass(frozen=True, kw_only=True)
class Signs:
    """Channels with the opposite sign, or velocities of another unit."""

    turned: str = ""  # an attitude or velocity
    unit: str = ""  # of velocities, if not m/s
    either: Mapping[str, Sequence[str]] = field(default_factory=dict)  # it or one of the others

    def of(self, name: str) -> str:
        """Which channel has it, where this one seems to."""
        more = self.either.get(name, ())
        return f"it or {' or '.join(more)} has the opposite sign" if more else ""

    def told(self, recorded: Collection[str]) -> tuple[str, ...]:
        """A remark on what was turned."""
        if self.unit:
            what = " ".join(VELOCITIES) if {*VELOCITIES} <= {*recorded} else "V"
            return (
                f"{what}: in {self.unit}, not m/s? Only so do all channels agree; state the unit "
                "where they are read",
            )
        if not self.turned:
            return ()
        every = (self.turned, *self.either.get(self.turned, ()))
        names = [name if name in recorded else FLOWN.get(name, name) for name in every]
        return (
            f"{' or '.join(names)} has the opposite sign: only with it turned do the channels "
            "agree; turn it where it is read",
        )


def reversed_channels(found: Instruments) -> list[str]:
    """Rates and specific forces that surely have the opposite sign."""
    sure = found.unknowns[:, 0] + SIGNIFICANT * found.errors[:, 0] < 0
    return [name for name, one in zip(found.channels, sure, strict=True) if one]


def _misread(found: Instruments) -> int:
    """How many specific forces surely have a gain or bias that no instrument has."""
    of = [i for i, name in enumerate(found.channels) if name in FORCES]
    off = np.abs(np.abs(found.unknowns[of, 0]) - 1) > FAR + SIGNIFICANT * found.errors[of, 0]
    far = np.abs(found.biases[:, of]).max(axis=0) > GRAVITY
    return int((off | far).sum())


@dataclass(frozen=True, eq=False)
class _Guess:
    """What is left where a channel is turned or velocities have another unit, or neither."""

    flights: Sequence[Flight]
    found: Instruments
    turned: str = ""
    unit: str = ""

    def other(
        self, names: Sequence[str], factor: float, equations: Sequence[str], **what: str
    ) -> "_Guess":
        """What is left where some channels are so many times what they were."""
        flights = [
            replace(each, values=each.values | {name: factor * each.values[name] for name in names})
            for each in self.flights
        ]
        return _Guess(flights, reconstruct_level(flights, equations), **what)

    @property
    def reversed(self) -> tuple[str, ...]:
        """All channels that have the opposite sign then."""
        return (*((self.turned,) if self.turned else ()), *reversed_channels(self.found))

    def mistakes(self, names: Collection[str]) -> int:
        """How many mistakes there must have been."""
        gravity = against_gravity(self.flights, {*names})
        return len(self.reversed) + bool(self.unit) + _misread(self.found) + len(gravity)

    def unlikely(self) -> float:
        """Minus twice the logarithm of the likelihood of the innovations left, as recorded."""
        factor = MEASURES["m/s"][SPEEDS[self.unit]] if self.unit else 1.0
        return unlikely(self.found, self.flights, factor)


def unlikely(found: Instruments, flights: Sequence[Flight], factor: float = 1.0) -> float:
    """Minus twice the logarithm of the likelihood of the innovations left, as recorded.

    Velocities are so many times what was recorded.
    """
    total = 0.0
    for each, left in found.left.items():
        n = sum(map(len, left))
        total -= 2 * n * float(np.log(factor)) * (each in VELOCITIES)
        own = [flight.own(each) for flight in flights]
        moves = sum(float(np.sum((x - x.mean()) ** 2)) for x in own)
        sizes = [sum(float(np.sum(innovations(K, x[None]) ** 2)) for x in left) for K in GAINS]
        total += n * float(np.log((min(sizes) + EXACT**2 * moves) / n + 1e-300))
    return total


def set_upright(
    flights: Sequence[Flight],
    equations: Sequence[str],
    names: Collection[str],
    labels: Mapping[int, str],
) -> tuple[Sequence[Flight], Instruments, Signs]:
    """Flights with all signs right, what instruments they ask for, and which signs were not.

    Of rates and forces that are, gains tell. Others are turned only where nothing is left then
    that does not follow (``labels`` of records by number).
    """
    asis = _Guess(flights, reconstruct_level(flights, equations))

    def explains(one: _Guess) -> bool:
        return not (_misread(one.found) or unexplained(one.found, one.flights, labels))

    if not asis.reversed and explains(asis):
        return flights, asis.found, Signs()
    singly = [name for name in (*ATTITUDES, *VELOCITIES) if name in equations]
    guesses = [asis, *(asis.other([name], -1.0, equations, turned=name) for name in singly)]
    if {*VELOCITIES} <= {*equations} and not any(map(explains, guesses)):
        sizes = {words: MEASURES["m/s"][unit] for words, unit in SPEEDS.items()}
        guesses += [asis.other(VELOCITIES, f, equations, unit=u) for u, f in sizes.items()]
    left = [guess.unlikely() for guess in guesses]
    near = [
        guess
        for guess, size in zip(guesses, left, strict=True)
        if size < min(left) + LIKELY
        and not ((guess.turned or guess.unit) and unexplained(guess.found, guess.flights, labels))
    ]
    if not near:
        return flights, asis.found, Signs()
    fewest = min(guess.mistakes(names) for guess in near)
    best, *others = [guess for guess in near if guess.mistakes(names) == fewest]
    also = [each.reversed[0] for each in others if each.reversed]
    either = {best.reversed[0]: also} if best.reversed else {}
    return best.flights, best.found, Signs(turned=best.turned, unit=best.unit, either=either)
