"""What follows the subspace estimate: which likelihood, and whether a controller spoils it."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.errors import warn
from casid.linear import StateSpace
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.candidates import Refinement
from casid.subspace.channel_faults import Fault, disagreement
from casid.subspace.feedback import fed_back, fed_back_noise
from casid.subspace.fourier import Spectrum
from casid.subspace.gain import carried_gain, riccati_gain
from casid.subspace.held_inputs import refine_held
from casid.subspace.prediction import SampledUncertainty, refine_samples
from casid.subspace.realisation import Subspace
from casid.subspace.refinement import ResponseUncertainty, refine, refined_system
from casid.subspace.regression import regress_inputs
from casid.subspace.response_distance import (
    POINTS,
    errors_apart,
    missed_direct,
    missed_response,
    stated_errors,
)
from casid.subspace.settings import HIGHEST
from casid.subspace.simulation import refine_simulation
from casid.subspace.trust import (
    Growth,
    Missed,
    explained_share,
    growth,
    missed_dynamics,
    unsteady_growth,
)

FED_BACK = 0.2  # bound on the relative bias from white noise fed back, above which it is certain
SHARE = 0.03  # of an input, made by prediction errors, above which a bias is looked for
APART = 0.4  # stated errors between them: intervals off by as much still hold 93 %
CREDIBLE = 0.85  # of the stated errors of transforms: those of prediction errors are not less


@dataclass(frozen=True, eq=False)
class Estimate:
    """Model and innovation gain (nx, ny), with what is known about them."""

    system: StateSpace
    K: Array
    uncertainty: ResponseUncertainty | SampledUncertainty | None = None
    explained: Array | None = None
    doubtful: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    missed: Missed | None = None
    fault: Fault | None = None  # of a record that disagrees with the others
    remark: str = ""  # that a controller biases it


def refine_sampled(campaign: Campaign, found: Subspace, how: Refinement) -> Estimate:
    """Model of samples: the subspace estimate itself, or moved by one of four criteria."""
    # "linear" moves B, K and D alone (`casid.subspace.regression`), "prediction" everything to the
    # maximum likelihood of prediction errors, "simulation" from there to that of simulation errors;
    # "local simulation" goes on with these divided by their local level. Simulations have K = 0.
    system, K = found.system, found.K
    data = campaign.records, campaign.su, campaign.sy, campaign.mask
    if how == "unrefined":
        return Estimate(system, K)
    if how == "linear":
        return Estimate(*regress_inputs(system, K, *data, found.residual_covariance))
    if how == "prediction":
        return Estimate(*refine_samples(system, K, *data))
    with contextlib.suppress(ValueError):  # a predictor without modes still simulates
        system = refine_samples(system, K, *data)[0]
    local = how == "local simulation"
    return Estimate(refine_simulation(system, *data, local=local), np.zeros_like(K))


def refine_projected(
    campaign: Campaign,
    found: Subspace,
    pole: float,
    *,
    move: bool,
    windows: Windows | None = None,
    chosen: bool = False,
) -> Estimate:
    """By Fourier transforms, or under feedback by prediction errors; unrefined without ``move``.

    With ``windows``, models of other orders are made with them, which show what is to be doubted:
    of a higher order a refined one where the order was ``chosen`` and may be raised, else a rough
    one, that may leave more than fewer states do.
    """
    system, K, R = found.system, found.K, found.residual_covariance
    su, sy, mask = campaign.su, campaign.sy, campaign.mask
    pieces = campaign.part(campaign.pieces(pole))
    if not move:
        if fed_back_noise(system, K, pieces.records, su, sy) > FED_BACK:
            _warn_fed_back("refine=True removes that")
        return Estimate(system, K)
    data = campaign.spectra(pole, HIGHEST * pole)
    uncertainty: ResponseUncertainty | SampledUncertainty
    refined, uncertainty = refine(system, data, su, sy, mask, pole)
    grows = growth(refined, data, su, sy, mask)
    if len(undecided := grows.undecided):
        refined, uncertainty = refine(refined, data, su, sy, mask, pole, decaying=undecided)
        grows = growth(refined, data, su, sy, mask)
    K = carried_gain(system, K, refined, R)
    higher = refined.nx + 2
    richer = _at_order(campaign, higher, windows, data, rough=not chosen) if windows else None
    band = campaign.band(pole)
    missed = missed_dynamics(refined, richer, data, su, sy, band) if richer else None
    taken = Estimate(refined, K, uncertainty, missed=missed)  # inputs as they are
    moved = _without_feedback(taken, pieces, pole, R)
    if moved is taken and richer and not missed:  # noise fed back would ask for states as well
        missed = missed_response(refined, uncertainty, richer, data, su, sy, band)
        moved = replace(taken, missed=missed)
    if moved.system is not refined:
        grows = growth(moved.system, data, su, sy, mask)
    refined = moved.system
    # A model that misses dynamics blames records that show them.
    told = disagreement(
        richer if missed and richer else refined,
        campaign,
        pole,
        HIGHEST * pole,
        windows=windows,
        missing=missed is not None,
    )
    # Prediction errors are causal themselves, and what takes inputs as given is no judge of them.
    others = None if isinstance(moved.uncertainty, SampledUncertainty) else windows
    return replace(
        moved,
        explained=explained_share(refined, data, su, sy, band),
        doubtful=_doubtful(campaign, grows, system, refined, others, data),
        fault=told,
    )


def _without_feedback(found: Estimate, pieces: Campaign, pole: float, R: Array) -> Estimate:
    """The estimate, or that of prediction errors where noise fed back biases it.

    Turbulence adds up to many times its innovations, in all outputs together, and biases transforms
    weighted output by output though little of it is fed back. Prediction errors have no such bias:
    where some is fed back, how far they are from it in stated errors is the test (J. Hausman,
    Econometrica 46, 1978). They state too small errors of short records, which disqualifies them.
    So does a response that taking out masked direct terms has moved: that distance is no feedback.
    """
    share, size, chance = fed_back(found.system, found.K, pieces.records, pieces.su, pieces.sy)
    much = np.sqrt(share) * size > FED_BACK
    little = share <= max(SHARE, chance)
    if not much and (little or found.missed):  # what is missed is in prediction errors, too
        return found
    try:
        held, gain, sampled, direct = refine_held(found.system, found.K, pieces)
        gain = riccati_gain(held.A, held.C, gain, R)
        distorted = missed_direct(held, direct, sampled, pieces.band(pole))
        causal = Estimate(held, gain, sampled, missed=found.missed or distorted)
    except ValueError as error:
        remedy = f"prediction errors would show and remove that, but: {error}"
        return replace(found, remark=_warn_fed_back(remedy))
    distance, ratio = _apart(found, causal, np.geomspace(*pieces.band(pole), POINTS))
    if much or (distance > APART and ratio > CREDIBLE and not distorted):
        return causal
    if distance <= APART or ratio > CREDIBLE:  # or apart for want of its direct terms
        return found
    remedy = (
        f"the estimate by prediction errors, which is not biased so, is {distance:.2g} stated "
        "errors away, but its own stated errors are too small for records as short as these; "
        "longer records tell more"
    )
    return replace(found, remark=_warn_fed_back(remedy))


def _apart(found: Estimate, other: Estimate, omega: Array) -> tuple[float, float]:
    """Distance of another estimate in stated errors, and its stated errors over these; rms."""
    if found.uncertainty is None or other.uncertainty is None:
        return 0.0, 1.0
    own, its = (stated_errors(each, omega) for each in (found.uncertainty, other.uncertainty))
    distance = errors_apart(found.system, other.system, found.uncertainty, omega)
    return float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean((its / own) ** 2)))


def _doubtful(
    campaign: Campaign,
    grows: Growth,
    start: StateSpace,
    refined: StateSpace,
    windows: Windows | None,
    data: Sequence[Spectrum],
) -> ComplexArray:
    """Growing modes that data do not bear out, or the start or one state less does not find."""
    further = [grows.doubtful]
    if windows is not None and len(grows.modes) > len(grows.doubtful):
        further.append(unsteady_growth(refined, start, data, more=1.0))
        further.append(_unfound(campaign, refined, windows, data))
    modes = np.concatenate(further)
    again = np.isclose(modes[:, None], modes)
    return np.asarray(modes[~np.tril(again, -1).any(axis=1)])


def _unfound(
    campaign: Campaign, refined: StateSpace, windows: Windows, data: Sequence[Spectrum]
) -> ComplexArray:
    """Growing modes that a model of one state less does not find, though it may well."""
    su, sy, pole = campaign.su, campaign.sy, windows.pole
    fewer = _at_order(campaign, refined.nx - 1, windows, data, rough=True)
    none = np.zeros(0, dtype=complex)
    if fewer is None or not len(modes := unsteady_growth(refined, fewer, data)):
        return none
    # It says nothing if it cannot follow the aircraft at all, and neither can a model whose modes
    # are the same but decay.
    decaying, _ = refine(refined, data, su, sy, campaign.mask, pole, decaying=modes)
    band = campaign.band(pole)
    missed = (missed_dynamics(each, refined, data, su, sy, band) for each in (fewer, decaying))
    return none if all(missed) else modes


def _at_order(
    campaign: Campaign, order: int, windows: Windows, data: Sequence[Spectrum], *, rough: bool
) -> StateSpace | None:
    """A refined model of another order; None where the windows give none."""
    if not 1 <= order <= min(windows.past, windows.future) * len(campaign.sy):
        return None
    try:
        start = campaign.subspace(order, windows).system
        scales = campaign.su, campaign.sy, campaign.mask
        return refined_system(start, data, *scales, windows.pole, rough=rough)
    except (ValueError, np.linalg.LinAlgError):
        return None


def _warn_fed_back(remedy: str) -> str:
    """Warn that the estimate is biased; what was said."""
    said = (
        "inputs follow the black box's residuals so strongly (noise that a controller feeds "
        "back, or dynamics that it lacks, such as a delay, backlash or a rate limit) that it may "
        f"be biased and cannot judge a structure; {remedy}; a smaller pole or less feedback helps "
        "too, and of what is not linear distortion() tells by two amplitudes"
    )
    warn(said)
    return said[0].upper() + said[1:] + "."
