"""Whether attitudes or velocities are late against all else: which one of several clocks is odd.

Rates are compared with attitudes, forces with velocities, and velocities with attitudes. Velocities
that are late make three forces early; nobody should move those, which agree with the rates.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.flightpath import LATE
from casid.consistency.instruments import Instruments

SIGNIFICANT = 3.5  # standard errors, of the largest of some twenty
SKEW = 0.01  # s: what matters

KNOWN = 0.05  # standard error of a scale below which a channel counts as checked

Late = tuple[float, float]  # by so much [s], its standard error


def significant(late: float, error: float) -> bool:
    """Whether a delay [s] matters and is no noise."""
    return abs(late) > max(SKEW, SIGNIFICANT * error)


def known(found: Instruments) -> list[str]:
    """The channels whose scale and skew the records tell, sensors at a limit left out."""
    gain, skew = found.unknowns.T
    told = (found.errors[:, 0] > 0) & (found.errors[:, 0] < KNOWN * np.abs(gain))
    told &= np.abs(skew) < LATE
    names = zip(found.channels, told, strict=True)
    return [name for name, one in names if one and name not in found.limits]


@dataclass(frozen=True, kw_only=True)
class Apart:
    """What is late by itself, and how late each rate and force is once that has moved."""

    names: tuple[str, ...] = ()
    late: Late = (0.0, 0.0)
    left: Mapping[str, Late] = field(default_factory=dict)

    @property
    def shifts(self) -> dict[str, float]:
        """What `Record.shift` brings it into line."""
        return dict.fromkeys(self.names, -self.late[0])

    def told(self) -> tuple[str, ...]:
        """A remark, if there is anything."""
        if not self.names:
            return ()
        late, error = self.late
        others = "rates and velocities" if self.names[0] in ATTITUDES else "rates and attitudes"
        return (
            f"{' '.join(self.names)} are {abs(late):.3g} ± {error:.1g} s "
            f"{'late' if late > 0 else 'early'} against {others}: look at filters and time stamps",
        )


def stands_apart(found: Instruments, told: Collection[str]) -> Apart:
    """Which of attitudes and velocities is odd, of instruments whose skews are ``told``."""
    skews = {
        name: (float(found.unknowns[i, 1]), float(found.errors[i, 1]))
        for i, name in enumerate(found.channels)
        if name in told
    }
    late, error = found.clock
    if not {*VELOCITIES} & {*found.left} or not significant(late, error):
        return Apart(left=skews)
    turns = {name: skew for name, skew in skews.items() if name in RATES}
    if turns and all(significant(*s) and _same(s, found.clock) for s in turns.values()):
        ahead, error = mean([*turns.values()])
        left = {name: (s - ahead, e) for name, (s, e) in turns.items()}
        names = tuple(name for name in ATTITUDES if name in found.left)
        return Apart(names=names, late=(-ahead, error), left=skews | left)
    left = {
        name: (skews[name][0] + late, float(found.onboard_errors[found.channels.index(name)]))
        for name in FORCES
        if name in skews
    }
    return Apart(names=VELOCITIES, late=found.clock, left=skews | left)


def _same(one: Late, other: Late) -> bool:
    return not significant(one[0] - other[0], float(np.hypot(one[1], other[1])))


def mean(lates: Sequence[Late]) -> Late:
    """Of several, by their errors."""
    values, errors = np.transpose(lates)
    weights = 1 / np.maximum(errors, 1e-6) ** 2
    return float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)
