"""Maximum-likelihood refinement of a black box in the frequency domain.

A subspace estimate is consistent but not efficient, and its direct term cannot be masked without
harm. Here its poles, input and output matrices are moved by Gauss-Newton steps to maximise the
likelihood of the records' Fourier transforms,

    min Σ_records Σ_k Σ_o |Y_o - Σ_m c_om (ρ_m b_m U + ζ_m δ_m) - D_o U|² / Φ_o(ω_k),

with one transient δ per record (`casid.subspace.fourier`) and the residual spectrum Φ_o estimated
from the residuals themselves, smoothed over log ω. After every step the output matrices are those
that are best of its poles and inputs (`casid.subspace.slopes.with_outputs`). What the linear model
cannot follow (turbulence, the nonlinear response at low frequency) raises Φ there and counts less.
Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.,
chapters 9 and 12.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.subspace import modal as modes
from casid.subspace.fast_pole_errors import bounded, held_interval
from casid.subspace.fourier import Spectrum
from casid.subspace.likelihood import Part, noise_weights, parts, without_transients
from casid.subspace.pole_errors import parted, pole_errors
from casid.subspace.pooled_spectra import alike
from casid.subspace.slopes import normal_equations, response_derivative, with_outputs
from casid.subspace.weighing import known_weights, smoothed
from casid.values import storable

Left = Callable[[modes.Modal], list[Part]]  # what a model leaves of all spectra

ROUNDS = 2  # of estimating residual spectra
STEPS = 6  # Gauss-Newton steps a round
LEAST_DAMPING = 0.02  # of modes too fast for the data to show them unstable
NEUTRAL = 0.1  # of the highest growth: what a mode that shall decay decays by at least
SETTLED = 1e-5  # relative decrease of the cost that ends a round
ROUGH = 0.05  # nats a parameter: a step that gains less ends that of a model others are judged by


@storable
@dataclass(frozen=True, eq=False)
class ResponseUncertainty:
    """Covariance of a refined black box, kept as a factor in modal coordinates."""

    modal: modes.Modal
    free: np.ndarray
    factor: Array  # (parameters, rank), times its transpose the covariance of (λ, B, C, free D)
    su: Array
    sy: Array
    poles: ComplexArray | None = None  # (nm,) if those of ``modal`` are not the model's: `parted`
    unsettled: Array | None = None  # (parameters,) the step to the likelihood's maximum from here

    def response_factor(self, omega: Array) -> ComplexArray:
        """F (K, ny, nu, rank): an estimate of ln G is off by F z, z of standard normal numbers."""
        omega = np.atleast_1d(omega)
        none = np.zeros((len(omega), len(self.sy)), dtype=complex)
        unit = partial(Spectrum, omega, Y=none, h=None, hold="foh")
        return log_factor(
            *response_derivative(self.modal, self.free, unit, len(omega)), self.factor
        )

    def pole_std(self) -> tuple[ComplexArray, Array, Array]:
        """Poles with Im >= 0 and standard deviations of their real and imaginary parts, (nm,).

        Of poles that nearly meet, see `casid.subspace.pole_errors`.
        """
        modal = self.modal
        lam = modal.lam if self.poles is None else self.poles
        step = np.zeros(len(self.factor)) if self.unsettled is None else self.unsettled
        first, second = modal.place(1)
        both = np.column_stack([self.factor, step])
        turned = np.where(second >= 0, both[second[:, 0]], 0.0)
        return lam, *pole_errors(lam, modal.lam, both[first[:, 0]] + 1j * turned)


def log_factor(G: ComplexArray, dG: ComplexArray, factor: Array) -> ComplexArray:
    """Factor of the covariance of ln G, from that of the parameters and slopes by them."""
    return np.asarray(np.einsum("koip,pr->koir", dG, factor, optimize=True) / G[..., None])


def refine(
    system: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    fastest: float = np.inf,
    *,
    decaying: Sequence[complex] | ComplexArray = (),
) -> tuple[StateSpace, ResponseUncertainty]:
    """Refine a continuous black box on scaled Fourier transforms; real modal form, and covariance.

    Channels are scaled by ``su`` (nu,) and ``sy`` (ny,), the direct term is free where
    ``feedthrough`` (ny, nu) is, zero elsewhere. No mode with abs(λ) above ``fastest`` [rad/s] may
    be unstable: data and Laguerre pole cannot show it, and a spurious one spoils every use of the
    model. Neither may those of ``decaying``, poles of a system that is refined already.
    """
    modal = modes.to_modal(system, su, sy, feedthrough)
    modal, weights = _moved(modal, data, feedthrough, fastest, decaying)
    free = np.argwhere(feedthrough)
    around = parted(modal)
    known = parts(around, alike(data, known_weights(data, weights)))
    H, gradient = normal_equations(around, known, free)
    rows = 2 * sum(len(s.omega) for s in data) * len(sy)
    used = len(H) + len(data) * system.nx
    inflate = rows / max(rows - used, 1)  # residuals are smaller than noise by what was fitted
    plain = modes.covariance_factor(H, around)
    factor = plain * np.sqrt(inflate / 2)  # Fisher = 2 Re Σ Jᴴ W J
    step = plain @ (plain.T @ gradient)
    if (h := held_interval(data)) is not None:
        sizes: Array = np.linalg.norm(factor, axis=1)
        both = bounded(np.column_stack([factor, step]), sizes, around, h)
        factor, step = np.asarray(both[:, :-1]), np.asarray(both[:, -1])
    refined = modes.from_modal(modal, su, sy, system)
    return refined, ResponseUncertainty(around, free, factor, su, sy, modal.lam, step)


def refined_system(
    system: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    fastest: float,
    *,
    rough: bool = False,
) -> StateSpace:
    """What `refine` finds without its covariance, which costs as much as a step.

    A ``rough`` one, in one round, is no estimate, but enough to judge another model by: noise moves
    the likelihood of a model by half a nat a parameter.
    """
    modal = modes.to_modal(system, su, sy, feedthrough)
    modal, _ = _moved(modal, data, feedthrough, fastest, rough=rough)
    return modes.from_modal(modal, su, sy, system)


def _moved(
    modal: modes.Modal,
    data: Sequence[Spectrum],
    feedthrough: BoolArray,
    fastest: float,
    decaying: Sequence[complex] | ComplexArray = (),
    *,
    rough: bool = False,
) -> tuple[modes.Modal, list[Array]]:
    """The model moved to the maximum of the likelihood, and the weights of the last round."""
    free = np.argwhere(feedthrough)
    ceiling = _ceiling(modal, data, fastest)
    if len(decaying):  # of a refined system, in which what grows faster than the limit started so
        limit = highest_growth(data)
        ceiling = np.where(
            modal.lam.real <= (1 + 1e-6) * limit, np.minimum(ceiling, limit), ceiling
        )
        ceiling[np.isclose(modal.lam[:, None], decaying).any(axis=1)] = -NEUTRAL * limit
    modal = replace(modal, lam=_capped(modal.lam, ceiling, fastest))
    weights: list[Array] = []
    lines = sum(len(spectrum.omega) for spectrum in data) * len(modal.C)  # the cost to expect
    nats = ROUGH * (modal.order * sum(modal.D.shape) + len(free)) if rough else 0.0
    for _ in range(1 if rough else ROUNDS):
        weights = noise_weights(modal, data)
        known = lru_cache(1)(partial(parts, groups=alike(data, weights)))  # of the last trial
        modal = modes.descend(
            modal,
            cost=partial(_cost, known=known),
            normal=partial(_normal, known=known, free=free),
            tidy=partial(_tidied, ceiling=ceiling, fastest=fastest, known=known, free=free),
            free=free, steps=STEPS, settled=max(SETTLED, nats / lines),
        )  # fmt: skip
    return modal, weights


def _cost(modal: modes.Modal, known: Left) -> float:
    """Weighted squared residuals with the best transients."""
    return float(sum(part.cost.sum() for part in known(modal)))


def _normal(modal: modes.Modal, known: Left, free: np.ndarray) -> tuple[Array, Array]:
    """Normal equations of a Gauss-Newton step."""
    return normal_equations(modal, known(modal), free)


def _tidied(
    modal: modes.Modal, ceiling: Array, fastest: float, known: Left, free: np.ndarray
) -> modes.Modal:
    """The model with its poles where they may be, and the outputs that follow best from these."""
    modal = replace(modal, lam=_capped(modal.lam, ceiling, fastest))
    return with_outputs(modal, known(modal), free)


def residual_powers(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array
) -> tuple[Array, Array]:
    """Frequencies (K,) and squared residuals (K, ny) of all spectra with their best transients."""
    modal = modes.to_modal(system, su, sy, np.ones((system.ny, system.nu), dtype=bool))
    omega = np.concatenate([spectrum.omega for spectrum in data])
    return omega, np.vstack([np.abs(E) ** 2 for E in without_transients(modal, data)])


def information_criteria(
    system: StateSpace, data: Sequence[Sequence[Spectrum]], su: Array, sy: Array, direct: int
) -> Array:
    """Corrected Akaike criterion per real observation, residual spectra estimated.

    The records' shares, one for each entry of ``data``; their mean is the criterion. ``direct`` is
    the number of free direct terms; a model of order n has n (nu + ny) further parameters beside
    them, and one transient of n for each spectrum.
    """
    lines = [spectrum for record in data for spectrum in record]
    omega, power = residual_powers(system, lines, su, sy)
    smooth = smoothed(np.log(omega), np.log(omega), power)
    deviance = 2 * (np.log(smooth) + power / smooth).sum(axis=1)
    n, N = system.nx, 2 * power.size
    k = n * (len(su) + len(sy)) + direct + n * len(lines)
    if k + 1 >= N:
        return np.full(len(data), np.inf)
    ends = np.cumsum([sum(len(spectrum.omega) for spectrum in record) for record in data])
    shares = np.array([part.sum() for part in np.split(deviance, ends[:-1])])
    return np.asarray(len(data) * shares / N + 2 * k / (N - k - 1))


def highest_growth(data: Sequence[Spectrum]) -> float:
    """Rate [1/s] at which a mode that starts decaying may grow: see `refine`."""
    return 2 / max(float(2 * np.pi / spectrum.omega[0]) for spectrum in data)


def _ceiling(modal: modes.Modal, data: Sequence[Spectrum], fastest: float) -> Array:
    """Largest real part each mode may take, (nm,)."""
    # With free end states a growing mode explains as much as a decaying one: it is the start, found
    # by causal prediction, that knows which is which. A mode that starts stable may at most grow by
    # exp(2) over the longest record, which the transient hides.
    slow = np.where(modal.lam.real > 0, np.inf, highest_growth(data))
    size = np.abs(modal.lam)
    return np.asarray(np.where(size > fastest, -LEAST_DAMPING * size, slow))


def _capped(lam: ComplexArray, ceiling: Array, fastest: float) -> ComplexArray:
    """Poles with their real parts below the ceilings, and none above ``fastest`` unstable."""
    top = np.where(np.abs(lam) > fastest, -LEAST_DAMPING * np.abs(lam), ceiling)
    return np.asarray(np.minimum(lam.real, top) + 1j * lam.imag)
