"""Maximum-likelihood refinement of a black box in the frequency domain.

A subspace estimate is consistent but not efficient, and its direct term cannot be masked without
harm. Here its poles, input and output matrices are moved by Gauss-Newton steps to maximise the
likelihood of the records' Fourier transforms,

    min Σ_records Σ_k Σ_o |Y_o - Σ_m c_om (ρ_m b_m U + ζ_m δ_m) - D_o U|² / Φ_o(ω_k),

with one transient δ per record (`casid.subspace.fourier`) and the residual spectrum Φ_o estimated
from the residuals themselves, smoothed over log ω. What the linear model cannot follow (turbulence,
the nonlinear response at low frequency) raises Φ there and counts less. Source: R. Pintelon, J.
Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapters 9 and 12.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.subspace import modal as modes
from casid.subspace.fourier import Lines, Spectrum
from casid.subspace.weighing import known_weights, smoothed
from casid.values import storable

ROUNDS = 2  # of estimating residual spectra
STEPS = 6  # Gauss-Newton steps a round
LEAST_DAMPING = 0.02  # of modes too fast for the data to show them unstable
NEUTRAL = 0.1  # of the highest growth: what a mode that shall decay decays by at least
SETTLED = 1e-5  # relative decrease of the cost that ends a round


@storable
@dataclass(frozen=True, eq=False)
class ResponseUncertainty:
    """Covariance of a refined black box, kept as a factor in modal coordinates."""

    modal: modes.Modal
    free: np.ndarray
    factor: Array  # (parameters, rank), times its transpose the covariance of (λ, B, C, free D)
    su: Array
    sy: Array

    def response_factor(self, omega: Array) -> ComplexArray:
        """F (K, ny, nu, rank): an estimate of ln G is off by F z, z of standard normal numbers."""
        omega = np.atleast_1d(omega)
        none = np.zeros((len(omega), len(self.sy)), dtype=complex)
        unit = partial(Spectrum, omega, Y=none, h=None, hold="foh")
        return log_factor(
            *response_derivative(self.modal, self.free, unit, len(omega)), self.factor
        )

    def pole_std(self) -> tuple[ComplexArray, Array, Array]:
        """Poles with Im >= 0 and standard deviations of their real and imaginary parts, (nm,)."""
        lam, spread = self.modal.lam, np.linalg.norm(self.factor, axis=1)
        first, second = self.modal.place(1)
        imaginary = np.where(second >= 0, spread[np.maximum(second, 0)], 0.0)
        return lam, spread[first[:, 0]], imaginary[:, 0]


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
    modal, weights = _moved(modal, data, feedthrough, fastest, decaying, ROUNDS)
    free = np.argwhere(feedthrough)
    H, _ = normal_equations(modal, data, known_weights(data, weights), free)
    rows = 2 * sum(len(s.omega) for s in data) * len(sy)
    used = len(H) + len(data) * system.nx
    inflate = rows / max(rows - used, 1)  # residuals are smaller than noise by what was fitted
    factor = modes.covariance_factor(H) * np.sqrt(inflate / 2)  # Fisher = 2 Re Σ Jᴴ W J
    refined = modes.from_modal(modal, su, sy, system)
    return refined, ResponseUncertainty(modal, free, factor, su, sy)


def refined_system(
    system: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    fastest: float,
    *,
    rounds: int = ROUNDS,
) -> StateSpace:
    """What `refine` finds without its covariance, which costs as much as a step."""
    modal = modes.to_modal(system, su, sy, feedthrough)
    modal, _ = _moved(modal, data, feedthrough, fastest, (), rounds)
    return modes.from_modal(modal, su, sy, system)


def _moved(
    modal: modes.Modal,
    data: Sequence[Spectrum],
    feedthrough: BoolArray,
    fastest: float,
    decaying: Sequence[complex] | ComplexArray,
    rounds: int,
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
    for _ in range(rounds):
        weights = noise_weights(modal, data)
        parts = lru_cache(1)(partial(_parts, data=data, weights=weights))  # of the last trial
        modal = modes.descend(
            modal,
            cost=partial(_cost, parts=parts),
            normal=partial(normal_equations, data=data, weights=weights, free=free, parts=parts),
            tidy=lambda trial: replace(trial, lam=_capped(trial.lam, ceiling, fastest)),
            free=free, steps=STEPS, settled=SETTLED,
        )  # fmt: skip
    return modal, weights


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


@dataclass(frozen=True, eq=False)
class _Factors:
    """Pole factors of one spectrum for the modes and, zero for real ones, their conjugates."""

    r: ComplexArray
    rc: ComplexArray
    slope: ComplexArray
    slope_c: ComplexArray
    transient: ComplexArray
    transient_c: ComplexArray
    drift: ComplexArray
    drift_c: ComplexArray


def factors(modal: modes.Modal, spectrum: Lines) -> _Factors:
    """``slope`` and ``drift`` are the derivatives of ``r`` and ``transient`` by λ."""
    both = spectrum.pole_factors(np.concatenate([modal.lam, modal.lam.conj()]))
    r, slope, transient, drift = (each[:, : len(modal.lam)] for each in both)
    rc, slope_c, transient_c, drift_c = (
        np.where(modal.real, 0.0, each[:, len(modal.lam) :]) for each in both
    )
    return _Factors(r, rc, slope, slope_c, transient, transient_c, drift, drift_c)


def forced(modal: modes.Modal, spectrum: Lines, f: _Factors) -> ComplexArray:
    """Output residual without transient, (K, ny)."""
    U = spectrum.U
    X, Xc = f.r * (U @ modal.B.T), f.rc * (U @ modal.B.conj().T)
    return spectrum.Y - X @ modal.C.T - Xc @ modal.C.conj().T - U @ modal.D.T


def without_transients(modal: modes.Modal, data: Sequence[Spectrum]) -> list[ComplexArray]:
    """Residuals (K, ny) of every spectrum with its best transient."""
    # What a transient does to an output are sums of n signals that all share, so that the least
    # squares over all lines of all outputs are those over n rows of each, Q their orthogonal basis.
    found: list[ComplexArray] = []
    for spectrum in data:
        f = factors(modal, spectrum)
        E = forced(modal, spectrum, f)
        shared = modes.pair(f.transient[:, :, None], f.transient_c[:, :, None], modal.real)
        Q, R = np.linalg.qr(np.vstack([shared.real, shared.imag]))
        seen = np.array([modes.mixed(R, modal, o, 1) for o in range(E.shape[1])])
        target = np.vstack([E.real, E.imag])
        rows, right = seen.reshape(-1, R.shape[1]), (Q.T @ target).T.ravel()
        delta = np.linalg.lstsq(rows, right, rcond=1e-10)[0]
        real, imag = np.split(target - Q @ (seen @ delta).T, 2)
        found.append(real + 1j * imag)
    return found


def noise_weights(modal: modes.Modal, data: Sequence[Spectrum]) -> list[Array]:
    """1/√Φ (K, ny) of every spectrum, Φ the residual spectrum smoothed over log ω."""
    residuals = without_transients(modal, data)
    omega = np.log(np.concatenate([s.omega for s in data]))
    power = np.vstack([np.abs(E) ** 2 for E in residuals])
    floor = 1e-20 * np.vstack([np.abs(s.Y) ** 2 for s in data]).mean(axis=0)
    smooth = [smoothed(np.log(spectrum.omega), omega, power) for spectrum in data]
    return [1 / np.sqrt(level + floor) for level in smooth]


class _Part(NamedTuple):
    """Of one spectrum its factors, residual (K, ny), best transient (nm,) and its cost."""

    f: _Factors
    E: ComplexArray
    delta: ComplexArray
    cost: float


def _parts(modal: modes.Modal, data: Sequence[Lines], weights: Sequence[Array]) -> list[_Part]:
    """Parts of all spectra."""
    found, seen = [], modes.mixing(modal)
    for spectrum, w in zip(data, weights, strict=True):
        f = factors(modal, spectrum)
        E = forced(modal, spectrum, f)
        found.append(_Part(f, E, *_transient(modal, f, E, w, seen)))
    return found


def _cost(modal: modes.Modal, parts: Callable[[modes.Modal], list[_Part]]) -> float:
    """Weighted squared residuals with the best transients."""
    return sum(part.cost for part in parts(modal))


def _transient(
    modal: modes.Modal, f: _Factors, E: ComplexArray, w: Array, seen: Array
) -> tuple[ComplexArray, float]:
    """The best transient δ (nm,) of one spectrum, and the weighted squared residual it leaves."""
    shared = modes.pair(f.transient[:, :, None], f.transient_c[:, :, None], modal.real)
    (K, n), ny = shared.shape, len(seen)
    rows = np.empty((ny, 2 * K, n + 1))  # what transients do to each output, but for its C, and E
    rows[:, :, :n], rows[:, :, n] = modes.stacked(shared), modes.stacked(E).T
    rows *= np.hstack([w.T, w.T])[:, :, None]
    mixed = np.zeros((ny, n + 1, n + 1))
    mixed[:, :n, :n], mixed[:, n, n] = seen, 1.0
    grams = mixed.swapaxes(1, 2) @ (rows.swapaxes(1, 2) @ rows) @ mixed
    G = grams.sum(axis=0)
    delta = modes.eliminator(G, n)[:, 0]
    return modes.to_complex(modal, delta, 1)[:, 0], float(G[n, n] - G[n, :n] @ delta)


def normal_equations(
    modal: modes.Modal,
    data: Sequence[Spectrum],
    weights: Sequence[Array],
    free: np.ndarray,
    parts: Callable[[modes.Modal], list[_Part]] | None = None,
) -> tuple[Array, Array]:
    """Re Σ Jᴴ W J and Re Σ Jᴴ W E, transients eliminated; ``parts`` may know those of a model."""
    # Parameters are λ, B, C by mode (real parts, then imaginary ones) and the free entries of D.
    # All derivatives of an output are sums of signals that all outputs share, in a small number
    # that its row of C gives: these sums are taken of the Gram matrices, not of the signals.
    n = modal.order
    ny, nu = modal.D.shape
    size = n + n * nu + ny * n + len(free)
    grams, heads = _shared_grams(
        modal, data, weights, parts(modal) if parts else _parts(modal, data, weights)
    )
    total = np.zeros((size + 1, size + 1))
    sides = np.zeros((len(data), n, n + size + 1))
    alone = np.eye(grams.shape[1])  # of the signals, the error last
    for o in range(ny):
        J, where = modes.output_derivative(alone, modal, o, free)
        T, where = np.hstack([J, alone[:, -1:]]), np.append(where, n + size)
        whole = T.T @ (grams[o] @ T)
        total[np.ix_(where[n:] - n, where[n:] - n)] += whole[n:, n:]
        sides[:, :, where] += T[:n, :n].T @ (heads[:, o] @ T)
    others = sides[:, :, n:].reshape(-1, size + 1)
    total -= others.T @ modes.eliminator(sides, n).reshape(-1, size + 1)
    return total[:-1, :-1], total[:-1, -1]


def linearised(
    modal: modes.Modal, data: Sequence[Spectrum], weights: Sequence[Array]
) -> list[tuple[ComplexArray, ComplexArray]]:
    """Residuals (K, ny) but for transients, and what spans their slopes, of every spectrum."""
    parts = zip(data, _parts(modal, data, weights), strict=True)
    return [(part.E, _basis(modal, lines, part.delta, part.f)) for lines, part in parts]


def _shared_grams(
    modal: modes.Modal, data: Sequence[Spectrum], weights: Sequence[Array], parts: Sequence[_Part]
) -> tuple[Array, Array]:
    """Gram matrices of the shared signals and the error, weighted as each output is.

    Their sums over all spectra (ny, m, m), and the rows of each spectrum's transient
    (spectra, ny, n, m).
    """
    n, ny = modal.order, len(modal.C)
    m = n * (len(modal.B.T) + 3) + len(modal.B.T) + 1
    grams, heads = np.zeros((ny, m, m)), np.empty((len(data), ny, n, m))
    for spectrum, w, head, (f, E, delta, _) in zip(data, weights, heads, parts, strict=True):
        basis = _basis(modal, spectrum, delta, f)
        rows = np.empty((2 * len(basis), m))
        rows[:, :-1] = modes.stacked(basis)
        weighted = np.empty_like(rows)
        for o, (e, scale) in enumerate(zip(modes.stacked(E).T, np.vstack([w, w]).T, strict=True)):
            rows[:, -1] = e
            found = modes.gram(np.multiply(rows, scale[:, None], out=weighted))
            head[o] = found[:n]
            grams[o] += found
    return grams, heads


def _basis(modal: modes.Modal, spectrum: Lines, delta: ComplexArray, f: _Factors) -> ComplexArray:
    """Signals that span all derivatives: of the transient, λ, B, then of C, then of D."""
    U, real = spectrum.U, modal.real
    BU, BUc = U @ modal.B.T, U @ modal.B.conj().T
    poles = f.slope * BU + f.drift * delta
    poles_c = f.slope_c * BUc + f.drift_c * delta.conj()
    return np.hstack(
        [
            modes.pair(f.transient[:, :, None], f.transient_c[:, :, None], real),
            modes.pair(poles[:, :, None], poles_c[:, :, None], real),
            modes.pair(f.r[:, :, None] * U[:, None], f.rc[:, :, None] * U[:, None], real),
            modes.pair(
                (f.r * BU + f.transient * delta)[:, :, None],
                (f.rc * BUc + f.transient_c * delta.conj())[:, :, None],
                real,
            ),
            U,
        ]
    )


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


def response_derivative(
    modal: modes.Modal, free: np.ndarray, lines: Callable[[ComplexArray], Lines], K: int
) -> tuple[ComplexArray, ComplexArray]:
    """G (K, ny, nu) of scaled channels and its slopes; ``lines`` transforms what inputs do."""
    ny, nu = modal.D.shape
    n = modal.order
    size = n + n * nu + ny * n + len(free)
    G = np.empty((K, ny, nu), dtype=complex)
    dG = np.zeros((K, ny, nu, size), dtype=complex)
    for j in range(nu):
        unit = lines(np.tile(np.eye(nu, dtype=complex)[j], (K, 1)))
        f = factors(modal, unit)
        basis = _basis(modal, unit, np.zeros(len(modal.lam), dtype=complex), f)
        G[:, :, j] = -forced(modal, unit, f)
        for o in range(ny):
            J, where = modes.output_derivative(basis, modal, o, free)
            dG[:, o, j, where[n:] - n] = J[:, n:]
    return G, dG
