"""Whether records support a model at all, seen from what the best linear one leaves unexplained."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.subspace import refinement
from casid.subspace.fourier import Spectrum
from casid.subspace.likelihood import noise_weights, parts
from casid.subspace.modal import covariance_factor, to_modal
from casid.subspace.pooled_spectra import alike
from casid.subspace.slopes import normal_equations
from casid.values import storable

CERTAIN = 2.8  # standard errors that a growth rate must be away from zero: 99.5 % of a normal one
AGREED = 0.9  # of a t-distribution: that records, few as they are, must agree on a growth rate
HARDLY = 0.2  # e-folds over the longest record: less growth is an integrator's, not an aircraft's
STEADY = 0.6  # of its modulus: how far a mode may move with the order or by the refinement
WINDOW = 0.12  # in natural logarithms of ω, of what a higher order leaves less
POINTS = 60  # of the band, where that is looked at
CLEARLY = 1.7  # that ratio at least: nonlinear aircraft leave somewhat less at any higher order
RARELY = (
    1e-4  # level of the F-test of that ratio: 1 % for some hundred windows and outputs together
)
COHERENCE = 0.6  # of inputs and an output, below which a response is not usable; T&R section 7.5


def explained_share(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array, band: tuple[float, float]
) -> Array:
    """Share of each output's power that a model explains at a typical frequency of a band, (ny,).

    One minus the geometric mean over frequencies of residual power over power, which is what a
    multiple coherence is: a resonance that is explained does not hide a band that is not.
    """
    omega, left = refinement.residual_powers(system, data, su, sy)
    whole = np.vstack([np.abs(spectrum.Y) ** 2 for spectrum in data])
    inside = (omega >= band[0]) & (omega <= band[1])
    ratio = np.maximum(left[inside], 1e-300) / np.maximum(whole[inside], 1e-300)
    return np.asarray(1 - np.exp(np.mean(np.log(ratio), axis=0)))


@dataclass(frozen=True, eq=False)
class Growth:
    """Growing modes (Im >= 0) of a refined model, and what the likelihood of its data says of each.

    ``needed``: whether its growth rate is `CERTAIN` by its standard error under the residual
    spectra; ``agreed``: by that from how far record by record pulls the estimate apart, too, which
    what is nonlinear does; ``limited``: whether it is at the limit to which a mode that was found
    decaying may grow; ``slow``: whether it grows no faster than that.
    """

    modes: ComplexArray
    needed: BoolArray
    agreed: BoolArray
    limited: BoolArray
    slow: BoolArray

    @property
    def undecided(self) -> ComplexArray:
        """Slow modes that might as well decay: the likelihood does not tell."""
        return np.asarray(self.modes[self.slow & ~self.needed])

    @property
    def doubtful(self) -> ComplexArray:
        """Modes whose growth the data do not bear out."""
        return np.asarray(self.modes[~(self.needed & self.agreed) | self.limited])


def growth(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array, feedthrough: BoolArray
) -> Growth:
    """Growing modes of a refined model; less growth than an integrator's is none."""
    modal = to_modal(system, su, sy, feedthrough)
    limit, rates = refinement.highest_growth(data), modal.lam.real
    grows = rates > HARDLY / 2 * limit
    if not grows.any():
        none = np.zeros(0, dtype=bool)
        return Growth(modal.lam[grows], none, none, none, none)
    free = np.argwhere(feedthrough)
    pairs = zip(data, noise_weights(modal, data), strict=True)
    alone = [parts(modal, alike([lines], [weight])) for lines, weight in pairs]
    equations = [normal_equations(modal, known, free) for known in alone]
    whole = covariance_factor(np.sum([H for H, _ in equations], axis=0), modal)
    factor, count = whole[: len(modal.lam)], len(equations)
    plain = np.linalg.norm(factor, axis=1) / np.sqrt(2)
    pulls = factor @ (whole.T @ np.array([gradient for _, gradient in equations]).T)
    robust = np.linalg.norm(pulls, axis=1) * np.sqrt(count / max(count - 1, 1))
    least = scipy.special.stdtrit(count - 1, AGREED) if count > 1 else 0.0
    return Growth(
        modal.lam[grows],
        needed=(rates >= CERTAIN * plain)[grows],
        agreed=(rates >= least * robust)[grows],
        limited=np.isclose(rates, limit, rtol=1e-6)[grows],
        slow=(rates <= (1 + 1e-6) * limit)[grows],
    )


def unsteady_growth(
    system: StateSpace, other: StateSpace, data: Sequence[Spectrum], *, more: float = 0.0
) -> ComplexArray:
    """Growing modes (Im >= 0) that another model does not have likewise.

    It has one if it grows near there at half the rate at least, or by ``more`` times the highest
    growth of a mode that starts decaying less than that.
    """
    limit, others = refinement.highest_growth(data), other.poles()
    lam = system.poles()
    lam = lam[(lam.real > HARDLY / 2 * limit) & (lam.imag >= 0)]
    near = np.abs(lam[:, None] - others) <= STEADY * np.abs(lam[:, None])
    return np.asarray(
        lam[~(near & (others.real + more * limit >= lam.real[:, None] / 2)).any(axis=1)]
    )


@storable
@dataclass(frozen=True, kw_only=True)
class Missed:
    """Where an order is too low, and by what that shows.

    A model of a higher order leaves clearly less, by the ``ratio`` of the residual powers, or its
    response is far away beside what is stated, ``errors`` of that, rms over the band. Or, without a
    ratio, that of the same order is, with the direct terms that were asked to be zero.
    """

    output: str
    omega: float  # rad/s
    ratio: float | None
    order: int  # the higher one
    errors: float | None = None


def missed_dynamics(
    system: StateSpace,
    richer: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    band: tuple[float, float],
) -> Missed | None:
    """Where in the band a refined model of a higher order leaves clearly less; None for nowhere."""
    # In windows narrow enough for one lightly damped mode. Two more states have there a pole, a
    # residue for every input and a transient for every piece of a record, one complex number each;
    # noise of as many lines as the window holds would leave that much less by F's distribution.
    omega, left = refinement.residual_powers(system, data, su, sy)
    less = refinement.residual_powers(richer, data, su, sy)[1]
    at = np.geomspace(*band, POINTS)
    kernel = np.exp(-0.5 * (np.log(at[:, None] / omega) / WINDOW) ** 2)
    lines = kernel.sum(axis=1) ** 2 / np.maximum((kernel**2).sum(axis=1), 1e-300)
    floor = 1e-300
    ratio = (kernel @ left + floor) / (kernel @ less + floor)
    more = 1 + system.nu + len(data)
    spare = np.maximum(lines - more, 0.5)
    least = 1 + more / spare / scipy.special.fdtri(2 * spare, 2 * more, RARELY)  # 1/F is F, too
    clear = (ratio > CLEARLY) & (ratio > least[:, None])
    gain = np.where(clear, lines[:, None] * np.log(ratio), 0.0)
    k, i = np.unravel_index(np.argmax(gain), gain.shape)
    if not clear[k, i]:
        return None
    return Missed(
        output=system.outputs[i], omega=float(at[k]), ratio=float(ratio[k, i]), order=richer.nx
    )


def order_doubts(missed: Missed | None, order: int) -> tuple[str, ...]:
    """Why the order is too low; empty where nothing says so."""
    if missed is None:
        return ()
    if missed.ratio is None:
        seen = f"with direct terms, which are zero here, the response of {missed.output} differs"
        what = f"by {missed.errors:.2g} stated errors near {missed.omega:.2g} rad/s"
    else:
        seen = (
            f"what this black box does not explain of {missed.output} near {missed.omega:.2g} "
            "rad/s still"
        )
        what = f"depends on the inputs, order {missed.order} " + (
            f"leaves {missed.ratio:.2g} times less"
            if missed.errors is None
            else f"changes the response by {missed.errors:.2g} stated errors"
        )
    return (
        f"Order {order} is too low: {seen} {what}. The stated response_std does not hold there, "
        f"and no structure is judged by it; call pbsid with order={missed.order} or more.",
    )


def growth_doubts(modes: ComplexArray) -> tuple[str, ...]:
    """Why growing modes are not to be believed; empty for none."""
    if not len(modes):
        return ()
    names = ", ".join(
        f"{m.real:+.3g}" + (f" ± {m.imag:.3g}j" if m.imag else "") + " 1/s" for m in modes
    )
    return (
        f"The black box has growing modes at {names} that some check does not confirm (likelihood, "
        "agreement of the records, causal prediction, a model of one state less): they may as well "
        "decay. Do not call the aircraft unstable because of them; try another order, or longer "
        "records.",
    )


def data_doubts(explained: Array, outputs: Sequence[str]) -> tuple[str, ...]:
    """Why the records do not support a model; empty where they do."""
    # They do not where the inputs explain most outputs with a coherence below `COHERENCE`. A few
    # such outputs are common: attitudes hardly move at the upper end of the band.
    weak = [
        f"{name} {max(share, 0):.0%}"
        for name, share in zip(outputs, explained, strict=True)
        if share < COHERENCE
    ]
    if 2 * len(weak) <= len(explained):
        return ()
    return (
        "These data do not support a model: at a typical frequency of the band that the inputs "
        f"excite, the best linear model explains only so much of the outputs: {', '.join(weak)}; "
        f"{COHERENCE:.0%} is the least that is usable. Derivatives and handling-quality figures "
        "from them mean nothing. Look for vibration and wind, inputs that were not recorded, "
        "channels that disagree (kinematics), and fly stronger inputs one axis at a time.",
    )
