"""Whether the clocks of two loggers differ from record to record, as where one is started anew.

Skews are one for all records; where they are not, what is found is the skew of none, and what it
leaves passes for scales.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from casid.arrays import Array
from casid.channels import FORCES, RATES
from casid.consistency.apart import known
from casid.consistency.further import unexplained
from casid.consistency.instruments import Instruments
from casid.consistency.measured import Flight, read_later
from casid.consistency.parting import reconstruct_level
from casid.consistency.signs import unlikely
from casid.consistency.voting import SKEW, mean

LEVEL = 1e-4  # at which skews of records are called different
SUSPECT = 0.05  # at which they are looked at one by one
EXPLAINS = 25.0  # by which -2 log likelihood is less once they are set, at least
GROUPS = {RATES: "rates and attitudes", FORCES: "specific forces and velocities"}


def clocks_by_record(
    flights: Sequence[Flight],
    equations: Sequence[str],
    together: Instruments,
    labels: Mapping[int, str],
) -> tuple[str, ...]:
    """Remarks on clocks that differ by record (``labels`` by number), found by each alone.

    Records are looked at one by one only where they draw the skews found ``together`` apart, by
    half of what matters and more than the least errors these can have (a score test). They are
    believed if all records together leave less once clocks are set as found.
    """
    if not drawn_apart(together):
        return ()
    alone = {}
    for k in labels:
        own = [flight for flight in flights if flight.record == k]
        found = reconstruct_level(own, equations)
        if not unexplained(found, own, {k: labels[k]}):
            alone[labels[k]] = found
    said, least = [], unlikely(together, flights) - EXPLAINS
    for group, words in GROUPS.items():
        skews = {name: late for name, one in alone.items() if (late := _of(one, group)) is not None}
        # Channels whose skews differ weigh otherwise in each record: from their own they count.
        off = [late for one in alone.values() if (late := _of(one, group, together)) is not None]
        if len(off) > 1 and differ(*np.transpose(off)):
            by = {k: skews[name][0] for k, name in labels.items() if name in skews}
            moved = [_on_time(each, group, by.get(each.record, 0.0)) for each in flights]
            if unlikely(reconstruct_level(moved, equations), moved) > least:
                continue
            each = ", ".join(f"{name} {late:+.3g}" for name, (late, _) in skews.items())
            said.append(
                f"the clocks of {words} differ by record: {words.split()[0]} are late by {each} s; "
                "set them record by record (Record.shift, Record.join); kinematics unchecked"
            )
    return tuple(said)


def _on_time(flight: Flight, group: Collection[str], late: float) -> Flight:
    """The flight, channels of a group so much earlier."""
    values = dict(flight.values)
    for name in {*group} & {*values}:
        pieces = scipy.interpolate.CubicSpline(flight.t, values[name]).c
        values[name], _ = read_later(pieces, late, flight.dt)
    return replace(flight, values=values)


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
