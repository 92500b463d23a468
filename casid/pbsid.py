"""Predictor-based subspace identification of a black box from records, open or closed loop.

Source: M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", section 3.2. All records are one least-squares problem over the stacked columns of all
of them. Departures: the projections are computed exactly from the samples (`casid.laguerre`), a
constant per record is projected out (residual trim), and the direct term may be masked.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solve_continuous_are
from scipy.optimize import linear_sum_assignment

from casid.arrays import Array, BoolArray
from casid.errors import DataWarning
from casid.fourier import spectra
from casid.laguerre import from_laguerre, project_blocks, support
from casid.linear import StateSpace, from_zoh
from casid.predictor import (
    Realisation,
    Stack,
    accumulate,
    predictor_coefficients,
    realise,
    triangular,
)
from casid.record import Record, same_channels, standard_deviations
from casid.refinement import ResponseUncertainty
from casid.refinement import refine as refine_black_box

Transform = Literal["laguerre", "none"]
Feedthrough = bool | Sequence[str] | BoolArray

BLOCK = 4096  # columns held at once
HIGHEST = 2.0  # of the Laguerre pole: frequencies above it are not refined on
BAND_END = 1.5  # of the Laguerre pole: the model is not trusted above it
LONG_GAP = 0.5  # of 1/a: missing samples over a longer time split a record


@dataclass(frozen=True, eq=False, kw_only=True)
class Segment:
    """What one stretch of a record gave: ``used`` of its ``duration`` [s] became columns."""

    record: str
    start: float
    duration: float
    used: float
    interpolated: int


@dataclass(frozen=True, eq=False, kw_only=True)
class BlackBox:
    """An unstructured model in innovation form, with the settings that gave it.

    Parameters
    ----------
    system : StateSpace
        Continuous (``dt`` None) from Laguerre-projected data, discrete from the samples themselves.
    K : (nx, ny) array
        Innovation gain, continuous or discrete as ``system``; A - KC is stable.
    singular_values : array
        Of the predicted future; their drop suggests the order.
    pole : float
        The Laguerre pole a [rad/s]; NaN for ``transform="none"``.
    past, future : int
        Window lengths.
    transform : {"laguerre", "none"}
        What the data went through.
    feedthrough : (ny, nu) bool array
        Where the direct term was free.
    input_std, output_std : (nu,), (ny,) array
        Standard deviations of the channels over the records.
    band : (float, float)
        Frequencies [rad/s] in which the records excite the aircraft and the model means something.
    records : tuple of str
        Names of the records used.
    regularisation : float
        Tikhonov factor of the regression, relative to its largest singular value.
    segments : tuple of Segment
        What was used of each record, and how many missing samples were interpolated.
    uncertainty : ResponseUncertainty or None
        Covariance of a refined black box; see `response_std`.
    """

    system: StateSpace
    K: Array
    singular_values: Array
    pole: float
    past: int
    future: int
    transform: str
    feedthrough: BoolArray
    input_std: Array
    output_std: Array
    band: tuple[float, float]
    records: tuple[str, ...]
    regularisation: float = 0.0
    segments: tuple[Segment, ...] = ()
    uncertainty: ResponseUncertainty | None = None

    def response_std(self, omega: Array) -> tuple[Array, Array]:
        """Relative standard deviation of abs(G) and standard deviation of its phase [rad].

        Both (K, ny, nu). They hold what noise, and whatever else the linear model cannot follow,
        does to the estimate of a model of this order; not the error of a wrong order.

        Raises
        ------
        ValueError
            The black box was not refined (``refine=False`` or ``transform="none"``).
        """
        if self.uncertainty is None:
            raise ValueError(
                "this black box has no uncertainty: only a refined one has; "
                'call pbsid with transform="laguerre" and refine=True'
            )
        return self.uncertainty.response_std(np.asarray(omega, dtype=float))

    @property
    def order(self) -> int:
        """Number of states."""
        return self.system.nx

    def continuous(self) -> "BlackBox":
        """The continuous equivalent of a discrete black box: inputs held between samples (ZOH).

        The gain K keeps the predictor's poles: A - KC is mapped by the same matrix logarithm.

        Raises
        ------
        ValueError
            A discrete pole on the negative real axis, which has no continuous equivalent.
        """
        system = self.system
        if system.dt is None:
            return self
        A, B = from_zoh(system.A, system.B, system.dt)
        predictor, _ = from_zoh(system.A - self.K @ system.C, system.B, system.dt)
        K = np.linalg.lstsq(system.C.T, (A - predictor).T, rcond=None)[0].T
        names = system.inputs, system.outputs
        return replace(self, system=StateSpace(A, B, system.C, system.D, None, *names), K=K)


def pbsid(
    records: Sequence[Record],
    *,
    order: int,
    past: int | None = None,
    future: int | None = None,
    pole: float | None = None,
    feedthrough: Feedthrough = True,
    transform: Transform = "laguerre",
    regularisation: float = 1e-3,
    refine: bool = True,
) -> BlackBox:
    """Identify a black box from the time histories of one or several manoeuvres.

    Parameters
    ----------
    records : sequence of Record
        Same channels; lengths and sampling may differ. Missing outputs (NaN) are interpolated
        linearly over short gaps and split the record at long ones; the result counts both.
    order : int
        Number of states.
    past, future : int
        Window lengths: Laguerre functions or samples. The past is 10 functions (2 order/ny, at
        least 10, samples) and the future the same unless given.
    pole : float
        Laguerre pole a [rad/s], faster than any unstable pole; 10 rad/s unless given.
    feedthrough : bool, (ny, nu) bool array or sequence of output names
        Where a direct term is allowed. On samples a masked entry is left out of the regressions;
        on projected data the response at infinite frequency is made zero there.
    transform : {"laguerre", "none"}
        Project the data on Laguerre functions (a continuous model), or use the samples themselves
        (a discrete model; equidistant records).
    regularisation : float
        Tikhonov factor of the regression, relative to its largest singular value.
    refine : bool
        Move the continuous subspace model to the maximum likelihood of the records' Fourier
        transforms (`casid.refinement`), with the direct term zero where it is masked. Without it a
        masked direct term is only made small.

    Returns
    -------
    BlackBox

    Raises
    ------
    ValueError
        Records too short for the windows, an order they cannot give, unequal channels.
    """
    inputs, outputs = same_channels(records)
    if transform not in get_args(Transform):
        raise ValueError(f'transform={transform!r}, expected "laguerre" or "none"')
    mask = feedthrough_mask(feedthrough, inputs, outputs)
    su, sy = standard_deviations(records)
    a = np.nan if transform == "none" else _check_pole(10.0 if pole is None else pole)
    past = max(10, -(-2 * order // len(outputs))) if past is None else past
    future = past if future is None else future
    _check_windows(order, past, future, len(outputs))
    stack, segments = gather(records, su, sy, past, a)
    _check_columns(stack, segments, records, a)
    Xi, _ = predictor_coefficients(stack, mask, regularisation, at_one=transform == "laguerre")
    dropped = mask if transform == "none" else np.ones_like(mask)
    discrete = realise(stack, Xi, order=order, future=future, feedthrough=dropped)
    dt = records[0].dt if transform == "none" else 1.0
    system, K = _unscaled(discrete, su, sy, dt, inputs, outputs)
    uncertainty = None
    if transform == "laguerre":
        system, K = from_laguerre(system, K, a)
        _check_unstable(system, a)
        if refine:
            pieces = [piece for record in records for piece, _ in _pieces(record, a)]
            data = spectra(pieces, su, sy, HIGHEST * a)
            refined, uncertainty = refine_black_box(system, data, su, sy, mask)
            K = carried_gain(system, K, refined, discrete.residual_covariance * np.outer(sy, sy))
            system = refined
    return BlackBox(
        system=system,
        K=K,
        singular_values=discrete.singular_values,
        pole=a,
        past=past,
        future=future,
        transform=transform,
        feedthrough=mask,
        input_std=su,
        output_std=sy,
        band=_band(records, a),
        records=tuple(record.name for record in records),
        regularisation=regularisation,
        segments=segments,
        uncertainty=uncertainty,
    )


def feedthrough_mask(
    feedthrough: Feedthrough, inputs: Sequence[str], outputs: Sequence[str]
) -> BoolArray:
    """(ny, nu) mask from True, False, the names of outputs with a direct term, or the mask."""
    shape = (len(outputs), len(inputs))
    if isinstance(feedthrough, bool):
        return np.full(shape, feedthrough)
    if isinstance(feedthrough, np.ndarray):
        if feedthrough.shape != shape:
            raise ValueError(f"feedthrough has shape {feedthrough.shape}, expected {shape}")
        return feedthrough.astype(bool)
    for name in feedthrough:
        if name not in outputs:
            raise ValueError(f"feedthrough names {name!r}, no output; they are {outputs}")
    return np.array([[name in feedthrough] * len(inputs) for name in outputs])


def excited_band(records: Sequence[Record]) -> tuple[float, float]:
    """Frequencies [rad/s] where every input is excited in one record at least.

    From two periods in the longest record to the frequency above which the input's spectrum (the
    largest over the records) stays 40 dB below its peak.
    """
    low = 2 * 2 * np.pi / max(record.duration for record in records)
    highs = []
    for j in range(records[0].nu):
        best = max(records, key=lambda record: float(np.std(record.u[:, j])))
        omega, power = _spectrum(best, j)
        above = omega[power > 1e-4 * power.max()]
        highs.append(float(above.max()) if len(above) else low)
    return float(low), float(max(min(highs), 2 * low))


def _band(records: Sequence[Record], a: float) -> tuple[float, float]:
    low, high = excited_band(records)
    return low, (high if np.isnan(a) else max(min(high, BAND_END * a), 2 * low))


def carried_gain(system: StateSpace, K: Array, refined: StateSpace, R: Array) -> Array:
    """Innovation gain of the refined model: the old one seen in its modes, made stabilising.

    The old gain, carried over by the modes' order, gives the process-noise covariance K R Kᵀ; the
    filter Riccati equation then returns the gain itself where A - KC is stable, and the stable one
    of the same spectrum where it is not.
    """
    lam_old, V_old = np.linalg.eig(system.A)
    lam, V = np.linalg.eig(refined.A)
    modal_gain = np.linalg.solve(V_old, K.astype(complex))
    size_old = np.linalg.norm(system.C @ V_old, axis=0)
    order = linear_sum_assignment(np.abs(lam[:, None] - lam_old[None]))[1]
    turned = np.sum((system.C @ V_old[:, order]).conj() * (refined.C @ V), axis=0)
    scale = turned / np.abs(turned) * size_old[order] / np.linalg.norm(refined.C @ V, axis=0)
    carried = np.real(V @ (scale.conj()[:, None] * modal_gain[order]))
    return riccati_gain(refined.A, refined.C, carried, R)


def riccati_gain(A: Array, C: Array, K: Array, R: Array) -> Array:
    """Stabilising continuous gain of process noise K R Kᵀ, correlated with the residuals."""
    R = R + 1e-9 * np.trace(R) / len(R) * np.eye(len(R))
    S = K @ R
    Q = K @ R @ K.T + 1e-9 * np.trace(K @ R @ K.T) / len(A) * np.eye(len(A))
    P = solve_continuous_are(A.T, C.T, Q, R, s=S)
    return np.asarray(np.linalg.solve(R, C @ P + S.T).T)


# ---- gathering the columns ----------------------------------------------------------------------


def gather(
    records: Sequence[Record], su: Array, sy: Array, past: int, a: float
) -> tuple[Stack, tuple[Segment, ...]]:
    """Triangular factor of the columns of all records; a constant per segment projected out.

    ``a`` is the Laguerre pole, NaN for the samples themselves.
    """
    nz = len(su) + len(sy)
    R: Array = np.zeros((0, (past + 1) * nz))
    count, segments = 0, []
    for record in records:
        for piece, interpolated in _pieces(record, a):
            blocks = (
                _sample_blocks(piece, su, sy, past)
                if np.isnan(a)
                else _laguerre_blocks(piece, su, sy, past, a)
            )
            part, n = accumulate(blocks, constant=True)
            used = n * piece.dt
            segments.append(
                Segment(
                    record=record.name, start=float(piece.t[0]), duration=piece.duration,
                    used=used, interpolated=interpolated,
                )
            )  # fmt: skip
            if n:
                R = triangular(np.vstack([R, part]))
                count += n
    return Stack(R, len(su), len(sy), past, count), tuple(segments)


def _laguerre_blocks(record: Record, su: Array, sy: Array, past: int, a: float) -> Iterator[Array]:
    v = np.hstack([record.u / su, record.y / sy])
    usable = int(np.searchsorted(record.t, record.t[-1] - support(a, past), side="right"))
    for start, block in project_blocks(record.t, v, a, past + 1, record.hold, BLOCK):
        if start < usable:
            rows = block[: usable - start]
            yield rows.reshape(len(rows), -1)


def _sample_blocks(record: Record, su: Array, sy: Array, past: int) -> Iterator[Array]:
    v = np.hstack([record.u / su, record.y / sy])
    windows = sliding_window_view(v, past + 1, axis=0) if len(v) > past else np.zeros((0, 1, 1))
    for start in range(0, len(windows), BLOCK):
        rows = (
            windows[start : start + BLOCK].transpose(0, 2, 1).reshape(-1, (past + 1) * v.shape[1])
        )
        yield rows[np.isfinite(rows).all(axis=1)]


def _pieces(record: Record, a: float) -> Iterator[tuple[Record, int]]:
    """Stretches of a record without long gaps, and how many samples were interpolated in each.

    On samples nothing is interpolated: columns that touch a missing sample are left out.
    """
    missing = np.isnan(record.y)
    if np.isnan(a):
        if not record.equidistant:
            raise ValueError(
                f'record {record.name!r} is not equidistant: transform="none" works on samples; '
                'use transform="laguerre" or resample the record'
            )
        yield record, 0
        return
    if not missing.any():
        yield record, 0
        return
    bad = _in_long_gap(record.t, missing, LONG_GAP / a)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], bad, [True]]).astype(int)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if end - start > 1:
            cut = slice(start, end)
            y = _interpolated(record.t[cut], record.y[cut])
            piece = replace(record, t=record.t[cut], u=record.u[cut], y=y)
            yield piece, int(missing[cut].sum())


def _in_long_gap(t: Array, missing: BoolArray, longest: float) -> BoolArray:
    """Samples in a gap of some channel that is longer than allowed, or at a record's end."""
    bad = np.zeros(len(t), dtype=bool)
    for column in missing.T:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            open_end = start == 0 or end == len(t)
            if open_end or t[end] - t[start - 1] > longest:
                bad[start:end] = True
    return bad


def _interpolated(t: Array, y: Array) -> Array:
    filled = y.copy()
    for column in filled.T:
        gap = np.isnan(column)
        if gap.any():
            column[gap] = np.interp(t[gap], t[~gap], column[~gap])
    return filled


def _spectrum(record: Record, j: int) -> tuple[Array, Array]:
    t = np.linspace(record.t[0], record.t[-1], record.N)
    u = np.interp(t, record.t, record.u[:, j])
    u = (u - u.mean()) * np.hanning(len(u))
    power = np.abs(np.fft.rfft(u)) ** 2
    omega = 2 * np.pi * np.fft.rfftfreq(len(u), t[1] - t[0])
    return omega[1:], power[1:]


# ---- checks -------------------------------------------------------------------------------------


def _unscaled(
    model: Realisation,
    su: Array,
    sy: Array,
    dt: float,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
) -> tuple[StateSpace, Array]:
    C, D = sy[:, None] * model.C, sy[:, None] * model.D / su
    return StateSpace(model.A, model.B / su, C, D, dt, inputs, outputs), model.K / sy


def _check_pole(a: float) -> float:
    if not (np.isfinite(a) and a > 0):
        raise ValueError(f"pole={a}: expected a Laguerre pole > 0 rad/s")
    return float(a)


def _check_windows(order: int, past: int, future: int, ny: int) -> None:
    if order < 1 or past < 2 or future < 1:
        raise ValueError(
            f"order={order}, past={past}, future={future}: "
            "expected order >= 1, past >= 2, future >= 1"
        )
    if order > min(past, future) * ny:
        raise ValueError(
            f"order {order} needs past and future of at least {-(-order // ny)} with {ny} outputs; "
            f"they are {past} and {future}"
        )


def _check_columns(
    stack: Stack, segments: Sequence[Segment], records: Sequence[Record], a: float
) -> None:
    unknowns = stack.past * stack.nz + stack.nu
    if stack.columns > unknowns:
        return
    longest = max(record.duration for record in records)
    window = (
        f"{stack.past + 1} samples" if np.isnan(a) else f"kernels of {support(a, stack.past):.2g} s"
    )
    shortest = min(segments, key=lambda segment: segment.used).record if segments else ""
    raise ValueError(
        f"record {shortest!r} is too short: {stack.columns} usable instants for {unknowns} "
        f"unknowns ({window}, longest record {longest:.3g} s); lower past, raise the pole or give "
        "longer records"
    )


def _check_unstable(system: StateSpace, a: float) -> None:
    fastest = float(system.poles().real.max())
    if fastest > 0.5 * a:
        warnings.warn(
            f"the black box has an unstable pole at {fastest:.2g} 1/s, near the Laguerre pole "
            f"a = {a:g} rad/s, which must exceed it clearly; raise pole",
            DataWarning,
            stacklevel=3,
        )
