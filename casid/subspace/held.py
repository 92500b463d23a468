"""Discrete models of inputs that are held between the samples, and `casid.subspace.prediction` so.

Between samples inputs are steps or straight lines; both are exact. With straight lines the discrete
state is x - B1 u, and every direct term is free. Where a controller feeds noise back into the
inputs, a black box of projections is refined in this way.
"""

import numpy as np

from casid.arrays import Array
from casid.linear import StateSpace, foh_step, from_zoh
from casid.record import Hold
from casid.subspace.campaign import Campaign
from casid.subspace.prediction import SampledUncertainty, refine_samples


def discretised(system: StateSpace, h: float, hold: Hold) -> StateSpace:
    """The discrete model, every ``h`` [s], of a continuous one and a hold of its inputs."""
    A, I0, I1 = _held(system.A, h, hold)
    B, D = (I0 + A @ I1) @ system.B, system.D + system.C @ I1 @ system.B
    return StateSpace(A, B, system.C, D, h, system.inputs, system.outputs)


def undiscretised(system: StateSpace, hold: Hold) -> StateSpace:
    """Inverse of `discretised`; ValueError for a discrete pole on the negative real axis."""
    h = float(system.dt or 1.0)
    A, _ = from_zoh(system.A, system.B, h)
    _, I0, I1 = _held(A, h, hold)
    B = np.linalg.solve(I0 + system.A @ I1, system.B)
    D = system.D - system.C @ I1 @ B
    return StateSpace(A, B, system.C, D, None, system.inputs, system.outputs)


def refine_held(
    system: StateSpace, K: Array, pieces: Campaign
) -> tuple[StateSpace, Array, SampledUncertainty]:
    """`refine_samples` for a continuous model of inputs that are held between the samples.

    What is left of a masked direct term in continuous time is dropped. ``K`` comes back as the
    discrete gain by the step's input integral, approximately the continuous one. ValueError:
    records of unequal sampling, or a refined pole without a continuous equivalent.
    """
    records, mask = pieces.records, pieces.mask
    h, hold = records[0].dt, records[0].hold
    if any(not r.equidistant or r.hold != hold or abs(r.dt - h) > 1e-6 * h for r in records):
        raise ValueError("prediction errors need equidistant records of one interval and one hold")
    _, I0, I1 = _held(system.A, h, hold)
    free = mask if hold == "zoh" else np.ones_like(mask)
    start = discretised(system, h, hold)
    found, gain, uncertainty = refine_samples(
        start, (I0 + I1) @ K, records, pieces.su, pieces.sy, free
    )
    refined = undiscretised(found, hold)
    _, I0, I1 = _held(refined.A, h, hold)
    D = np.where(mask, refined.D, 0.0)
    refined = StateSpace(refined.A, refined.B, refined.C, D, None, system.inputs, system.outputs)
    return refined, np.linalg.solve(I0 + I1, gain), uncertainty


def _held(A: Array, h: float, hold: Hold) -> tuple[Array, Array, Array]:
    """exp(A h) and the weights of B u(t) and B u(t + h) in one step."""
    step, I0, I1 = foh_step(A, np.eye(len(A)), h)
    return (step, I0, I1) if hold == "foh" else (step, I0 + I1, np.zeros_like(I1))
