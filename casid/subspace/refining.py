"""What follows the subspace estimate: which likelihood, and whether a controller spoils it."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.errors import warn
from casid.linear import StateSpace
from casid.subspace.agreement import Fault, disagreement
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.feedback import fed_back_noise
from casid.subspace.fourier import Spectrum
from casid.subspace.gain import carried_gain, riccati_gain
from casid.subspace.held import refine_held
from casid.subspace.prediction import SampledUncertainty, refine_samples
from casid.subspace.realisation import Subspace
from casid.subspace.refinement import ResponseUncertainty, refine, refined_system
from casid.subspace.regression import regress_inputs
from casid.subspace.settings import HIGHEST, Refinement
from casid.subspace.simulation import refine_simulation
from casid.subspace.trust import (
    Growth,
    Missed,
    explained_share,
    growth,
    missed_dynamics,
    unsteady_growth,
)

FED_BACK = 0.2  # bound on the relative bias from noise fed back, above which it is dealt with


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
) -> Estimate:
    """By Fourier transforms, or under feedback by prediction errors; unrefined without ``move``.

    With ``windows``, models of other orders are made with them, which show what is to be doubted.
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
    richer = _at_order(campaign, refined.nx + 2, windows, data) if windows else None
    band = campaign.band(pole)
    missed = missed_dynamics(refined, richer, data, su, sy, band) if richer else None
    if fed_back_noise(refined, K, pieces.records, su, sy) > FED_BACK:
        try:
            held, gain, sampled = refine_held(refined, K, pieces)
            gain = riccati_gain(held.A, held.C, gain, R)
        except ValueError as error:
            _warn_fed_back(f"prediction errors would remove that, but: {error}")
        else:
            refined, K, uncertainty = held, gain, sampled
            grows = growth(refined, data, su, sy, mask)
    # A model that misses dynamics blames records that show them.
    told = disagreement(
        richer if missed and richer else refined,
        campaign,
        pole,
        HIGHEST * pole,
        missing=missed is not None,
    )
    doubtful = _doubtful(campaign, grows, system, refined, windows, data)
    share = explained_share(refined, data, su, sy, band)
    return Estimate(refined, K, uncertainty, share, doubtful, missed, told)


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
        if (fewer := _at_order(campaign, refined.nx - 1, windows, data)) is not None:
            further.append(unsteady_growth(refined, fewer, data))
    modes = np.concatenate(further)
    again = np.isclose(modes[:, None], modes)
    return np.asarray(modes[~np.tril(again, -1).any(axis=1)])


def _at_order(
    campaign: Campaign, order: int, windows: Windows, data: Sequence[Spectrum]
) -> StateSpace | None:
    """A model of another order, refined in one round; None where the windows give none."""
    if not 1 <= order <= min(windows.past, windows.future) * len(campaign.sy):
        return None
    try:
        start = campaign.subspace(order, windows).system
        scales = campaign.su, campaign.sy, campaign.mask
        return refined_system(start, data, *scales, windows.pole, rounds=1)
    except (ValueError, np.linalg.LinAlgError):
        return None


def _warn_fed_back(remedy: str) -> None:
    warn(
        "the controller feeds so much of the outputs' noise back into the inputs that the black "
        f"box is biased; {remedy}; a smaller pole or less feedback helps too"
    )
