"""`casid.subspace.prediction` for a continuous model: discretised for the records' hold, and back.

Between samples inputs are steps or straight lines; both are exact. Where a controller feeds noise
back into the inputs, a black box of projections is refined in this way.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace, foh_step, from_zoh
from casid.record import Record
from casid.subspace.prediction import SampledUncertainty, refine_samples


def refine_held(
    system: StateSpace,
    K: Array,
    records: Sequence[Record],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
) -> tuple[StateSpace, Array, SampledUncertainty]:
    """`refine_samples` for a continuous model of inputs that are held between the samples.

    The model is discretised exactly for the records' hold and back. With straight lines between
    samples, state x - B1 u, every discrete direct term is free, and what is left of a masked one
    in continuous time is dropped. ``K`` comes back as the discrete gain by the step's input
    integral, approximately the continuous one.

    Raises
    ------
    ValueError
        Records of unequal sampling, or a refined pole without a continuous equivalent.
    """
    record = records[0]
    h = record.dt
    if any(not r.equidistant or r.hold != record.hold or abs(r.dt - h) > 1e-6 * h for r in records):
        raise ValueError("prediction errors need equidistant records of one interval and one hold")
    A, I0, I1 = _held(system.A, h, record)
    direct = system.D + system.C @ I1 @ system.B
    discrete = StateSpace(A, (I0 + A @ I1) @ system.B, system.C, direct, h,
                          system.inputs, system.outputs)  # fmt: skip
    free = feedthrough if record.hold == "zoh" else np.ones_like(feedthrough)
    found, gain, uncertainty = refine_samples(discrete, (I0 + I1) @ K, records, su, sy, free)
    A, _ = from_zoh(found.A, found.B, h)
    _, I0, I1 = _held(A, h, record)
    B = np.linalg.solve(I0 + found.A @ I1, found.B)
    D = np.where(feedthrough, found.D - found.C @ I1 @ B, 0.0)
    refined = StateSpace(A, B, found.C, D, None, system.inputs, system.outputs)
    return refined, np.linalg.solve(I0 + I1, gain), uncertainty


def _held(A: Array, h: float, record: Record) -> tuple[Array, Array, Array]:
    """exp(A h) and the weights of B u(t) and B u(t + h) in one step."""
    step, I0, I1 = foh_step(A, np.eye(len(A)), h)
    return (step, I0, I1) if record.hold == "foh" else (step, I0 + I1, np.zeros_like(I1))
