"""Clocks that drift: one runs slow or fast against another, so that a delay grows over a record.

A channel that drifts is late by skew + drift·t, t from the start of each record; the drift is one
for all records. How fast each skew grows beside all else is told by what a reconstruction leaves
(`casid.consistency.flightpath`), against the clock of attitudes. The clock that most channels share
is taken for right; the others are set right, and all is reconstructed anew.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, VELOCITIES
from casid.consistency.attitude_clocks import reconstruct_level
from casid.consistency.clock_skews import known
from casid.consistency.instruments import OWN, Instruments
from casid.consistency.measured import Flight
from casid.consistency.voting import SKEW, Late, apart, shared

ROUNDS = 8  # of setting clocks right
MAYBE, SURE = 2.5, 4.5  # standard errors of a drift that is tried, that is told
RESTS = 0.25  # share of what matters that a drift set right may leave


@dataclass(frozen=True, kw_only=True)
class Drifts:
    """Channels that are later by so much every second [s/s], with its standard error."""

    late: Mapping[str, Late] = field(default_factory=dict)
    duration: float = 0.0  # of the longest record [s]

    @property
    def remedy(self) -> dict[str, float]:
        """What `Record.shift` takes as ``drift`` [s/s]."""
        return {name: -late for name, (late, _) in self.late.items()}

    def told(self) -> tuple[str, ...]:
        """Remarks, one a clock."""
        said = []
        for one in dict.fromkeys(self.late.values()):
            late, error = one
            names = [name for name, each in self.late.items() if each == one]
            others = OWN.get(names[0], "the rates") if len(names) == 1 else "the others"
            said.append(
                f"{' '.join(names)} drift{'s' * (len(names) == 1)} against {others}, "
                f"{'later' if late > 0 else 'earlier'} by {1e6 * abs(late):.4g} ± "
                f"{1e6 * error:.2g} ppm, {1e3 * abs(late) * self.duration:.2g} ms within "
                f"{self.duration:.3g} s: set their clock right (Record.shift, drift "
                f"{-late:.3g}); the skews given are those at the start of records"
            )
        return tuple(said)


def without_drifts(
    flights: Sequence[Flight], equations: Sequence[str], found: Instruments
) -> tuple[list[Flight], Instruments, Drifts]:
    """Flights with all clocks set right, what was found of them, and the drifts they had.

    ``found`` are the instruments that the flights ask for as they are. By them, far from the truth,
    drifts are tried that may be none; told are those which are sure once clocks are set right.
    """
    drifts = Drifts(duration=max(each.start + float(each.t[-1]) for each in flights))
    tried, now = drifts, found
    for _ in range(ROUNDS):
        clocks = _Clocks(now, equations, drifts.duration)
        if not (more := clocks.drifting(tried.late)):
            break
        before = {name: tried.late.get(name, (0.0, 0.0))[0] for name in more}
        grown = {name: (before[name] + later, np.nan) for name, later in more.items()}
        tried = replace(tried, late={**tried.late, **grown})
        now = reconstruct_level([_at_once(each, tried.remedy) for each in flights], equations)
    sure = _Clocks(now, equations, drifts.duration).sure(tried)
    if not sure.late:
        return [*flights], found, drifts
    set_right = [_at_once(each, sure.remedy) for each in flights]
    if sure.late.keys() != tried.late.keys():
        now = reconstruct_level(set_right, equations)
    return set_right, _less_certain(now, sure, set_right), sure


def _less_certain(found: Instruments, drifts: Drifts, flights: Sequence[Flight]) -> Instruments:
    """With skews at the start of records as uncertain as what drifts until their middle is."""
    middle = float(np.mean([each.start + each.t[-1] / 2 for each in flights]))
    off = []  # of all skews and of the velocities' clock, by each clock that drifts
    for one in dict.fromkeys(drifts.late.values()):
        names = {name for name, each in drifts.late.items() if each == one}
        pairs = [*((name, OWN[name]) for name in found.channels)]
        pairs += [(one, "phi") for one in ("theta", "psi", "u")]
        off.append([middle * one[1] * ((a in names) - (b in names)) for a, b in pairs])
    by = np.linalg.norm(off, axis=0)
    return replace(
        found,
        errors=np.hypot(
            found.errors, np.array([[0.0, each] for each in by[: len(found.channels)]])
        ),
        covariance=found.covariance + np.transpose(off) @ off,
    )


def _at_once(flight: Flight, drift: Mapping[str, float]) -> Flight:
    """The flight, channels moved by a drift [s/s] from the start of its record."""
    t, values = flight.t, dict(flight.values)
    for name in {*drift} & {*values}:
        moved = t - drift[name] * (flight.start + t)
        values[name] = scipy.interpolate.CubicSpline(t, values[name])(moved.clip(t[0], t[-1]))
    return replace(flight, values=values)


class _Clocks:
    """How much later each clock is at the end of the longest record than at its start [s]."""

    def __init__(self, found: Instruments, equations: Sequence[str], duration: float) -> None:
        value, scatter = found.drifts
        velocities = [name for name in equations if name in VELOCITIES]
        told = np.asarray(np.isfinite(scatter).all(axis=1))
        clocks: list[tuple[tuple[str, ...], Array]] = []  # names; weights of the coefficients
        for i, name in enumerate(found.channels):
            if name in known(found) and told[i] and (told[-1] or name not in FORCES):
                own = np.zeros(len(value))
                own[i], own[-1] = 1.0, name in FORCES  # these against velocities, those as below
                clocks.append(((name,), own))
        if velocities and told[-1]:
            clocks.append((tuple(velocities), np.eye(len(value))[-1]))
        turned = tuple(name for name in equations if name in ATTITUDES)
        clocks.append((turned, np.zeros(len(value))))
        W = duration * np.array([own for _, own in clocks]) * told
        spread = W @ np.where(told[:, None], scatter, 0.0)
        self.duration, self.names = duration, [names for names, _ in clocks]
        self.late, self.covariance = W @ np.where(told, value, 0.0), spread @ spread.T

    def drifting(self, tried: Mapping[str, Late]) -> dict[str, float]:
        """Clocks that drift or, where ``tried``, do so still, by [s/s] against that of most."""
        odd: dict[str, float] = {}
        for own, right in self._moved(tried):
            later, _ = apart(self.late, self.covariance, own, right)
            if abs(later) > RESTS * SKEW:
                odd |= dict.fromkeys(self._named(own), later / self.duration)
        if odd:
            return odd
        most, *others = shared(self.late, self.covariance, self.names, [*map(len, self.names)])
        for group in others:
            later, error = apart(self.late, self.covariance, group, most)
            if not {*self._named(group)} <= {*tried} and abs(later) > max(SKEW, MAYBE * error):
                odd |= dict.fromkeys(self._named(group), later / self.duration)
        return odd

    def sure(self, tried: Drifts) -> Drifts:
        """Those of the drifts tried that matter and are no noise, with their errors here.

        Errors of few stretches are rough: the more so, the less is known for what matters.
        """
        told: dict[str, Late] = {}
        for own, right in self._moved(tried.late):
            names = self._named(own)
            by, (_, error) = tried.late[names[0]][0], apart(self.late, self.covariance, own, right)
            if abs(by) * self.duration > max(SKEW, SURE * error * max(1.0, error / SKEW)):
                told |= dict.fromkeys(names, (by, error / self.duration))
        return replace(tried, late=told)

    def _moved(self, tried: Mapping[str, Late]) -> Iterator[tuple[list[int], list[int]]]:
        """Clocks that were set right alike, and those that were not."""
        right = [i for i, names in enumerate(self.names) if not {*names} & {*tried}]
        for by in dict.fromkeys(late for late, _ in tried.values()):
            alike = {name for name, (late, _) in tried.items() if late == by}
            own = [i for i, names in enumerate(self.names) if {*names} <= alike]
            if own and right:
                yield own, right

    def _named(self, group: Sequence[int]) -> list[str]:
        return [name for i in group for name in self.names[i]]
