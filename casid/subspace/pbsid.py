"""Predictor-based subspace identification of a black box from records, open or closed loop.

Source: M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", section 3.2. All records are one least-squares problem over the stacked columns of all
of them. Departures: the projections are computed exactly from the samples
(`casid.subspace.laguerre`), a constant per record is projected out (residual trim), and the direct
term may be masked.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from casid.arrays import Array, BoolArray
from casid.errors import DataWarning
from casid.linear import StateSpace, from_zoh
from casid.record import Record, Records, same_channels, standard_deviations, stretches
from casid.subspace.columns import (
    Feedthrough,
    Segment,
    excited_band,
    feedthrough_mask,
    gather,
)
from casid.subspace.feedback import direct_term_is_ambiguous
from casid.subspace.laguerre import support
from casid.subspace.predictor import Stack
from casid.subspace.realisation import subspace_model
from casid.subspace.refining import Noise, Refine, Refinement, Uncertainty
from casid.subspace.settings import OrderSelection, select_order
from casid.subspace.trust import data_doubts
from casid.values import storable

Transform = Literal["laguerre", "none"]

PAST = 10  # samples at least, for the samples themselves
BAND_END = 1.5  # of the Laguerre pole: the model is not trusted above it


@storable
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
    uncertainty : ResponseUncertainty, SampledUncertainty or None
        Covariance of a refined black box; see `response_std`.
    selection : OrderSelection or None
        How the settings were chosen from data, if they were.
    explained : (ny,) array or None
        Share of each output's power explained at a typical frequency of the band; None unless
        refined by Fourier transforms.
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
    uncertainty: Uncertainty = None
    selection: OrderSelection | None = None
    explained: Array | None = None

    def doubts(self) -> tuple[str, ...]:
        """Why the records do not support a model; empty where they do, or where it is not known."""
        return () if self.explained is None else data_doubts(self.explained, self.system.outputs)

    def response_std(self, omega: Array) -> tuple[Array, Array]:
        """Relative standard deviation of abs(G) and standard deviation of its phase [rad].

        Both (K, ny, nu). They hold what noise, and whatever else the linear model cannot follow,
        does to the estimate of a model of this order; not the error of a wrong order.

        Raises
        ------
        ValueError
            The black box was not refined, or not to maximum likelihood.
        """
        if self.uncertainty is None:
            raise ValueError(
                "this black box has no uncertainty: only one refined to maximum likelihood has; "
                "call pbsid with refine=True"
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
    records: Records,
    *,
    order: int | None = None,
    past: int | None = None,
    future: int | None = None,
    pole: float | None = None,
    feedthrough: Feedthrough = True,
    transform: Transform = "laguerre",
    regularisation: float | None = None,
    refine: Refine = True,
    noise: Noise = "constant",
) -> BlackBox:
    """Identify a black box from the time histories of one or several manoeuvres.

    Parameters
    ----------
    records : sequence of Record
        Same channels; lengths and sampling may differ. Missing outputs (NaN) are interpolated
        linearly over short gaps and split the record at long ones; the result counts both.
    order : int
        Number of states. Chosen by `select_order` unless given, like ``past``, ``pole`` and
        ``regularisation``; with ``transform="none"`` it must be given.
    past, future : int
        Window lengths: Laguerre functions or samples; the future is as long as the past unless
        given. On samples the past is 10 or 2 order/ny, whichever is larger, unless given.
    pole : float
        Laguerre pole a [rad/s], faster than any unstable pole.
    feedthrough : bool, (ny, nu) bool array or sequence of output names
        Where a direct term is allowed. On samples a masked entry is left out of the regressions;
        on projected data the response at infinite frequency is made zero there.
    transform : {"laguerre", "none"}
        Project the data on Laguerre functions (a continuous model), or use the samples themselves
        (a discrete model; equidistant records).
    regularisation : float
        Tikhonov factor of the regression, relative to its largest singular value.
    refine : bool or {"linear", "simulation"}
        Move the subspace model to the maximum likelihood: on samples of the prediction errors
        (`casid.subspace.prediction`), on projections of the records' Fourier transforms
        (`casid.subspace.refinement`), with the direct term zero where it is masked; without it a
        masked direct term is only made small. Where a controller feeds so much noise back into the
        inputs that their transforms would be biased (`casid.subspace.feedback`), prediction errors
        follow. On samples only: "linear" moves B, K and D alone (`casid.subspace.regression`);
        "simulation" minimises simulation errors (`casid.subspace.simulation`), for a stable system
        in open loop whose model is to simulate, and K is zero then. Neither gives a covariance.
    noise : {"constant", "local"}
        On samples: whether the errors that the refinement minimises are of one size throughout, or
        are divided by their local level, for amplitudes that vary much and errors that follow.

    Returns
    -------
    BlackBox

    Raises
    ------
    ValueError
        Records too short for the windows, an order they cannot give, unequal channels.
    """
    records = stretches(records)
    inputs, outputs = same_channels(records)
    if transform not in get_args(Transform):
        raise ValueError(f'transform={transform!r}, expected "laguerre" or "none"')
    _check_refine(refine, noise, transform)
    mask = feedthrough_mask(feedthrough, inputs, outputs)
    if transform == "none":
        settings = _sample_settings(order, past, regularisation, len(outputs))
    else:
        settings = _chosen(records, order, past, pole, regularisation, feedthrough)
    future = settings.past if future is None else future
    _check_windows(settings.order, settings.past, future, len(outputs))
    su, sy = standard_deviations(records)
    stack, segments = gather(records, su, sy, settings.past, settings.pole)
    _check_columns(stack, segments, records, settings.pole)
    found = subspace_model(
        stack, su, sy, settings.pole, order=settings.order, future=future, feedthrough=mask,
        regularisation=settings.regularisation, dt=records[0].dt,
    )  # fmt: skip
    start = replace(found.system, inputs=inputs, outputs=outputs)
    band = _band(records, settings.pole)
    task = Refinement(records, su, sy, mask, settings.pole, band, found.residual_covariance, noise)
    if transform == "none":
        if mask.any() and direct_term_is_ambiguous(stack):
            _warn_direct_term(np.array(outputs)[mask.any(axis=1)])
        starts = [(start, found.K)]
        if refine == "simulation":
            starts += _other_start(task, settings, start)
        system, K, uncertainty, explained = task.samples(starts, refine)
    else:
        _check_unstable(start, settings.pole)
        system, K, uncertainty, explained = task.projections(start, found.K, bool(refine))
    return BlackBox(
        system=system,
        K=K,
        singular_values=found.singular_values,
        pole=settings.pole,
        past=settings.past,
        future=future,
        transform=transform,
        feedthrough=mask,
        input_std=su,
        output_std=sy,
        band=band,
        records=tuple(record.name for record in records),
        regularisation=settings.regularisation,
        segments=segments,
        uncertainty=uncertainty,
        selection=settings.selection,
        explained=explained,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Settings:
    order: int
    past: int
    pole: float
    regularisation: float
    selection: OrderSelection | None = None


def _sample_settings(
    order: int | None, past: int | None, regularisation: float | None, ny: int
) -> _Settings:
    if order is None:
        raise ValueError('transform="none" needs an order; the choice from data is for projections')
    past = max(PAST, -(-2 * order // ny)) if past is None else past
    return _Settings(order=order, past=past, pole=np.nan, regularisation=regularisation or 0.0)


def _other_start(
    task: Refinement, settings: _Settings, like: StateSpace
) -> list[tuple[StateSpace, Array]]:
    """Model and gain of half the window; none where that is too short for the order."""
    past = settings.past // 2
    if past < 2 or settings.order > past * like.ny:
        return []
    stack, _ = gather(task.records, task.su, task.sy, past, settings.pole)
    try:
        found = subspace_model(
            stack, task.su, task.sy, settings.pole, order=settings.order, future=past,
            feedthrough=task.mask, regularisation=settings.regularisation,
            dt=task.records[0].dt,
        )  # fmt: skip
    except (ValueError, np.linalg.LinAlgError):  # the window asked for gave a model
        return []
    return [(replace(found.system, inputs=like.inputs, outputs=like.outputs), found.K)]


def _chosen(
    records: Sequence[Record],
    order: int | None,
    past: int | None,
    pole: float | None,
    regularisation: float | None,
    feedthrough: Feedthrough,
) -> _Settings:
    """What the user said, and the choice from data for the rest."""
    if pole is not None and not (np.isfinite(pole) and pole > 0):
        raise ValueError(f"pole={pole}: expected a Laguerre pole > 0 rad/s")
    if order is not None and past is not None and pole is not None:
        return _Settings(
            order=order, past=past, pole=float(pole),
            regularisation=1e-3 if regularisation is None else regularisation,
        )  # fmt: skip
    selection = select_order(
        records,
        orders=None if order is None else [order],
        pasts=None if past is None else [past],
        poles=None if pole is None else [pole],
        regularisations=None if regularisation is None else [regularisation],
        feedthrough=feedthrough,
    )
    best = selection.chosen
    return _Settings(
        order=best.order, past=best.past, pole=best.pole, regularisation=best.regularisation,
        selection=selection,
    )  # fmt: skip


def _band(records: Sequence[Record], a: float) -> tuple[float, float]:
    low, high = excited_band(records)
    return low, (high if np.isnan(a) else max(min(high, BAND_END * a), 2 * low))


# ---- checks -------------------------------------------------------------------------------------


def _check_refine(refine: Refine, noise: Noise, transform: str) -> None:
    if noise not in get_args(Noise):
        raise ValueError(f'noise={noise!r}, expected "constant" or "local"')
    if noise == "local" and (transform != "none" or refine in (False, "linear")):
        raise ValueError(
            'noise="local" weighs the errors of samples: it needs transform="none" and refine=True '
            'or "simulation"'
        )
    if refine not in (True, False, "linear", "simulation"):
        raise ValueError(f'refine={refine!r}, expected True, False, "linear" or "simulation"')
    if refine in ("linear", "simulation") and transform != "none":
        raise ValueError(
            f'refine="{refine}" is for samples (transform="none"); projections are refined by '
            "Fourier transforms of whole records, which refine=True does"
        )


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


def _warn_direct_term(outputs: Array) -> None:
    warnings.warn(
        "the records show feedback, and present inputs that go with present outputs: a direct term "
        f"of {', '.join(outputs)} cannot be told from one of the controller and may be badly "
        "biased; if the aircraft has none, say so (feedthrough=False or the outputs that have one)",
        DataWarning,
        stacklevel=3,
    )
