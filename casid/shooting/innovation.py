"""The innovation gain of a filter-error model: where to start it, and a black box's one.

dx/dt = A x + B u + K e,    e_k = y_k - ŷ_k held over the sampling interval
"""

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.intersample import integrals
from casid.model import Free, Model
from casid.record import Record
from casid.shooting.starting import SURPRISE
from casid.subspace.pbsid import BlackBox

NOISE_SHARE = 0.1  # of an output's root mean square, taken for its measurement noise


def starting_gain(
    free: Free, records: list[Record], process_noise: bool | Array | BlackBox
) -> tuple[Array | None, bool]:
    """Start of the gain K (nx, ny), None for output error, and whether it is free."""
    shape = len(free.model.states), len(free.model.outputs)
    model = free.model.with_vector(free.full(free.guess))
    if isinstance(process_noise, BlackBox):
        return black_box_gain(model, process_noise), True
    if isinstance(process_noise, bool):
        return (kalman_gain(model, records), True) if process_noise else (None, False)
    gain = np.asarray(process_noise, dtype=float)
    if gain.shape != shape or not np.isfinite(gain).all():
        raise ValueError(f"process_noise has shape {gain.shape}, expected K (nx, ny) = {shape}")
    return gain, False


def kalman_gain(model: Model, records: list[Record]) -> Array:
    """Stationary Kalman gain for disturbances of the inputs' size and 10 % measurement noise."""
    # Not an estimate: a gain that makes the predictor stable, whatever the aircraft, to start from.
    system, h = model.system(), float(np.median([record.dt for record in records]))
    nx, ny = system.nx, system.ny
    u, y = (np.concatenate([getattr(record, name) for record in records]) for name in "uy")
    Q = SURPRISE**2 * (system.B * np.mean(u**2, axis=0)) @ system.B.T
    Q += 1e-6 * np.trace(Q) / nx * np.eye(nx)
    size = np.sqrt(np.nanmean(y**2, axis=0))
    R = np.diag((NOISE_SHARE * np.where(size > 0, size, 1.0)) ** 2)
    Ad, held, _ = integrals(system.A, np.array([h]))[:, 0]
    try:
        P = scipy.linalg.solve_discrete_are(Ad.T, system.C.T, Q * h, R)
    except np.linalg.LinAlgError:  # an unstable mode that no output sees
        return np.zeros((nx, ny))
    gain = Ad @ P @ system.C.T @ np.linalg.inv(system.C @ P @ system.C.T + R)
    return np.asarray(np.linalg.solve(held, gain))


def black_box_gain(model: Model, black_box: BlackBox) -> Array:
    """Gain K (nx, ny) of a black box in the states and outputs of a model."""
    # The states of both are compared through their responses to the inputs on the black box's band,
    # on a line right of all poles: x_model = T x_blackbox by least squares, K = T K̂.
    system, box = model.system(), black_box.system
    if box.dt is not None:
        raise ValueError(
            "process_noise: this black box is discrete, its gain belongs to one sampling interval; "
            'use pbsid(..., transform="laguerre") or give K'
        )
    columns = [box.outputs.index(name) for name in model.outputs]
    inputs = [box.inputs.index(name) for name in model.inputs]
    shift = 0.1 + max(0.0, *(float(s.poles()[0].real) for s in (system, box)))
    line = shift + 1j * np.geomspace(*black_box.band, 50)
    X = np.linalg.solve(line[:, None, None] * np.eye(system.nx) - system.A, system.B + 0j)
    X = X * np.exp(-line[:, None, None] * system.delay)
    Z = np.linalg.solve(line[:, None, None] * np.eye(box.nx) - box.A, box.B[:, inputs] + 0j)
    X, Z = (np.moveaxis(part, 1, 0).reshape(part.shape[1], -1) for part in (X, Z))
    X, Z = (np.hstack([part.real, part.imag]) for part in (X, Z))
    T = np.linalg.lstsq(Z.T, X.T, rcond=1e-8)[0].T
    return np.asarray(T @ black_box.K[:, columns])
