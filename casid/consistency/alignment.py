"""Which channels to move in time so that records agree with kinematics.

Kinematics sees how channels stand to each other, inputs it does not see at all. What moves are the
fewer: attitudes and velocities rather than all rates and forces, which were recorded with the
inputs more often than not, and a second logger rather than the one with the inputs. Rates that seem
early stay where their attitudes can move: instruments and filters delay, nothing is measured before
it happens, and the forces of the same sensor would have to be early with them. Attitudes are of one
source, and move together unless some of them are known to be elsewhere.
"""

from collections.abc import Collection, Mapping

from casid.channels import ATTITUDES, FORCES, RATES
from casid.consistency.kinematics import KinematicCheck

Moves = dict[str, float]


def aligned(
    check: KinematicCheck, first: Collection[str], second: Collection[str], inputs: Collection[str]
) -> tuple[Moves, tuple[str, ...]]:
    """Shifts [s] of the channels of two loggers, and why in words."""
    moves, why = check.shifts_of(first)
    others, more = check.shifts_of(second)
    fewer = () if others else _fewer(check, moves, first, () if {*inputs} & {*second} else second)
    if not fewer:
        moves |= others
        mates = _mates(check, moves, [each for each in (first, second) if {*moves} & {*each}])
        return moves | mates, (*([_shared(mates)] if mates else []), *why, *more)
    (lag,) = {*moves.values()}
    unseen = [name for name in fewer if name not in _against(check, moves)]
    stay = f"{', '.join(moves)} are assumed to share one clock, and stay with the inputs"
    return dict.fromkeys(fewer, -lag), (*([_shared(unseen)] if unseen else []), stay)


def _shared(names: Collection[str]) -> str:
    return f"{', '.join(names)}: assumed to share the clock of the others that move"


def _mates(check: KinematicCheck, moves: Moves, loggers: Collection[Collection[str]]) -> Moves:
    """Attitudes that move with those that do, of which nothing else is known."""
    late = {name: lag for name, lag in moves.items() if name in ATTITUDES}
    if len({*late.values()}) != 1 or {*ATTITUDES} & {*check.apart.against}:
        return {}
    (lag,) = {*late.values()}
    own = {name for logger in loggers if {*late} & {*logger} for name in logger}
    return {name: lag for name in ATTITUDES if name in own and name not in late}


def _against(check: KinematicCheck, moves: Collection[str]) -> set[str]:
    """Attitudes and velocities by which channels that move were seen to be late."""
    seen = [each for each in check.channels if each.channel in check.shifts]
    return {one for each in seen if each.channel in moves for one in each.against}


def _fewer(
    check: KinematicCheck, moves: Moves, first: Collection[str], second: Collection[str]
) -> tuple[str, ...]:
    """What may move instead of all rates, and forces, of the first logger, if it is better."""
    rates, sensors = ({*kind} & {*first} for kind in (RATES, (*RATES, *FORCES)))
    if not rates <= {*moves} <= sensors or len({*moves.values()}) != 1:
        return ()
    against = _against(check, moves)
    early = bool(rates) and min(moves.values()) > 0 and against <= {*ATTITUDES}
    if not (early or {*moves} == sensors):
        return ()
    if against <= {*second}:
        return tuple(second)
    if not against <= {*first}:
        return ()
    mates = {*ATTITUDES} if against & {*ATTITUDES} else set()
    found = tuple(name for name in first if name in against | mates)
    return found if early or len(found) < len(sensors) else ()


def moves_told(moves: Mapping[str, float]) -> str:
    """What is moved by how much, and what that does to delays."""
    if not moves:
        return "none"
    lags = ", ".join(f"{name} {1e3 * lag:+.0f} ms" for name, lag in moves.items())
    return (
        f"{lags}; inputs stay, so their delays to {', '.join(moves)} change by as much: if "
        "inputs share the clock of these, name both in channels.shift, with these values"
    )
