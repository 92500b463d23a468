"""What moves in time of a log: channels of one message together, velocities by what turned them.

Logs keep them north, east, down; attitudes turn them. At a speed U an attitude that comes late by τ
makes v wrong by U r τ and w by -U q τ, which kinematics can hardly tell from accelerometers U τ
away from the centre of gravity.
"""

from collections.abc import Mapping

from casid.channels import ATTITUDES, FORCES, RATES, VELOCITIES
from casid.logs.conventions import BODY, derived, turned_by
from casid.logs.sources import Source, source_of
from casid.logs.topics import Log


def together(outputs: Mapping[str, Source], moves: Mapping[str, float]) -> dict[str, float]:
    """Of the moves [s] those of whole messages: rates of one, attitudes and so on, or none of them.

    One sensor measured them at one instant, or one estimate has them all.
    """
    kept = dict(moves)
    for kind in (RATES, FORCES, ATTITUDES, VELOCITIES):
        topics: dict[int, list[str]] = {}
        for name in kind:
            if name in outputs:
                topics.setdefault(id(outputs[name].topic), []).append(name)
        for mates in topics.values():
            if len({moves.get(name) for name in mates}) > 1:
                kept = {name: lag for name, lag in kept.items() if name not in mates}
    return kept


def turned_anew(
    log: Log, outputs: Mapping[str, Source], moves: Mapping[str, float]
) -> tuple[dict[str, Source], float]:
    """Velocities turned by attitudes that are late no more, and by how much they were [s].

    They are of a ``log`` as it was read. None where the ``moves`` [s], as `Record.shift` takes
    them, bring no attitude nearer to the velocities, or others than these turn them.
    """
    own = [n for n in VELOCITIES if n in outputs and outputs[n].topic.name == BODY]
    angles = [name for name in ATTITUDES if name in outputs]
    moved, speeds = ({moves.get(n, 0.0) for n in names} for names in (angles, own))
    turning = {attitude for _, attitude in turned_by(log)[:1]}
    if {*angles} & {*moves} and len(moved) == len(speeds) == 1:
        late = speeds.pop() - moved.pop()
        if late and {outputs[name].topic.name for name in angles} == turning:
            anew = derived(log, late)
            found = {name: source_of(anew, f"{BODY}.{name}") for name in own}
            return {name: each for name, each in found.items() if each is not None}, late
    return {}, 0.0
