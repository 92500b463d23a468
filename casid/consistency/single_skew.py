"""One attitude or velocity that is late by itself, in place of several others that seem to be.

Every attitude and velocity stands in several equations. One that alone is late is no skew of a
rate, of a specific force, of all velocities, nor an accelerometer's place, but these together come
close to it and would be told in its stead. So each has a clock of its own in turn, beside all
other unknowns (`casid.consistency.flightpath`): the one that leaves least is believed where with it
nothing else is late or displaced, and no more mistakes must have been made than without it.
"""

from collections.abc import Sequence

from casid.consistency.clock_skews import Apart, known, stands_apart
from casid.consistency.flightpath import reconstruct
from casid.consistency.instruments import Instruments
from casid.consistency.measured import Flight
from casid.consistency.recordwise import drawn_apart
from casid.consistency.remarks import misplaced, seen_place
from casid.consistency.signs import unlikely
from casid.consistency.voting import significant

EXPLAINS = 25.0  # by which -2 log likelihood is less with one more clock, at least
FEWER = 9.0  # the same where it takes the place of several mistakes
TURNED = {"phi", "theta"}  # attitudes that stand in more equations than their own


def one_alone(
    flights: Sequence[Flight], equations: Sequence[str], found: Instruments
) -> tuple[Instruments, Apart]:
    """Instruments with one attitude or velocity late by itself, and what stands apart.

    They are what was ``found`` where nothing seems late, displaced or another in each record, and
    where no single one explains it.
    """
    best = found, stands_apart(found, known(found))
    mistakes = _mistakes(*best)
    if not (mistakes or drawn_apart(found)) or not {*equations} >= TURNED:
        return best
    least = unlikely(found, flights) - (FEWER if mistakes > 1 else EXPLAINS)
    for name in equations:
        one = reconstruct(flights, equations, alone=name)
        apart = stands_apart(one, known(one))
        if apart.names != (name,) or _mistakes(one, apart) > 1:
            continue
        if (size := unlikely(one, flights)) < least:
            best, least = (one, apart), size
    return best


def _mistakes(found: Instruments, apart: Apart) -> int:
    """How many clocks and places of accelerometers seem to be wrong."""
    skewed = [each for each in apart.left.values() if significant(*each)]
    return len({*apart.late.values()}) + len(skewed) + len(misplaced(*seen_place(found)))
