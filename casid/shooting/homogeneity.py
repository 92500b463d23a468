"""What is told of records that contradict the others, as one of a wrong trim, unit or gain does.

A wrong constant of one record's channel, where records have no biases, or its wrong gain, moves all
estimates by many standard errors: residuals stay small, since one estimate between the records
takes the fault as well as it may. `casid.shooting.outlying_records` finds which; this says so.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from casid.arrays import Array
from casid.display import listed
from casid.errors import warn
from casid.record import Record
from casid.shooting.amplitudes import end
from casid.shooting.hausman import APART, MOST
from casid.shooting.outlying_records import Discord

FAR = 2.0  # errors by noise alone that an estimate moves without the record: that is told
WIDER = 1.2  # times the errors by noise that are stated: that is told

FED_BACK = (
    "Coloured residuals that later inputs follow, which is told as well, bias each record in its "
    "own way and set sound ones apart: do first what is said there, and suspect instruments, "
    "amplitudes or trims if records contradict each other then"
)
OPPOSED = "output error: records contradict each other"  # how what is told of it begins


def warn_of_contradiction(
    found: Discord | None, flown: Sequence[Record], of: Sequence[str], *, fed_back: bool
) -> None:
    """Tell of records that contradict the others, if there are any; see `tell`."""
    if found is not None:
        tell(found, flown, of, fed_back=fed_back)


def tell(
    found: Discord, flown: Sequence[Record], of: Sequence[str], *, fed_back: bool = False
) -> None:
    """Tell of records that contradict the others, if that moves what is estimated ``of`` them.

    Or if their scatter is in the errors stated. Coloured residuals that are ``fed_back`` bias each
    record by itself, so that none need be at fault.
    """
    # Of scattered records standard errors may be so large that they hide the one at fault.
    off, unit = found.off, np.where(found.noise > 0, found.noise, np.inf)
    moves = np.where(np.abs(off.apart) > APART, off.step / unit, 0.0)
    if np.abs(moves).max() > FAR or found.wider is not None:
        names = [record.name or f"record {k}" for k, record in enumerate(flown, 1)]
        advice = FED_BACK if fed_back else _advice(found, flown, names)
        warn(_told(found, names, of, moves) + advice + _widened(found, of))


def _told(found: Discord, names: Sequence[str], of: Sequence[str], moves: Array) -> str:
    """In words; ``moves`` are of the parameters in standard errors."""
    blamed, off, n = [names[i] for i in found.which], found.off, len(names)
    far = [k for k in np.argsort(-np.abs(moves))[:MOST] if abs(moves[k]) > FAR]
    moved = listed([f"{of[k]} by {moves[k]:+.2g}" for k in far])
    square, freedom, of_what = off.square, off.freedom, "combinations of parameters"
    if found.sides is not None:
        smaller, larger = (listed([names[i] for i in side]) for side in found.sides)
        who = f"those of the larger inputs, {larger}, and those of the smaller, {smaller}"
        without, n = f"of {smaller} alone", 1
    elif len(names) == 2:
        other = names[1 - found.which[0]]
        who, without = f"{blamed[0]} and {other}", f"of {other} alone"
    elif found.any is None:
        who = f"{blamed[0]} most, but also the others, whichever few are left out"
        without = f"without {blamed[0]}"
    elif found.any:
        who = f"one of {listed(blamed)} and the others, which agree without any one of them"
        without = f"without {blamed[0]}"
    else:
        who, without = f"{listed(blamed)} and all others, which agree", f"without {listed(blamed)}"
    if found.whole is not None:
        (square, freedom), n, of_what = found.whole, 1, "combinations of parameters of all records"
    return (
        f"{OPPOSED}: {who} (chi-square of {square:.0f} in {freedom} {of_what}, "
        f"where chance hardly exceeds {chdtri(freedom, found.seldom / n):.0f}). "
        + f"Estimates {without} differ, in standard errors from noise alone: {moved}. "
        * bool(far)
    )


def _widened(found: Discord, of: Sequence[str]) -> str:
    """By how much standard errors are those of how records scatter."""
    if found.wider is None or not found.wider.max(initial=0.0) > WIDER:
        return ""
    k = int(np.argmax(found.wider))
    return (
        ". Standard errors are taken from the scatter between records where that is larger: that "
        f"of {of[k]} is {found.wider[k]:.2g} times what noise alone makes it"
    )


def _advice(found: Discord, flown: Sequence[Record], names: Sequence[str]) -> str:
    """What to do."""
    if found.sides is not None:
        return (
            "The response seems to depend on amplitude (ask distortion): a linear model holds for "
            "one of them. Estimate together what was flown alike"
        )
    if found.any is None:
        return (
            "A response that depends on amplitude (ask distortion) or on flight condition looks "
            "the same: estimate together what was flown alike"
        )
    said = (
        "Standard errors do not know which is right. Check there the offset, unit, sign and gain "
        "of every channel, and the trim; biases or state_biases allow for constant offsets; "
        "leave it out and compare"
    )
    if ends := [(i, way) for i in found.which if (way := end(flown, i))]:
        i, way = ends[0]
        said += (
            f". {names[i]} has the {way} inputs: a response that depends on amplitude looks the "
            "same (ask distortion)"
        )
    return said
