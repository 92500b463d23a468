"""The innovation gain of a filter-error model: where to start it, and a black box's one.

dx/dt = A x + B u + K e,    e_k = y_k - ŷ_k held over the sampling interval
"""

from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.display import listed
from casid.errors import warn
from casid.free import Free
from casid.intersample import integrals
from casid.model import Model
from casid.record import Record
from casid.shooting.kalman import settling_time
from casid.shooting.likelihood import CovarianceKind
from casid.shooting.starting import FLOOR, SURPRISE, accumulated
from casid.shooting.unknowns import GainUnknowns, NoiseUnknowns
from casid.subspace.pbsid import BlackBox

ProcessNoise: TypeAlias = bool | Literal["gain"] | Array | BlackBox

NOISE_SHARE = 0.1  # of an output's root mean square, taken for its measurement noise
NOTICED = 0.1  # rise of an output's innovations, over their variance
LOST = 0.1  # of an output's samples at irregular distances, from which one gain is told to be wrong
SMALL = 1e-2  # unit of a measurement noise, of its variance at the start


def filter_unknowns(
    free: Free, records: list[Record], process_noise: ProcessNoise, R: Array | CovarianceKind
) -> GainUnknowns | NoiseUnknowns | None:
    """Unknowns of a filter and where they start; None for output error."""
    check_gain(free.model, process_noise)
    model = free.model.with_vector(free.full(free.guess))
    if isinstance(process_noise, BlackBox):
        return GainUnknowns(black_box_gain(model, process_noise), free=True)
    if isinstance(process_noise, str):
        return GainUnknowns(kalman_gain(model, records), free=True)
    if isinstance(process_noise, bool):
        return starting_noises(model, records, R) if process_noise else None
    return GainUnknowns(np.asarray(process_noise, dtype=float), free=False)


def check_gain(model: Model, process_noise: ProcessNoise) -> None:
    """Refuse what is no process noise, or no gain of a model's own."""
    if isinstance(process_noise, str) and process_noise != "gain":
        raise ValueError(f'process_noise={process_noise!r}: expected True, False or "gain"')
    if isinstance(process_noise, bool | str | BlackBox):
        return
    gain, shape = np.asarray(process_noise, dtype=float), (len(model.states), len(model.outputs))
    if gain.shape != shape:
        raise ValueError(f"process_noise has shape {gain.shape}, expected K (nx, ny) = {shape}")
    if not np.isfinite(gain).all():
        raise ValueError("process_noise: expected a gain K of finite numbers, without NaN")


def tell_of_lost_samples(records: list[Record]) -> None:
    """Warn of outputs with irregular gaps, which one gain for all samples does not suit.

    What a filter knows after a gap is worse than after a sample, so innovations there want another
    gain, and its errors are stated as if they did not.
    """
    irregular = {}
    for i, name in enumerate(records[0].outputs):
        steps = [np.diff(np.flatnonzero(np.isfinite(record.y[:, i]))) for record in records]
        odd = [each != np.median(each) for each in steps if len(each)]
        if odd and (share := float(np.mean(np.concatenate(odd)))) > LOST:
            irregular[name] = share
    if irregular:
        worst = max(irregular.values())
        warn(
            f"samples of {listed([*irregular])} are lost at random ({worst:.0%} of the distances "
            "between samples are not the usual one): one gain serves all samples, which is not the "
            "best after a gap, and standard errors come out too small; process_noise=True has "
            "a gain for every gap"
        )


def starting_noises(
    model: Model, records: list[Record], R: Array | CovarianceKind
) -> NoiseUnknowns:
    """Noises to start from, in units of what would be noticed.

    Measurement noise from second differences of the outputs, where motion hardly shows; the unit of
    each process noise raises some output's innovations by a tenth over two seconds.
    """
    system, size = model.system(), root_mean_square([record.y for record in records])
    given = R if isinstance(R, np.ndarray) else None
    noise = [_roughness([record.y[:, i] for record in records]) for i in range(system.ny)]
    least = (FLOOR * size) ** 2
    variance = np.maximum(noise, 4 * least) if given is None else np.diag(given)
    horizon = settling_time(records)
    seen = [
        np.max(
            np.diag(system.C @ accumulated(system.A, np.diag(one), horizon) @ system.C.T) / variance
        )
        for one in np.eye(system.nx)
    ]
    constant = np.isin(model.states, model.constant_states)
    heard = (np.array(seen) > 0) & ~constant
    q0 = np.where(heard, NOTICED / np.where(heard, seen, 1.0), 0.0)
    unknowns = NoiseUnknowns(
        q0, SMALL * variance, least, given, isinstance(R, str) and R == "full", np.zeros(0)
    )
    nx, nr, nt = unknowns.count
    start = np.concatenate([np.zeros(nx), np.full(nr, np.log1p(1 / SMALL)), np.zeros(nt)])
    return replace(unknowns, start=start)


def root_mean_square(parts: list[Array]) -> Array:
    """Of every column of arrays (N, ny), NaN left out; 1 where that is 0."""
    size = np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0))
    return np.where(size > 0, size, 1.0)


def _roughness(columns: list[Array]) -> float:
    """Variance of white noise that second differences of samples would come from; NaN left out."""
    bends = [np.diff(y[np.isfinite(y)], 2) for y in columns]
    return float(np.mean(np.concatenate(bends) ** 2)) / 6


def kalman_gain(model: Model, records: list[Record]) -> Array:
    """Stationary Kalman gain for disturbances of the inputs' size and 10 % measurement noise."""
    # Not an estimate: a gain that makes the predictor stable, whatever the aircraft, to start from.
    system, h = model.system(), float(np.median([record.dt for record in records]))
    nx, ny = system.nx, system.ny
    u = np.concatenate([record.u for record in records])
    Q = SURPRISE**2 * (system.B * np.mean(u**2, axis=0)) @ system.B.T
    Q += 1e-6 * np.trace(Q) / nx * np.eye(nx)
    R = np.diag((NOISE_SHARE * root_mean_square([record.y for record in records])) ** 2)
    Ad, held, _ = integrals(system.A, np.array([h]))[:, 0]
    try:
        P = scipy.linalg.solve_discrete_are(Ad.T, system.C.T, Q * h, R)
    except np.linalg.LinAlgError:  # an unstable mode that no output sees
        return np.zeros((nx, ny))
    gain = np.linalg.solve(system.C @ P @ system.C.T + R, system.C @ P @ Ad.T).T
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
