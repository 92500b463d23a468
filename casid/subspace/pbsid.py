"""Predictor-based subspace identification of a black box from records, open or closed loop.

Source: M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", section 3.2. All records are one least-squares problem over the stacked columns of all
of them. Departures: the projections are computed exactly from the samples
(`casid.subspace.laguerre`), a constant per record is projected out (residual trim), and the direct
term may be masked.
"""

from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar, get_args

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.errors import warn
from casid.linear import StateSpace, from_zoh
from casid.record import Hold, Records
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.columns import Feedthrough, Segment
from casid.subspace.feedback import direct_term_is_ambiguous
from casid.subspace.held import undiscretised
from casid.subspace.prediction import SampledUncertainty
from casid.subspace.refinement import ResponseUncertainty
from casid.subspace.refining import Estimate, refine_projected, refine_sampled
from casid.subspace.sampled import ORDERS, WINDOWS, Stretches, are_candidates, choose_samples
from casid.subspace.settings import (
    Candidate,
    Grid,
    OrderSelection,
    Refinement,
    best_of,
    choose_projections,
    with_errors,
)
from casid.subspace.trust import data_doubts, growth_doubts
from casid.threads import one_thread
from casid.values import storable

T = TypeVar("T")
Transform = Literal["laguerre", "none"]

PAST = 10  # samples at least, for the samples themselves
CLEARLY = 0.95  # of what projections leave unexplained: models of samples that leave less are taken


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
        Covariance of a black box refined to maximum likelihood; see `response_std`.
    selection : OrderSelection or None
        How the settings were chosen from data, if they were.
    explained : (ny,) array or None
        Share of each output's power explained at a typical frequency of the band; None unless
        refined by Fourier transforms.
    doubtful : complex array
        Growing modes that the likelihood does not need.
    refinement : str
        What followed the subspace estimate: "unrefined", "fourier" on projections; on samples
        "linear", "prediction", "simulation" or "local simulation", see `Pbsid`.
    hold : {"foh", "zoh"}
        What the inputs of a discrete black box do between samples.
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
    uncertainty: ResponseUncertainty | SampledUncertainty | None = None
    selection: OrderSelection | None = None
    explained: Array | None = None
    doubtful: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    refinement: str = "unrefined"
    hold: Hold = "zoh"

    def doubts(self) -> tuple[str, ...]:
        """Why the records do not support a model, or some mode of it; empty where they do.

        Empty, too, where it is not known: without refinement, and on samples.
        """
        growth = growth_doubts(self.doubtful)
        if self.explained is None:
            return growth
        return (*data_doubts(self.explained, self.system.outputs), *growth)

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
                f"this black box ({self.refinement}) has no uncertainty: only one refined to "
                'maximum likelihood has; call pbsid with refine=True and transform="laguerre"'
            )
        return self.uncertainty.response_std(np.asarray(omega, dtype=float))

    @property
    def order(self) -> int:
        """Number of states."""
        return self.system.nx

    def continuous(self) -> "BlackBox":
        """The continuous equivalent of a discrete black box, for its inputs' hold.

        The gain K keeps the predictor's poles: A - KC is mapped by the same matrix logarithm.

        Raises
        ------
        ValueError
            A discrete pole on the negative real axis, which has no continuous equivalent.
        """
        system = self.system
        if system.dt is None:
            return self
        found = undiscretised(system, self.hold)
        predictor, _ = from_zoh(system.A - self.K @ system.C, system.B, system.dt)
        K = np.linalg.lstsq(system.C.T, (found.A - predictor).T, rcond=None)[0].T
        return replace(self, system=found, K=K)


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
        B, K and D alone, or simulation errors of constant or of local size, with K = 0. Only a
        maximum of the likelihood has a covariance.
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
        if self.pole is None:
            return
        if not (np.isfinite(self.pole) and self.pole > 0):
            raise ValueError(f"pole={self.pole}: expected a Laguerre pole > 0 rad/s")
        if self.transform == "none":
            raise ValueError(
                f'pole={self.pole:g} belongs to Laguerre functions, transform="none" uses the '
                "samples themselves: leave one of them out"
            )

    @one_thread
    def fit(self, records: Records) -> BlackBox:
        """Black box of one record or several; see `pbsid`."""
        campaign = Campaign.of(records, self.feedthrough)
        if self.transform == "none":
            return self._sampled(campaign, *self._sample_settings(campaign))
        free = self.transform is None and self.pole is None
        try:
            projected = self._projected(campaign)
        except ValueError:
            if not (free and are_candidates(campaign, None)):
                raise
            return self._sampled(campaign, *self._sample_settings(campaign))
        if not (free and are_candidates(campaign, projected.system)):
            return projected
        return self._better(campaign, projected)

    def _projected(self, campaign: Campaign) -> BlackBox:
        """Black box of projections, settings that were not given chosen."""
        order, past, pole, factor = self.order, self.past, self.pole, self.regularisation
        selection = None
        if order is None or past is None or pole is None:
            grid = Grid(_said(order), _said(past), _said(pole), _said(factor))
            selection = choose_projections(campaign, grid)
            settings = selection.chosen
        else:
            factor = 1e-3 if factor is None else factor
            settings = Candidate(order=order, past=past, pole=float(pole), regularisation=factor)
        found = campaign.subspace(settings.order, self._windows(settings, len(campaign.sy)))
        _check_unstable(found.system, settings.pole)
        _check_used(campaign.segments(settings.past, settings.pole))
        estimate = refine_projected(campaign, found, settings.pole, move=self.refine)
        return self._black_box(campaign, settings, estimate, selection)

    def _better(self, campaign: Campaign, projected: BlackBox) -> BlackBox:
        """The black box of projections, or of samples if that predicts clearly better."""
        tried = self._sample_candidates(campaign)
        best = best_of(tried)
        own = projected
        windows = Windows(own.past, own.future, own.pole, own.regularisation)
        rival = Stretches.of(campaign).score(own.order, windows, "fourier")
        if best.score > (CLEARLY * rival.score if rival else 1.0):
            return projected
        return self._sampled(campaign, best, self._selection(campaign, tried, rival))

    def _sample_candidates(self, campaign: Campaign) -> list[Candidate]:
        regularisation = self.regularisation or 0.0
        pasts = WINDOWS if self.past is None else (self.past,)
        orders = ORDERS if self.order is None else (self.order,)
        windows = [Windows(p, self.future or p, np.nan, regularisation) for p in pasts]
        return choose_samples(campaign, orders, windows, move=self.refine)

    def _sample_settings(self, campaign: Campaign) -> tuple[Candidate, OrderSelection | None]:
        """Settings on samples; chosen unless an order is given."""
        if self.order is not None:
            past = self.past or max(PAST, -(-2 * self.order // len(campaign.sy)))
            how: Refinement = "prediction" if self.refine else "unrefined"
            given = Candidate(
                order=self.order, past=past, pole=np.nan, refinement=how,
                regularisation=self.regularisation or 0.0,
            )  # fmt: skip
            return given, None
        tried = self._sample_candidates(campaign)
        if not tried:
            raise ValueError(
                "no black box of samples can be judged on stretches held out: the records are too "
                "short, or the aircraft is too unstable to be simulated; give an order"
            )
        return best_of(tried), self._selection(campaign, tried, None)

    def _selection(
        self, campaign: Campaign, tried: list[Candidate], rival: Candidate | None
    ) -> OrderSelection:
        all_tried = with_errors([*tried, rival] if rival else tried)
        best = best_of(all_tried)
        found = campaign.subspace(best.order, best.windows)
        return OrderSelection(
            chosen=best,
            candidates=tuple(all_tried),
            criterion="held-out stretches",
            singular_values=found.singular_values,
        )

    def _sampled(
        self, campaign: Campaign, settings: Candidate, selection: OrderSelection | None
    ) -> BlackBox:
        """Black box of samples."""
        found = campaign.subspace(settings.order, self._windows(settings, len(campaign.sy)))
        stack = campaign.stack(settings.past, settings.pole)
        if campaign.mask.any() and direct_term_is_ambiguous(stack):
            _warn_direct_term(np.array(found.system.outputs)[campaign.mask.any(axis=1)])
        estimate = refine_sampled(campaign, found, settings.refinement)
        return self._black_box(campaign, settings, estimate, selection)

    def _windows(self, settings: Candidate, ny: int) -> Windows:
        """The windows asked for, checked."""
        order, past, future = settings.order, settings.past, self.future or settings.past
        if order < 1 or past < 2 or future < 1:
            raise ValueError(
                f"order={order}, past={past}, future={future}: "
                "expected order >= 1, past >= 2, future >= 1"
            )
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
        return BlackBox(
            system=estimate.system,
            K=estimate.K,
            singular_values=campaign.subspace(settings.order, windows).singular_values,
            pole=settings.pole,
            past=windows.past,
            future=windows.future,
            transform="laguerre" if projected else "none",
            feedthrough=campaign.mask,
            input_std=campaign.su,
            output_std=campaign.sy,
            band=campaign.band(settings.pole),
            records=tuple(record.name for record in campaign.records),
            regularisation=settings.regularisation,
            segments=campaign.segments(windows.past, windows.pole),
            uncertainty=estimate.uncertainty,
            selection=selection,
            explained=estimate.explained,
            doubtful=estimate.doubtful,
            refinement=settings.refinement,
            hold=campaign.records[0].hold,
        )


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


def _check_used(segments: tuple[Segment, ...]) -> None:
    """Warn of records that gave nothing."""
    used = {each.record: 0.0 for each in segments}
    for each in segments:
        used[each.record] += each.used
    if idle := [name for name, seconds in used.items() if seconds == 0]:
        warn(
            f"nothing of record {', '.join(idle)} is used: between its long gaps (NaN) it is "
            "shorter than the Laguerre kernels; raise the pole, lower past, or repair the record"
        )


def _warn_direct_term(outputs: Array) -> None:
    warn(
        "the records show feedback, and present inputs that go with present outputs: a direct term "
        f"of {', '.join(outputs)} cannot be told from one of the controller and may be badly "
        "biased; if the aircraft has none, say so (feedthrough=False or the outputs that have one)"
    )
