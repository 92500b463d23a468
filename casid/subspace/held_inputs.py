"""Discrete models of inputs that are held between the samples, and `casid.subspace.prediction` so.

Between samples inputs are steps or straight lines; both are exact. With straight lines the discrete
state is x - B1 u, and every direct term is free. Where a controller feeds noise back into the
inputs, a black box of projections is refined in this way.
"""

from dataclasses import replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace, foh_step, from_zoh
from casid.record import Hold
from casid.records import same_interval
from casid.subspace.campaign import Campaign
from casid.subspace.prediction import SampledUncertainty, refine_samples

LINES = 60  # frequencies at which two responses are compared


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
) -> tuple[StateSpace, Array, SampledUncertainty, StateSpace]:
    """`refine_samples` for a continuous model of inputs that are held between the samples.

    What is left of a masked direct term in continuous time goes into B; the last model still has
    it. ``K`` comes back as the discrete gain by the step's input integral, approximately the
    continuous one. ValueError: records of unequal sampling, or a refined pole without a continuous
    equivalent.
    """
    records, mask = pieces.records, pieces.mask
    h, hold = records[0].dt, records[0].hold
    alike = (r.equidistant and r.hold == hold and same_interval(r, records[0]) for r in records)
    if not all(alike):
        raise ValueError("prediction errors need equidistant records of one interval and one hold")
    _, I0, I1 = _held(system.A, h, hold)
    free = mask if hold == "zoh" else np.ones_like(mask)
    start = discretised(system, h, hold)
    found, gain, uncertainty = refine_samples(
        start, (I0 + I1) @ K, records, pieces.su, pieces.sy, free
    )
    direct = undiscretised(found, hold)
    _, I0, I1 = _held(direct.A, h, hold)
    longest = max(record.t[-1] - record.t[0] for record in records)
    omega = np.geomspace(2 * np.pi / longest, np.pi / h, LINES)
    refined = _without_direct(direct, mask, uncertainty, omega)
    return refined, np.linalg.solve(I0 + I1, gain), uncertainty, direct


def _without_direct(
    system: StateSpace, mask: BoolArray, uncertainty: SampledUncertainty, omega: Array
) -> StateSpace:
    """The model of the same A and C nearest in stated errors that has direct terms at ``mask``."""
    if not system.D[~mask].any():
        return system
    G = system.response(omega)
    errors = np.abs(G) * np.linalg.norm(uncertainty.response_factor(omega), axis=-1)
    weight = 1 / np.maximum(errors, 1e-12 * np.abs(G).max())
    seen = system.C @ np.linalg.inv(1j * omega[:, None, None] * np.eye(system.nx) - system.A)
    B, D = system.B.copy(), np.where(mask, system.D, 0.0)
    for i, free in enumerate(mask.T):
        direct = np.broadcast_to(np.eye(system.ny)[:, free], (len(omega), system.ny, free.sum()))
        w = weight[:, :, i, None]
        rows = (w * np.concatenate([seen, direct], axis=2)).reshape(-1, system.nx + free.sum())
        left = (w[:, :, 0] * np.where(free, 0.0, system.D[:, i])).ravel()
        change = np.linalg.lstsq(
            np.vstack([rows.real, rows.imag]), np.concatenate([left, 0 * left]), rcond=1e-10
        )[0]
        B[:, i] += change[: system.nx]
        D[free, i] += change[system.nx :]
    return replace(system, B=B, D=D)


def _held(A: Array, h: float, hold: Hold) -> tuple[Array, Array, Array]:
    """exp(A h) and the weights of B u(t) and B u(t + h) in one step."""
    step, I0, I1 = foh_step(A, np.eye(len(A)), h)
    return (step, I0, I1) if hold == "foh" else (step, I0 + I1, np.zeros_like(I1))
