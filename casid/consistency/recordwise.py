"""Whether the clocks of two loggers differ from record to record, as where one is started anew.

Skews are one for all records; where they are not, what is found is the skew of none, and what it
leaves passes for scales.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from casid.arrays import Array
from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.consistency.attitude_clocks import reconstruct_level
from casid.consistency.clock_skews import known
from casid.consistency.flightpath import reconstruct
from casid.consistency.instruments import Instruments
from casid.consistency.measured import Flight
from casid.consistency.remarks import unexplained
from casid.consistency.signs import unlikely
from casid.consistency.voting import SKEW, mean

LEVEL = 1e-4  # at which skews of records are called different
SUSPECT = 0.05  # at which they are looked at one by one
EXPLAINS = 25.0  # by which -2 log likelihood is less once they are set, at least
FACTOR = 1.1  # by which an attitude or all velocities are tried to be scaled
PAIRS = {  # what is late against what
    ("rates", RATES): ("attitudes", ATTITUDES),
    ("specific forces", FORCES): ("velocities", VELOCITIES),
}


def clocks_by_record(
    flights: Sequence[Flight],
    equations: Sequence[str],
    together: Instruments,
    labels: Mapping[int, str],
) -> tuple[str, ...]:
    """Remarks on clocks that differ by record (``labels`` by number), found by each alone.

    Records are looked at one by one only where they draw the skews found ``together`` apart, by
    half of what matters and more than the least errors these can have (a score test). Whichever of
    two groups leaves less, once its clocks are set as found, is late; it is believed if all records
    together leave less so, and none would with one attitude or all velocities of another scale.
    """
    if not drawn_apart(together):
        return ()
    alone = {}
    for k in labels:
        own = [flight for flight in flights if flight.record == k]
        found = reconstruct_level(own, equations)
        if not unexplained(found, own, {k: labels[k]}):
            alone[k] = found
    said, asis = [], unlikely(together, flights)
    for ours, theirs in PAIRS.items():
        (words, group), (others, mates) = ours, theirs
        skews = {k: late[0] for k, one in alone.items() if (late := _of(one, group)) is not None}
        # Channels whose skews differ weigh otherwise in each record: from their own they count.
        off = [late for one in alone.values() if (late := _of(one, group, together)) is not None]
        if len(off) < 2 or not differ(*np.transpose(off)):
            continue
        middle = float(np.mean([*skews.values()]))
        own = [_known(each, group, skews.get(each.record, middle)) for each in flights]
        other = [_known(each, mates, -skews.get(each.record, middle)) for each in own]
        left = [unlikely(reconstruct_level(each, equations), each) for each in (own, other)]
        explained = asis - min(left)
        if explained < EXPLAINS or explained < rescaled(flights, equations):
            continue
        turned = left[1] < left[0] - EXPLAINS
        each = ", ".join(
            f"{labels[k]} {-late if turned else late:+.3g}" for k, late in skews.items()
        )
        said.append(
            f"the clocks of {words} and {others} differ by record: {others if turned else words} "
            f"are late by {each} s; set them record by record (Record.shift, Record.join); "
            "kinematics unchecked"
        )
    return tuple(said)


def _known(flight: Flight, group: Collection[str], late: float) -> Flight:
    """The flight of which it is known that a group is so late."""
    return replace(flight, late=flight.late | dict.fromkeys(group, late))


def rescaled(flights: Sequence[Flight], equations: Sequence[str]) -> float:
    """By how much -2 log likelihood is less with one attitude or all velocities of another scale.

    Rates and forces have theirs anyway. It is a parabola in the logarithm of the scale.
    """
    asis, most = _scaled(flights, equations, (), 1.0), 0.0
    for names in (("phi",), ("theta",), VELOCITIES):
        if {*names} <= {*equations}:
            less, more = (
                asis - _scaled(flights, equations, names, f) for f in (1 / FACTOR, FACTOR)
            )
            slope, bend = (more - less) / 2, -(more + less)
            best = slope**2 / (2 * bend) if bend > abs(slope) / 2 else 0.0
            most = max(most, best, less, more)
    return most


def _scaled(
    flights: Sequence[Flight], equations: Sequence[str], names: Collection[str], factor: float
) -> float:
    """-2 log likelihood of what was recorded, some channels so many times that."""
    scaled = [
        replace(each, values={n: x * factor if n in names else x for n, x in each.values.items()})
        for each in flights
    ]
    found = reconstruct(scaled, equations)
    samples = sum(len(left) for name in names for left in found.left[name])
    return unlikely(found, scaled) - 2 * samples * float(np.log(factor))


def drawn_apart(found: Instruments) -> bool:
    """Whether records draw the skews of all apart, so that they are looked at one by one."""
    return any(differ(skews, least, SUSPECT, SKEW / 2) for skews, least in found.drawn)


def _of(
    found: Instruments, group: Collection[str], beside: Instruments | None = None
) -> tuple[float, float] | None:
    """How late a group of channels is (later than ``beside``), and the error [s], if told."""
    seen = [name for name in known(found) if name in group]
    rows = [found.channels.index(name) for name in seen]
    if not seen:
        return None
    skews = found.unknowns[:, 1] - (beside.unknowns[:, 1] if beside else 0.0)
    return mean([(float(skews[i]), float(found.errors[i, 1])) for i in rows])


def differ(skews: Array, errors: Array, level: float = LEVEL, least: float = SKEW) -> bool:
    """Whether skews [s] scatter by more than their errors and a third of what matters."""
    variances = errors**2 + (SKEW / 3) ** 2
    middle = np.average(skews, weights=1 / variances)
    chi2 = float(np.sum((skews - middle) ** 2 / variances))
    return bool(np.ptp(skews) > least and scipy.special.chdtrc(len(skews) - 1, chi2) < level)
