"""Measured responses of flight conditions that contradict each other, as of a wrong airspeed.

At the estimate of all conditions, each one's residuals r and derivatives J by the free parameters,
made independent and of unit variance by the stated errors, tell to first order what is left of them
if the conditions share a step of the parameters, r' = r + J d, and if each has its own,
r' − J (J⁺ r'). A structure that lacks something misses as much with a step of each condition's own;
where one of its own explains most of what exceeds the errors the conditions are not of one aircraft
as the structure has it.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import fdtrc

from casid.arrays import Array, BoolArray
from casid.display import listed
from casid.evaluation import MatrixFunction
from casid.free import Free
from casid.matching.comparison import Comparison
from casid.matching.lack_of_fit import NOTHING, directions, measurements, residuals
from casid.matching.targets import Target
from casid.nonlinear.conditions import by_condition

FAR = 3.0  # times the stated variance that is told
MOST = 0.5  # of what is left of a condition's squares, that a step of its own explains
SELDOM = 1e-6  # chance by which a step explains as much of residuals that no step explains

WHY = (
    "most of which would vanish with separate parameters for each condition: the conditions "
    "contradict each other, and the estimate is a compromise. Check the values of each "
    "condition, such as airspeed, whether a response belongs to another one, units, parameters "
    "that change with the condition and have no schedule in the structure, and what the "
    "structure misses, which they may show differently; leave one out and compare"
)


def discord(
    free: Free, active: BoolArray, comparison: Comparison, targets: Sequence[Target]
) -> str:
    """What says that measured responses of conditions contradict each other; "" without such.

    Parameters
    ----------
    free : Free
        Its guess is the estimate; ``active`` (nf,) are those that bounds hold.
    comparison : Comparison
        What was fitted: points of no weight say nothing, nor do those without stated errors.
    targets : sequence
        Those of its sources, or those put together in its one source, each of one condition. Black
        boxes among them say nothing.
    """
    measured = [
        (next(iter(by_condition(target.outputs))), target, source)
        for target, source in measurements(comparison, targets)
    ]
    if len({condition for condition, *_ in measured}) < 2:
        return ""
    room, matrices = directions(free, active), MatrixFunction(free)(free.guess)
    parts: dict[str, list[tuple[Array, Array]]] = {}
    for condition, target, source in measured:
        if (found := residuals(free.model, matrices, target, source)) is not None:
            r, J = found.parts()
            parts.setdefault(condition, []).append((r, J @ room))
    if len(parts) < 2:
        return ""
    own = {
        condition: (np.concatenate([r for r, _ in each]), np.vstack([J for _, J in each]))
        for condition, each in parts.items()
    }
    all_r, all_J = (np.concatenate(each) for each in zip(*own.values(), strict=True))
    size = np.linalg.norm(all_J, axis=0)
    unit = np.where(size > 0, size, 1.0)
    shared = np.linalg.lstsq(all_J / unit, -all_r, rcond=NOTHING)[0] / unit
    far = []
    for condition, (r, J) in own.items():
        left = r + J @ shared
        if _explains(J / unit, left) and r @ r > FAR * len(r):
            far.append((float(np.sqrt(r @ r / len(r))), condition))
    if not far:
        return ""
    told = [f"{name!r} {size:.2g}" for size, name in sorted(far, reverse=True)]
    return f"responses are off at conditions {listed(told)} times as far as stated, {WHY}"


def _explains(J: Array, left: Array) -> bool:
    """Whether a step explains most of residuals that exceed their errors by far."""
    U, found, _ = np.linalg.svd(J, full_matrices=False)
    U = U[:, found > NOTHING * found.max(initial=0.0)]
    rank, rest = U.shape[1], len(left) - U.shape[1]
    total, gain = float(left @ left), float(np.sum((U.T @ left) ** 2))
    if not rank or rest < 1 or total < FAR * len(left) or gain < MOST * total:
        return False
    ratio = gain / rank / max((total - gain) / rest, np.finfo(float).tiny)
    return bool(fdtrc(rank, rest, ratio) < SELDOM)
