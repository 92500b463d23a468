"""Clocks that drift: one runs slow or fast against another, so that a delay grows over a record.

A channel that drifts is late by skew + drift·t, t from the start of each record; the drift is one
for all records. How fast each skew grows beside all else is told by what a reconstruction leaves
(`casid.consistency.flightpath`), against the clock of attitudes. The clock that most channels share
is taken for right; the others are set right, and all is reconstructed anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
import scipy

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.apart import SKEW, Late, known, significant
from casid.consistency.flightpath import reconstruct_level
from casid.consistency.instruments import OWN, Instruments
from casid.consistency.measured import Flight, read_later

ROUNDS = 3  # of setting clocks right


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
                f"{self.duration:.3g} s: set their clock right (Record.shift, drift {-late:.3g}); "
                "skews told are those at the start of records"
            )
        return tuple(said)


def without_drifts(
    flights: Sequence[Flight], equations: Sequence[str]
) -> tuple[list[Flight], Instruments, Drifts]:
    """Flights with all clocks set right, what was found of them, and the drifts they had."""
    set_right, found = [*flights], reconstruct_level(flights, equations)
    drifts = Drifts(duration=max(each.start + float(each.t[-1]) for each in flights))
    for _ in range(ROUNDS):
        if not (more := _drifts(found, equations, drifts.duration)):
            break
        before = {name: drifts.late.get(name, (0.0, 0.0))[0] for name in more}
        grown = {name: (before[name] + late, error) for name, (late, error) in more.items()}
        drifts = replace(drifts, late={**drifts.late, **grown})
        set_right = [_at_once(each, drifts.remedy) for each in flights]
        found = _less_certain(reconstruct_level(set_right, equations), drifts, set_right)
    return set_right, found, drifts


def _less_certain(found: Instruments, drifts: Drifts, flights: Sequence[Flight]) -> Instruments:
    """With skews at the start of records as uncertain as what drifts until their middle is."""
    middle = float(np.mean([each.start + each.t[-1] / 2 for each in flights]))
    off = {name: middle * error for name, (_, error) in drifts.late.items()}
    by = [np.hypot(off.get(name, 0.0), off.get(OWN[name], 0.0)) for name in found.channels]
    onboard = [np.hypot(off.get(name, 0.0), off.get("phi", 0.0)) for name in found.channels]
    clock = np.hypot(off.get("u", 0.0), off.get("phi", 0.0))
    return replace(
        found,
        errors=np.hypot(found.errors, np.array([[0.0, each] for each in by])),
        onboard_errors=np.hypot(found.onboard_errors, onboard),
        clock=(found.clock[0], float(np.hypot(found.clock[1], clock))),
    )


def _at_once(flight: Flight, drift: Mapping[str, float]) -> Flight:
    """The flight, channels moved by a drift [s/s] from the start of its record."""
    t, values = flight.t, dict(flight.values)
    for name in {*drift} & {*values}:
        pieces = scipy.interpolate.CubicSpline(t, values[name]).c
        values[name], _ = read_later(pieces, -drift[name] * (flight.start + t), flight.dt)
    return replace(flight, values=values)


def _drifts(found: Instruments, equations: Sequence[str], duration: float) -> dict[str, Late]:
    """Clocks that drift by what matters and is no noise, as later against the one of most."""
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
    late, spread = W @ np.where(told, value, 0.0), W @ np.where(told[:, None], scatter, 0.0)
    C = spread @ spread.T  # s^2
    odd: dict[str, Late] = {}
    right, *others = shared(late, C, [names for names, _ in clocks])
    for group in others:
        apart, error = _apart(late, C, group, right)
        if significant(apart, error):
            names = [name for i in group for name in clocks[i][0]]
            odd |= dict.fromkeys(names, (apart / duration, error / duration))
    return odd


def shared(late: Array, C: Array, names: Sequence[tuple[str, ...]]) -> list[list[int]]:
    """Which of them agree: those of most channels first, at a draw the first of them.

    They have ``names``, and are ``late`` (n,) with the covariance ``C`` (n, n). Those of which too
    little is told for a vote go with their kind, or with most, unless they are apart from all.
    """

    def order(one: Sequence[int]) -> tuple[int, int]:
        return -sum(len(names[i]) for i in one), one[0]

    sure = np.sqrt(np.diag(C)) <= SKEW
    rest, found = [*map(int, np.flatnonzero(sure))], []
    while rest:
        sets = [[*each] for n in range(len(rest), 0, -1) for each in combinations(rest, n)]
        sets.sort(key=order)
        found.append(next(one for one in sets if _agree(late, C, names, one)))
        rest = [i for i in rest if i not in found[-1]]
    for i in map(int, np.flatnonzero(~sure)):
        near = [group for group in found if not significant(*_apart(late, C, [i], group))]
        if near:
            near.sort(key=lambda one: (-sum(_alike(names[i], names[j]) for j in one), *order(one)))
            near[0].append(i)
        else:
            found.append([i])
    return sorted(map(sorted, found), key=order)


def _alike(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether both are rates, or specific forces."""
    return any({*one, *other} <= {*kind} for kind in (RATES, FORCES))


def _agree(late: Array, C: Array, names: Sequence[tuple[str, ...]], among: Sequence[int]) -> bool:
    """Whether neither one nor all rates or all forces among them are apart from the rest."""
    kinds = [[j for j in among if _alike(names[i], names[j])] for i in among]
    for part in (*([i] for i in among), *kinds):
        others = [i for i in among if i not in part]
        if part and others and significant(*_apart(late, C, part, others)):
            return False
    return True


def _apart(late: Array, C: Array, one: Sequence[int], other: Sequence[int]) -> Late:
    """How much later one clock is than another [s], by generalised least squares, and its error."""
    both = [*one, *other]
    # With a third of what matters of each by itself, so that nothing is known too well.
    P = np.linalg.inv(C[np.ix_(both, both)] + (SKEW / 3) ** 2 * np.eye(len(both)))
    X = np.column_stack([np.ones(len(both)), np.arange(len(both)) < len(one)])
    weights = np.linalg.solve(X.T @ P @ X, X.T @ P)[1]
    return float(weights @ late[both]), float(np.sqrt(weights @ C[np.ix_(both, both)] @ weights))
