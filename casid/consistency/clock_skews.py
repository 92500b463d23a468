"""Whether attitudes or velocities are late against all else: which one of several clocks is odd.

Rates are compared with attitudes, forces with velocities, and velocities with attitudes. Velocities
that are late make three forces early, attitudes that are make rates early; nobody should move
those, which agree with each other. Rates, forces, attitudes and velocities have a vote each, of
which single rates and forces have their parts, but those that are hardly known. At a draw what
comes first is right: instruments and filters delay, nothing is measured before it happens.

Specific forces follow inputs held from sample to sample at once, velocities integrate them: what
jumps with a sample rises half a sample before it between the two. By how much of that a force is
early is open, by its direct part: none of it is a skew.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.flightpath import LATE
from casid.consistency.instruments import CLOCKS, OWN, Instruments
from casid.consistency.rigid import clock_of, spoiled
from casid.consistency.voting import SKEW, Late, apart, shared, significant

KNOWN = 0.05  # standard error of a scale below which a channel counts as checked
KINDS = dict.fromkeys(RATES, "rates") | dict.fromkeys(FORCES, "specific forces")
KINDS |= dict.fromkeys(ATTITUDES, "attitudes") | dict.fromkeys(VELOCITIES, "velocities")


def known(found: Instruments) -> list[str]:
    """The channels whose scale and skew the records tell, sensors at a limit left out."""
    gain, skew = found.unknowns.T
    told = (found.errors[:, 0] > 0) & (found.errors[:, 0] < KNOWN * np.abs(gain))
    told &= np.abs(skew) < LATE
    names = zip(found.channels, told, strict=True)
    return [name for name, one in names if one and name not in found.limits]


@dataclass(frozen=True, kw_only=True)
class Apart:
    """Attitudes and velocities that are late by themselves.

    And how late each rate and force is once these have moved.
    """

    late: Mapping[str, Late] = field(default_factory=dict)
    against: tuple[str, ...] = ()  # kinds of channels that agree, attitudes by name if some moved
    left: Mapping[str, Late] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """What is late by itself."""
        return tuple(self.late)

    @property
    def shifts(self) -> dict[str, float]:
        """What `Record.shift` brings it into line."""
        return {name: -late for name, (late, _) in self.late.items()}

    def without(self, odd: Collection[str]) -> "Apart":
        """The same of all whose equations need none of those that are odd."""
        kept = {name: one for name, one in self.late.items() if not spoiled(name, odd)}
        return replace(self, late=kept)

    def told(self) -> tuple[str, ...]:
        """A remark on every clock, if there is any."""
        said = []
        for one in dict.fromkeys(self.late.values()):
            (late, error), names = one, [name for name in self.late if self.late[name] == one]
            said.append(
                f"{' '.join(names)} {'are' if len(names) > 1 else 'is'} {abs(late):.3g} ± "
                f"{error:.1g} s {'late' if late > 0 else 'early'} against "
                f"{_all_of(self.against)}: look at filters and time stamps"
            )
        return tuple(said)


def _all_of(kinds: Sequence[str]) -> str:
    *first, last = kinds
    return f"{', '.join(first)} and {last}" if first else last


def stands_apart(found: Instruments, told: Collection[str]) -> Apart:
    """Which of attitudes and velocities is odd, of instruments whose skews are ``told``.

    Attitudes are taken for one source with one clock unless the records say otherwise.
    """
    rows = [i for i, name in enumerate(found.channels) if name in told]
    late, C, references = _clocks(found)
    skews = {
        found.channels[i]: (
            _beyond(float(found.unknowns[i, 1]), _jumps(found, i), 0.0),
            float(found.errors[i, 1]),
        )
        for i in rows
    }
    if len(references) < 2:
        return Apart(left=skews)
    names = [*((name,) for name in skews), *references]
    W = np.zeros((len(names), len(late)))  # against the clock of φ
    W[range(len(rows)), rows] = 1.0
    for k, (name, *_) in enumerate(names):
        owner = _reference(found, name)
        if clock := clock_of(owner):
            W[k, len(found.channels) + CLOCKS.index(clock)] = 1.0
        if owner == found.alone:
            W[k, -1] = 1.0
    late, C = W @ late, W @ C @ W.T
    kinds = [KINDS[name] for name, *_ in names]
    sure = np.sqrt(np.diag(C)) <= SKEW
    voting = [kind for kind, one in zip(kinds, sure, strict=True) if one]
    votes = [one / max(voting.count(kind), 1) for kind, one in zip(kinds, sure, strict=True)]
    groups = shared(late, C, names, votes)
    groups.sort(key=lambda one: (-round(sum(votes[i] for i in one), 6), late[one].mean()))
    right, *others = groups
    moved: dict[str, Late] = {}
    for group in others:
        odd = [i for i in group if i >= len(rows)]
        if odd and significant(*(by := apart(late, C, odd, right))):
            moved |= {name: by for i in odd for name in names[i]}
    split = {KINDS[name] for name in moved}  # of which some stay: by name
    against = dict.fromkeys(
        one for i in right for one in (names[i] if kinds[i] in split else (kinds[i],))
    )
    moving = [k for k, name in enumerate(skews) if _reference(found, name) in moved]
    left = {
        names[k][0]: _beyond_half(
            apart(late, C, [k], [i for i in right if i != k] or [k]), _jumps(found, rows[k])
        )
        for k in moving
    }
    return Apart(late=moved, against=tuple(against), left=skews | left)


def _jumps(found: Instruments, i: int) -> float:
    """From when inputs held in steps let a channel seem late [s]: half a sample before."""
    return -found.held / 2 if found.channels[i] in FORCES else 0.0


def _beyond(late: float, first: float, last: float) -> float:
    """By how much it is later than the last or earlier than the first of two [s]."""
    return late - float(np.clip(late, first, last))


def _beyond_half(late: Late, jumps: float) -> Late:
    """The same of what is late against the middle of them."""
    return _beyond(late[0], jumps / 2, -jumps / 2), late[1]


def _clocks(found: Instruments) -> tuple[Array, Array, list[tuple[str, ...]]]:
    """Skews and clocks, their covariance, and the attitudes and velocities that share one."""
    angles, speeds = (
        tuple(name for name in group if name in found.left and name != found.alone)
        for group in (ATTITUDES, VELOCITIES)
    )
    jumps = np.array([_jumps(found, i) for i in range(len(found.channels))])
    late, C = np.append(found.unknowns[:, 1] - jumps / 2, found.clocks), found.covariance.copy()
    C[range(len(jumps)), range(len(jumps))] += jumps**2 / 12  # anywhere between
    sources = [*([(name,) for name in angles] if found.parted else [angles]), speeds]
    alone = [(found.alone,)] if found.alone else []
    return late, C, [each for each in (*sources, *alone) if each]


def _reference(found: Instruments, name: str) -> str:
    """What a channel is late against, or itself: φ, where what it turns is not recorded."""
    own = OWN.get(name, name)
    return own if own in found.left else "phi"
