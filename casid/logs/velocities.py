"""Velocities in body axes of a log whose attitudes come late.

Logs keep them north, east, down; attitudes turn them. At a speed U an attitude that comes late by τ
makes v wrong by U r τ and w by -U q τ, which kinematics can hardly tell from accelerometers U τ
away from the centre of gravity.
"""

from collections.abc import Mapping

from casid.channels import ATTITUDES, VELOCITIES
from casid.logs.conventions import BODY, derived, turned_by
from casid.logs.sources import Source, source_of
from casid.logs.topics import Log


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
