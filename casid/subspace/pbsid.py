"""Predictor-based subspace identification of a black box from records, open or closed loop.

Source: M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", section 3.2. All records are one least-squares problem. Departures: the projections are
computed exactly from the samples (`casid.subspace.laguerre`), a constant per record is projected
out (residual trim), and the direct term may be masked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar, get_args

import numpy as np

from casid.arrays import Array
from casid.checks import checked_fields
from casid.errors import warn
from casid.excitations import excitation_if_any
from casid.linear import StateSpace
from casid.record import Record
from casid.records import Records, check_moved
from casid.stuck_channels import frozen
from casid.subspace import settings as choice
from casid.subspace.blackbox import BlackBox
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.candidates import Candidate, OrderSelection, Refinement
from casid.subspace.columns import Feedthrough, Segment, check_pole
from casid.subspace.feedback import direct_term_is_ambiguous
from casid.subspace.poles import PASTS
from casid.subspace.prediction import SampledUncertainty
from casid.subspace.refinement_choice import Estimate, refine_projected, refine_sampled
from casid.subspace.response_distance import missed_of_samples
from casid.subspace.sampled import (
    ORDERS,
    Stretches,
    are_candidates,
    choose_samples,
    usual_windows,
)
from casid.subspace.trust import Missed
from casid.threads import one_thread
from casid.values import storable

__all__ = ["BlackBox", "Pbsid", "pbsid"]

T = TypeVar("T")
Transform = Literal["laguerre", "none"]

PAST = 10  # samples at least, for the samples themselves
RAISED = 4  # states more than the criterion says, where a mode is missed
CLEARLY = 0.95  # of what projections leave unexplained: models of samples that leave less are taken


@checked_fields
@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class Pbsid:
    """Settings of `pbsid`; what is None is chosen from the records.

    Parameters
    ----------
    order : int
        Number of states.
    past, future : int
        Window lengths: Laguerre functions or samples; the future is as long as the past unless
        given. On samples, with an order given, the past is 10 or 2 order/ny, whichever is larger.
    pole : float
        Laguerre pole a [rad/s] of the projections, faster than any unstable pole.
    feedthrough : bool, (ny, nu) bool array or sequence of output names
        Where a direct term is allowed. On samples a masked entry is left out of the regressions;
        on projected data the response at infinite frequency is made zero there.
    transform : {"laguerre", "none"}
        Project the data on Laguerre functions (a continuous model), or use the samples themselves
        (a discrete model; equidistant records of one interval). Unless this or the pole is given,
        samples are tried where records are sampled hardly faster than their inputs move
        (`casid.subspace.sampled`), and taken where they clearly predict better what was held out.
    regularisation : float
        Tikhonov factor of the regression, relative to its largest singular value.
    refine : bool
        Move the subspace model to the maximum likelihood, with the direct term zero where it is
        masked: on projections of the records' Fourier transforms (`casid.subspace.refinement`) or,
        where a controller feeds so much noise back into the inputs that these would be biased
        (`casid.subspace.feedback`), of prediction errors; on samples of prediction errors
        (`casid.subspace.prediction`), or, where the order is chosen, by what predicts best: those,
        B, K and D alone, or simulation errors of constant or of local size, with K = 0 (none of
        these with more than eight outputs, where the subspace estimate stays as it is). Only a
        maximum of the likelihood has a covariance. A mode that would grow by two e-folds at most
        over the longest record, uncertain by more than that, hardly decays: these records do not
        tell, and the simpler model is stable.
    """

    order: int | None = None
    past: int | None = None
    future: int | None = None
    pole: float | None = None
    feedthrough: Feedthrough = True
    transform: Transform | None = None
    regularisation: float | None = None
    refine: bool = True

    def __post_init__(self) -> None:
        if self.transform not in (None, *get_args(Transform)):
            raise ValueError(f'transform={self.transform!r}, expected "laguerre" or "none"')
        if self.refine not in (True, False):
            raise ValueError(f"refine={self.refine!r}, expected True or False")
        for name, least in (("order", 1), ("past", 2), ("future", 1), ("regularisation", 0)):
            if (value := getattr(self, name)) is not None and not least <= value < np.inf:
                raise ValueError(f"{name} = {value}, expected at least {least}, and finite")
        if self.pole is None:
            return
        if not (np.isfinite(self.pole) and self.pole > 0):
            raise ValueError(f"pole={self.pole}: expected a Laguerre pole > 0 rad/s")
        if self.transform == "none":
            raise ValueError(
                f'pole={self.pole:g} belongs to Laguerre functions, transform="none" uses the '
                "samples themselves: leave one of them out"
            )

    def like(self, found: BlackBox) -> "Pbsid":
        """The settings with those in place that were chosen for a black box of projections.

        What was chosen for one of samples is left to be chosen again.
        """
        if found.transform != "laguerre":
            return self
        own: Any = {name: getattr(found, name) for name in ("past", "future", "pole")}
        return replace(self, order=len(found.system.A), regularisation=found.regularisation, **own)

    @one_thread
    def fit(self, records: Records) -> BlackBox:
        """Black box of one record or several; see `pbsid`."""
        campaign = Campaign.of(records, self.feedthrough)
        check_moved(campaign.records)
        if self.transform == "none":
            return self._sampled(campaign, *self._sample_settings(campaign))
        try:
            projected = self._projected(campaign)
        except ValueError:
            if not self._may_sample(campaign):
                raise
            return self._sampled(campaign, *self._sample_settings(campaign))
        if not self._may_sample(campaign, projected.system):
            return projected
        return self._better(campaign, projected)

    def _projected(self, campaign: Campaign) -> BlackBox:
        """Black box of projections, settings that were not given chosen."""
        order, past, pole, factor = self.order, self.past, self.pole, self.regularisation
        selection = None
        if pole is not None:
            check_pole(campaign.records, pole)
        if order is None or past is None or pole is None:
            grid = choice.Grid(_said(order), _said(past), _said(pole), _said(factor))
            selection = choice.choose_projections(campaign, grid)
            settings = selection.chosen
        else:
            factor = 1e-3 if factor is None else factor
            settings = Candidate.of(order, Windows(past, past, float(pole), factor))
        estimate = self._refined(campaign, settings)
        while order is None and selection and estimate.missed and not len(estimate.doubtful):
            if estimate.missed.order > selection.chosen.order + RAISED:
                break
            raised = replace(settings, order=estimate.missed.order)
            richer = self._refined(campaign, raised)
            if type(richer.uncertainty) is not type(estimate.uncertainty):
                break  # prediction errors, which it did not call for before: the doubt remains
            settings, estimate = raised, richer
        _check_unstable(estimate.system, settings.pole)
        _check_used(campaign.records, campaign.segments(settings.past, settings.pole))
        if selection and settings != selection.chosen:
            selection = replace(selection, chosen=settings)
        return self._black_box(campaign, settings, estimate, selection)

    def _refined(self, campaign: Campaign, settings: Candidate) -> Estimate:
        windows = self._windows(settings, len(campaign.sy))
        found = campaign.subspace(settings.order, windows)
        move, pole = self.refine, settings.pole
        chosen = self.order is None
        return refine_projected(campaign, found, pole, move=move, windows=windows, chosen=chosen)

    def _better(self, campaign: Campaign, own: BlackBox) -> BlackBox:
        """The black box of projections, or of samples if that predicts clearly better."""
        windows = Windows(own.past, own.future, own.pole, own.regularisation)
        rival = Stretches.of(campaign).score(own.order, windows, "fourier")
        bound = CLEARLY * rival.score if rival else 1.0
        tried, best = self._sample_candidates(campaign, bound)
        if best is None or best.score > bound:
            return own
        selection = self._selection(campaign, [*tried, rival] if rival else tried, best)
        return self._sampled(campaign, selection.chosen, selection)

    def _sample_candidates(
        self, campaign: Campaign, bound: float = np.inf
    ) -> tuple[list[Candidate], Candidate | None]:
        regularisation = self.regularisation or 0.0
        channels = len(campaign.su) + len(campaign.sy)
        pasts = usual_windows(channels) if self.past is None else (self.past,)
        orders = ORDERS if self.order is None else (self.order,)
        windows = [Windows(p, self.future or p, np.nan, regularisation) for p in pasts]
        return choose_samples(campaign, orders, windows, move=self.refine, bound=bound)

    def _sample_settings(self, campaign: Campaign) -> tuple[Candidate, OrderSelection | None]:
        """Settings on samples; chosen unless an order is given."""
        if self.order is not None:
            past = self.past or max(PAST, -(-2 * self.order // len(campaign.sy)))
            how: Refinement = "prediction" if self.refine else "unrefined"
            windows = Windows(past, past, np.nan, self.regularisation or 0.0)
            return Candidate.of(self.order, windows, how), None
        tried, best = self._sample_candidates(campaign)
        if best is None:
            raise ValueError(
                "no black box of samples can be judged on stretches held out: the records are too "
                "short, or the aircraft is too unstable to be simulated; give an order"
            )
        selection = self._selection(campaign, tried, best)
        return selection.chosen, selection

    def _selection(
        self, campaign: Campaign, tried: list[Candidate], best: Candidate
    ) -> OrderSelection:
        told = choice.with_errors(tried)
        found = campaign.subspace(best.order, best.windows)
        return OrderSelection(
            chosen=told[tried.index(best)],
            candidates=tuple(told),
            criterion="held-out stretches",
            singular_values=found.singular_values,
        )

    def _sampled(
        self, campaign: Campaign, settings: Candidate, chosen: OrderSelection | None
    ) -> BlackBox:
        """Black box of samples."""
        found = campaign.subspace(settings.order, self._windows(settings, len(campaign.sy)))
        stack = campaign.stack(settings.past, settings.pole)
        if campaign.mask.any() and direct_term_is_ambiguous(stack):
            _warn_direct_term(np.array(found.system.outputs)[campaign.mask.any(axis=1)])
        estimate = refine_sampled(campaign, found, settings.refinement)
        missed = self._missed(campaign, settings, estimate)
        while chosen and missed and missed.order <= chosen.chosen.order + RAISED:
            settings = replace(settings, order=missed.order)
            found = campaign.subspace(settings.order, settings.windows)
            estimate = refine_sampled(campaign, found, settings.refinement)
            missed = self._missed(campaign, settings, estimate)
        if chosen and settings != chosen.chosen:
            chosen = replace(chosen, chosen=settings)
        return self._black_box(campaign, settings, replace(estimate, missed=missed), chosen)

    def _missed(self, campaign: Campaign, settings: Candidate, found: Estimate) -> Missed | None:
        """What a model of samples refined by prediction errors misses that two more states show."""
        if not isinstance(found.uncertainty, SampledUncertainty):
            return None
        try:
            windows = self._windows(replace(settings, order=settings.order + 2), len(campaign.sy))
            start = campaign.subspace(settings.order + 2, windows)
            other = refine_sampled(campaign, start, "prediction")
        except (ValueError, np.linalg.LinAlgError):
            return None
        if not isinstance(other.uncertainty, SampledUncertainty):
            return None
        scales, band = (campaign.su, campaign.sy), campaign.band(settings.pole)
        richer = other.system, other.uncertainty
        return missed_of_samples(
            found.system, found.uncertainty, richer, campaign.records, *scales, band
        )

    def check_lengths(self, records: Sequence[Record]) -> None:
        """ValueError: windows, or those that the order needs, are longer than records allow."""
        longest = max(records, key=lambda record: record.N)
        needed = -(-(self.order or 0) // longest.ny)  # samples, or Laguerre functions
        for name, length in {"past": self.past, "future": self.future, "order": needed}.items():
            if length is not None and length >= longest.N:
                value = self.order if name == "order" else length
                raise ValueError(
                    f"{name} = {value} needs a window of {length}, and the longest record, "
                    f"{longest.name!r}, has {longest.N} samples; lower it"
                )
        window = min(self.past or max(PASTS), self.future or longest.N)
        if self.transform == "none" or needed <= window:
            return
        if not self._may_sample(Campaign.of(records, self.feedthrough)):
            choice.refuse_order(self.order, longest.ny, window)

    def _may_sample(self, campaign: Campaign, projected: StateSpace | None = None) -> bool:
        """Whether a model of samples, with windows of its own, may take that of projections."""
        return (self.transform or self.pole) is None and are_candidates(campaign, projected)

    def _windows(self, settings: Candidate, ny: int) -> Windows:
        """The windows asked for, checked."""
        order, past, future = settings.order, settings.past, self.future or settings.past
        if order > min(past, future) * ny:
            raise ValueError(
                f"order {order} needs past and future of at least {-(-order // ny)} with {ny} "
                f"outputs; they are {past} and {future}"
            )
        return Windows(past, future, settings.pole, settings.regularisation)

    def _black_box(
        self,
        campaign: Campaign,
        settings: Candidate,
        estimate: Estimate,
        selection: OrderSelection | None,
    ) -> BlackBox:
        windows = self._windows(settings, len(campaign.sy))
        projected = not np.isnan(settings.pole)
        remarks = [
            f"Record {record.name}: {stretch.told()}."
            for record in campaign.records
            for stretch in frozen(record)
            if not stretch.dart  # a stick may be moved so
        ]
        remarks += [estimate.fault.told()] if estimate.fault else []
        remarks += [estimate.remark] if estimate.remark else []
        causal = isinstance(estimate.uncertainty, SampledUncertainty)
        return BlackBox(
            system=estimate.system, K=estimate.K,
            singular_values=campaign.subspace(settings.order, windows).singular_values,
            pole=settings.pole, past=windows.past, future=windows.future,
            transform="laguerre" if projected else "none", feedthrough=campaign.mask,
            input_std=campaign.su, output_std=campaign.sy, band=campaign.band(settings.pole),
            records=tuple(record.name for record in campaign.records),
            regularisation=settings.regularisation,
            segments=campaign.segments(windows.past, windows.pole),
            uncertainty=estimate.uncertainty, selection=selection, explained=estimate.explained,
            doubtful=estimate.doubtful, missed=estimate.missed,
            refinement="prediction" if causal else settings.refinement,
            hold=campaign.records[0].hold,
            excitation=excitation_if_any(campaign.records, campaign.direct),
            remarks=tuple(remarks), biased=bool(estimate.remark),
            interval=float(np.median(np.concatenate([np.diff(r.t) for r in campaign.records]))),
        )  # fmt: skip


def pbsid(
    records: Records,
    *,
    order: int | None = None,
    past: int | None = None,
    future: int | None = None,
    pole: float | None = None,
    feedthrough: Feedthrough = True,
    transform: Transform | None = None,
    regularisation: float | None = None,
    refine: bool = True,
) -> BlackBox:
    """Identify a black box from the time histories of one or several manoeuvres.

    Parameters
    ----------
    records : Record or sequence of Record
        Same channels; lengths and sampling may differ. Missing outputs (NaN) are interpolated
        linearly over short gaps and split the record at long ones; the result counts both.
    order, past, future, pole, feedthrough, transform, regularisation, refine
        See `Pbsid`.

    Raises
    ------
    ValueError
        Records too short for the windows, an order they cannot give, unequal channels; samples of
        several intervals, or a Laguerre pole, with ``transform="none"``.
    """
    return Pbsid(
        order=order, past=past, future=future, pole=pole, feedthrough=feedthrough,
        transform=transform, regularisation=regularisation, refine=refine,
    ).fit(records)  # fmt: skip


def _said(value: T | None) -> list[T]:
    """What there is to choose from if a value is given; nothing if not."""
    return [] if value is None else [value]


def _check_unstable(system: StateSpace, a: float) -> None:
    fastest = float(system.poles().real.max())
    if fastest > 0.5 * a:
        warn(
            f"the black box has an unstable pole at {fastest:.2g} 1/s, near the Laguerre pole "
            f"a = {a:g} rad/s, which must exceed it clearly; raise pole"
        )


def _check_used(records: Sequence[Record], segments: tuple[Segment, ...]) -> None:
    """Warn of records that gave nothing."""
    used = {record.name: 0.0 for record in records}
    for each in segments:
        used[each.record] += each.used
    if idle := [name for name, seconds in used.items() if seconds == 0]:
        warn(
            f"nothing of record {', '.join(idle)} is used: between its long gaps (NaN) it is "
            "shorter than the Laguerre kernels; raise the pole, lower past, or repair the record"
        )


def _warn_direct_term(outputs: Array) -> None:
    warn(
        "the records show feedback, and inputs go with outputs of the same sample: direct terms "
        f"of {', '.join(outputs)} cannot be told from the controller's and may be badly biased; "
        "if the aircraft has none, say so (feedthrough=False or the outputs that have one)"
    )
