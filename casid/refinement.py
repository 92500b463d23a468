"""Maximum-likelihood refinement of a black box in the frequency domain.

A subspace estimate is consistent but not efficient, and its direct term cannot be masked without
harm. Here its poles, input and output matrices are moved by Gauss-Newton steps to maximise the
likelihood of the records' Fourier transforms,

    min Σ_records Σ_k Σ_o |Y_o - Σ_m c_om (ρ_m b_m U + ζ_m δ_m) - D_o U|² / Φ_o(ω_k),

with one transient δ per record (`casid.fourier`) and the residual spectrum Φ_o estimated from the
residuals themselves, smoothed over log ω. What the linear model cannot follow (turbulence, the
nonlinear response at low frequency) raises Φ there and counts less. Source: R. Pintelon,
J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapters 9 and 12.

In modal coordinates every derivative is a pole factor times a signal, and an output
enters through its row of C alone: the normal equations of all outputs are assembled from one small
Gram matrix each, instead of a tall Jacobian.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray, ComplexArray
from casid.fourier import Spectrum
from casid.linear import StateSpace

WIDTH = 0.35  # of the smoothing of residual spectra, in natural logarithms of ω
ROUNDS = 2  # of estimating residual spectra
STEPS = 6  # Gauss-Newton steps a round
LEAST_DAMPING = 0.02  # of modes too fast for the data to show them unstable
SETTLED = 1e-5  # relative decrease of the cost that ends a round


@dataclass(frozen=True, eq=False)
class Modal:
    """A real model by its modes: one of each complex pair (Im λ > 0), and the real ones.

    ``lam`` (nm,), ``B`` (nm, nu), ``C`` (ny, nm) complex, ``D`` (ny, nu); channels are scaled.
    """

    lam: ComplexArray
    B: ComplexArray
    C: ComplexArray
    D: Array

    @property
    def real(self) -> BoolArray:
        """Which modes are real."""
        return np.asarray(self.lam.imag == 0)

    def place(self, columns: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions of real and imaginary parts of ``columns`` numbers a mode, (nm, columns)."""
        nm, nc = len(self.lam), int((~self.real).sum())
        first = np.arange(nm * columns).reshape(nm, columns)
        second = np.full((nm, columns), -1)
        second[~self.real] = nm * columns + np.arange(nc * columns).reshape(nc, columns)
        return first, second


@dataclass(frozen=True, eq=False)
class ResponseUncertainty:
    """Covariance of a refined black box, kept as a factor in modal coordinates.

    ``factor`` (parameters, rank) times its transpose is the covariance of (λ, B, C, free D).
    """

    modal: Modal
    free: np.ndarray
    factor: Array
    su: Array
    sy: Array

    def response_std(self, omega: Array) -> tuple[Array, Array]:
        """Relative standard deviation of abs(G) and standard deviation of its phase [rad].

        Both (K, ny, nu), from the derivative of log G with respect to the parameters.
        """
        G, dG = _response_derivative(self.modal, self.free, np.atleast_1d(omega))
        spread = np.einsum("koip,pr->koir", dG, self.factor) / G[..., None]
        return np.linalg.norm(spread.real, axis=-1), np.linalg.norm(spread.imag, axis=-1)


def refine(
    system: StateSpace,
    data: Sequence[Spectrum],
    su: Array,
    sy: Array,
    feedthrough: BoolArray,
    fastest: float = np.inf,
) -> tuple[StateSpace, ResponseUncertainty]:
    """Refine a continuous black box on Fourier transforms of its records.

    Parameters
    ----------
    system : StateSpace
        The start, continuous.
    data : sequence of Spectrum
        Transforms scaled by the standard deviations.
    su, sy : (nu,), (ny,) array
        Standard deviations of the channels.
    feedthrough : (ny, nu) bool array
        Where the direct term is free; elsewhere it is zero.
    fastest : float
        No mode with abs(λ) above this [rad/s] may be unstable: data and Laguerre pole cannot show
        such a mode, and a spurious one would spoil every use of the model.

    Returns
    -------
    StateSpace
        In real modal coordinates.
    ResponseUncertainty
        Its covariance under the estimated residual spectra.
    """
    free = np.argwhere(feedthrough)
    modal = to_modal(system, su, sy, feedthrough)
    ceiling = _ceiling(modal, data, fastest)
    modal = replace(modal, lam=_capped(modal.lam, ceiling, fastest))
    weights: list[Array] = []
    for _ in range(ROUNDS):
        weights = noise_weights(modal, data)
        modal = _gauss_newton(modal, data, weights, free, ceiling, fastest)
    H, _, _ = normal_equations(modal, data, weights, free)
    rows = 2 * sum(len(s.omega) for s in data) * len(sy)
    used = len(H) + len(data) * system.nx
    inflate = rows / max(rows - used, 1)  # residuals are smaller than noise by what was fitted
    factor = _covariance_factor(H) * np.sqrt(inflate / 2)  # Fisher = 2 Re Σ Jᴴ W J
    refined = from_modal(modal, su, sy, system)
    return refined, ResponseUncertainty(modal, free, factor, su, sy)


def residual_powers(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array
) -> tuple[Array, Array]:
    """Frequencies (K,) and squared residuals (K, ny) of all spectra with their best transients."""
    modal = to_modal(system, su, sy, np.ones((system.ny, system.nu), dtype=bool))
    omega = np.concatenate([spectrum.omega for spectrum in data])
    return omega, np.vstack([np.abs(E) ** 2 for E in _residuals(modal, data)])


def information_criterion(
    system: StateSpace, data: Sequence[Spectrum], su: Array, sy: Array, direct: int
) -> float:
    """Corrected Akaike criterion per real observation, residual spectra estimated.

    ``direct`` is the number of free direct terms; a model of order n has n (nu + ny) further
    parameters beside them, and one transient of n for each spectrum.
    """
    omega, power = residual_powers(system, data, su, sy)
    smooth = _smoothed(np.log(omega), np.log(omega), power)
    deviance = 2 * float(np.sum(np.log(smooth) + power / smooth))
    n, N = system.nx, 2 * power.size
    k = n * (len(su) + len(sy)) + direct + n * len(data)
    if k + 1 >= N:
        return np.inf
    return (deviance + 2 * k * N / (N - k - 1)) / N


# ---- modal coordinates --------------------------------------------------------------------------


def to_modal(system: StateSpace, su: Array, sy: Array, feedthrough: BoolArray) -> Modal:
    """Modes of a system with scaled channels, balanced between B and C."""
    lam, V = np.linalg.eig(system.A)
    C = (system.C / sy[:, None]) @ V
    B = np.linalg.solve(V, (system.B * su).astype(complex))
    keep = lam.imag >= 0
    B, C = np.asarray(B[keep], dtype=complex), np.asarray(C[:, keep], dtype=complex)
    lam = np.asarray(lam[keep], dtype=complex)
    real = lam.imag == 0
    phase = np.where(real & (np.abs(B.imag).max(axis=1) > np.abs(B.real).max(axis=1)), 1j, 1.0)
    B, C = np.asarray(B / phase[:, None]), np.asarray(C * phase)
    B[real], C[:, real] = B[real].real, C[:, real].real
    nb, nc = np.linalg.norm(B, axis=1), np.linalg.norm(C, axis=0)
    balance = np.sqrt(np.where((nb > 0) & (nc > 0), nc / np.where(nb > 0, nb, 1.0), 1.0))
    D = np.where(feedthrough, system.D * su / sy[:, None], 0.0)
    return Modal(lam, np.asarray(B * balance[:, None]), np.asarray(C / balance), D)


def from_modal(modal: Modal, su: Array, sy: Array, like: StateSpace) -> StateSpace:
    """Real state-space model with physical channels; blocks of one or two states."""
    blocks, rows, columns = [], [], []
    for lam, b, c in zip(modal.lam, modal.B, modal.C.T, strict=True):
        if lam.imag == 0:
            blocks.append(np.array([[lam.real]]))
            rows.append(b.real[None])
            columns.append(c.real[None])
        else:
            blocks.append(np.array([[lam.real, -lam.imag], [lam.imag, lam.real]]))
            rows.append(np.vstack([b.real, b.imag]))
            columns.append(np.vstack([2 * c.real, -2 * c.imag]))
    A = scipy.linalg.block_diag(*blocks)
    B, C = np.vstack(rows) / su, np.vstack(columns).T * sy[:, None]
    D = modal.D * sy[:, None] / su
    return StateSpace(A, B, C, D, None, like.inputs, like.outputs)


@dataclass(frozen=True, eq=False)
class _Factors:
    """Pole factors of one spectrum for the modes and, zero for real ones, their conjugates."""

    r: ComplexArray
    rc: ComplexArray
    slope: ComplexArray
    slope_c: ComplexArray
    transient: ComplexArray
    transient_c: ComplexArray


def _factors(modal: Modal, spectrum: Spectrum) -> _Factors:
    r, slope, transient = spectrum.pole_factors(modal.lam)
    conjugates = spectrum.pole_factors(modal.lam.conj())
    rc, slope_c, transient_c = (np.where(modal.real, 0.0, factor) for factor in conjugates)
    return _Factors(r, rc, slope, slope_c, transient, transient_c)


def _pair(phi: ComplexArray, conjugate: ComplexArray, real: BoolArray) -> ComplexArray:
    """Real basis of a modal signal (K, nm, c): sums of all modes, then differences of pairs."""
    first = (phi + conjugate).reshape(len(phi), -1)
    second = (1j * (phi - conjugate))[:, ~real].reshape(len(phi), -1)
    return np.hstack([first, second])


# ---- Gauss-Newton -------------------------------------------------------------------------------


def _forced(modal: Modal, spectrum: Spectrum) -> tuple[ComplexArray, ComplexArray]:
    """Output residual without transient (K, ny), and the transient's basis (K, n)."""
    f, U = _factors(modal, spectrum), spectrum.U
    X, Xc = f.r * (U @ modal.B.T), f.rc * (U @ modal.B.conj().T)
    E = spectrum.Y - X @ modal.C.T - Xc @ modal.C.conj().T - U @ modal.D.T
    return E, _pair(f.transient[:, :, None], f.transient_c[:, :, None], modal.real)


def _residuals(modal: Modal, data: Sequence[Spectrum]) -> list[ComplexArray]:
    """Residuals (K, ny) of every spectrum with its best transient."""
    found = []
    for spectrum in data:
        E, basis = _forced(modal, spectrum)
        columns = [_mixed(basis, modal, o, 1) for o in range(len(modal.C))]
        P = np.vstack([*(c.real for c in columns), *(c.imag for c in columns)])
        e = E.T.ravel()
        target = np.concatenate([e.real, e.imag])
        delta = np.linalg.lstsq(P, target, rcond=1e-10)[0]
        left = (target - P @ delta).reshape(2, E.shape[1], -1)
        found.append((left[0] + 1j * left[1]).T)
    return found


def noise_weights(modal: Modal, data: Sequence[Spectrum]) -> list[Array]:
    """1/√Φ (K, ny) of every spectrum, Φ the residual spectrum smoothed over log ω."""
    residuals = _residuals(modal, data)
    omega = np.log(np.concatenate([s.omega for s in data]))
    power = np.vstack([np.abs(E) ** 2 for E in residuals])
    floor = 1e-20 * np.vstack([np.abs(s.Y) ** 2 for s in data]).mean(axis=0)
    smooth = [_smoothed(np.log(spectrum.omega), omega, power) for spectrum in data]
    return [1 / np.sqrt(level + floor) for level in smooth]


def _smoothed(at: Array, omega: Array, power: Array) -> Array:
    """Local mean of power (K, ny) over logarithms of frequency, at those asked for."""
    kernel = np.exp(-0.5 * ((at[:, None] - omega) / WIDTH) ** 2)
    return np.asarray(kernel @ power / kernel.sum(axis=1)[:, None])


def _cost(modal: Modal, data: Sequence[Spectrum], weights: Sequence[Array]) -> float:
    """Weighted squared residuals with the best transients."""
    total = 0.0
    for spectrum, w in zip(data, weights, strict=True):
        E, basis = _forced(modal, spectrum)
        n = basis.shape[1]
        G = np.zeros((n + 1, n + 1))
        for o in range(len(modal.C)):
            G += _gram(w[:, [o]] * np.hstack([_mixed(basis, modal, o, 1), E[:, [o]]]))
        total += float(_schur(G, n)[0, 0])
    return total


def _gauss_newton(
    modal: Modal,
    data: Sequence[Spectrum],
    weights: Sequence[Array],
    free: np.ndarray,
    ceiling: Array,
    fastest: float,
) -> Modal:
    """Levenberg-Marquardt steps until the cost settles."""
    damping, cost = 1e-3, _cost(modal, data, weights)
    for _ in range(STEPS):
        H, gradient, _ = normal_equations(modal, data, weights, free)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
        scaled, right = H / np.outer(scale, scale), gradient / scale
        before = cost
        for _ in range(8):
            step = (
                scipy.linalg.solve(scaled + damping * np.eye(len(H)), right, assume_a="pos") / scale
            )
            trial = _moved(modal, step, free)
            trial = replace(trial, lam=_capped(trial.lam, ceiling, fastest))
            trial_cost = _cost(trial, data, weights)
            if trial_cost < cost:
                modal, cost, damping = trial, trial_cost, max(damping / 5, 1e-9)
                break
            damping *= 10
        if before - cost < SETTLED * before:
            break
    return modal


def normal_equations(
    modal: Modal, data: Sequence[Spectrum], weights: Sequence[Array], free: np.ndarray
) -> tuple[Array, Array, float]:
    """Re Σ Jᴴ W J, Re Σ Jᴴ W E and the cost, transients eliminated.

    Parameters are λ, B, C by mode (real parts, then imaginary ones) and the free entries of D.
    """
    n = len(modal.lam) + int((~modal.real).sum())
    ny, nu = modal.D.shape
    size = n + n * nu + ny * n + len(free)
    total = np.zeros((size + 1, size + 1))
    for spectrum, w in zip(data, weights, strict=True):
        G = np.zeros((n + size + 1, n + size + 1))
        basis = _basis(modal, spectrum)
        E, _ = _forced(modal, spectrum)
        for o in range(ny):
            J, where = _output_derivative(basis, modal, o, free)
            where = np.append(where, n + size)
            G[np.ix_(where, where)] += _gram(w[:, [o]] * np.hstack([J, E[:, [o]]]))
        total += _schur(G, n)
    return total[:-1, :-1], total[:-1, -1], float(total[-1, -1])


def _schur(G: Array, n: int) -> Array:
    """Eliminate the first n unknowns (the transient of one record)."""
    head = G[:n, :n] + 1e-13 * np.trace(G[:n, :n]) / n * np.eye(n)
    return np.asarray(G[n:, n:] - G[n:, :n] @ scipy.linalg.solve(head, G[:n, n:], assume_a="pos"))


def _basis(modal: Modal, spectrum: Spectrum) -> ComplexArray:
    """Signals that span all derivatives: of the transient, λ, B, then of C, then of D."""
    f, U, real = _factors(modal, spectrum), spectrum.U, modal.real
    BU, BUc = U @ modal.B.T, U @ modal.B.conj().T
    return np.hstack(
        [
            _pair(f.transient[:, :, None], f.transient_c[:, :, None], real),
            _pair((f.slope * BU)[:, :, None], (f.slope_c * BUc)[:, :, None], real),
            _pair(f.r[:, :, None] * U[:, None], f.rc[:, :, None] * U[:, None], real),
            _pair((f.r * BU)[:, :, None], (f.rc * BUc)[:, :, None], real),
            U,
        ]
    )


def _mixed(piece: ComplexArray, modal: Modal, o: int, columns: int) -> ComplexArray:
    """A modal quantity as output o sees it: Re c on its own basis, Im c across the pair."""
    pairs = np.repeat(~modal.real, columns)
    c = np.repeat(modal.C[o], columns)
    first, second = piece[:, : len(c)], piece[:, len(c) :]
    own = first * c.real
    own[:, pairs] += second * c.imag[pairs]
    return np.hstack([own, second * c.real[pairs] - first[:, pairs] * c.imag[pairs]])


def _output_derivative(
    basis: ComplexArray, modal: Modal, o: int, free: np.ndarray
) -> tuple[ComplexArray, np.ndarray]:
    """Derivatives of output o by the transient and the parameters it depends on, and which."""
    ny, nu = modal.D.shape
    n = len(modal.lam) + int((~modal.real).sum())
    B, C = 2 * n, 2 * n + n * nu
    direct = np.flatnonzero(free[:, 0] == o)
    J = [
        _mixed(basis[:, :n], modal, o, 1),
        _mixed(basis[:, n:B], modal, o, 1),
        _mixed(basis[:, B:C], modal, o, nu),
        basis[:, C : C + n],
        basis[:, C + n + free[direct, 1]],
    ]
    where = [np.arange(C), C + o * n + np.arange(n), C + ny * n + direct]
    return np.hstack(J), np.concatenate(where)


def _gram(rows: Array | ComplexArray) -> Array:
    """Re(rowsᴴ rows)."""
    return np.asarray(rows.real.T @ rows.real + rows.imag.T @ rows.imag)


def _moved(modal: Modal, step: Array, free: np.ndarray) -> Modal:
    """The model a step further; a complex pair stays one, a real mode stays real."""
    ny, nu = modal.D.shape
    n = len(modal.lam) + int((~modal.real).sum())
    dlam = _complex(modal, step[:n], 1)[:, 0]
    dB = _complex(modal, step[n : n + n * nu], nu)
    start = n + n * nu
    dC = [_complex(modal, step[start + o * n : start + (o + 1) * n], 1)[:, 0] for o in range(ny)]
    D = modal.D.copy()
    D[free[:, 0], free[:, 1]] += step[start + ny * n :]
    lam = modal.lam + dlam
    lam = np.where(modal.real, lam, lam.real + 1j * np.maximum(np.abs(lam.imag), 1e-6))
    return Modal(lam, modal.B + dB, modal.C + np.array(dC), D)


def _ceiling(modal: Modal, data: Sequence[Spectrum], fastest: float) -> Array:
    """Largest real part each mode may take, (nm,).

    With free end states a growing mode explains as much as a decaying one: it is the start, found
    by causal prediction, that knows which is which. A mode that starts stable may at most grow by
    exp(2) over the longest record, which the transient hides.
    """
    longest = max(2 * np.pi / spectrum.omega[0] for spectrum in data)
    slow = np.where(modal.lam.real > 0, np.inf, 2 / longest)
    size = np.abs(modal.lam)
    return np.asarray(np.where(size > fastest, -LEAST_DAMPING * size, slow))


def _capped(lam: ComplexArray, ceiling: Array, fastest: float) -> ComplexArray:
    """Poles with their real parts below the ceilings, and none above ``fastest`` unstable."""
    top = np.where(np.abs(lam) > fastest, -LEAST_DAMPING * np.abs(lam), ceiling)
    return np.asarray(np.minimum(lam.real, top) + 1j * lam.imag)


def _complex(modal: Modal, values: Array, columns: int) -> ComplexArray:
    first, second = modal.place(columns)
    imaginary = np.where(second >= 0, values[np.maximum(second, 0)], 0.0)
    return np.asarray(values[first] + 1j * imaginary)


def _covariance_factor(H: Array) -> Array:
    """L with L Lᵀ = H⁺; the gauge of each mode (scale between B and C) is a null direction."""
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    s, V = np.linalg.eigh(H / np.outer(scale, scale))
    keep = s > 1e-10 * s[-1]
    return np.asarray(V[:, keep] / np.sqrt(s[keep]) / scale[:, None])


def _response_derivative(
    modal: Modal, free: np.ndarray, omega: Array
) -> tuple[ComplexArray, ComplexArray]:
    """G (K, ny, nu) of the scaled channels and its derivatives (K, ny, nu, parameters)."""
    ny, nu = modal.D.shape
    n = len(modal.lam) + int((~modal.real).sum())
    size = n + n * nu + ny * n + len(free)
    G = np.empty((len(omega), ny, nu), dtype=complex)
    dG = np.zeros((len(omega), ny, nu, size), dtype=complex)
    for j in range(nu):
        U = np.zeros((len(omega), nu), dtype=complex)
        U[:, j] = 1.0
        unit = Spectrum(omega, U, np.zeros((len(omega), ny), dtype=complex), None, "foh")
        basis = _basis(modal, unit)
        E, _ = _forced(modal, unit)
        G[:, :, j] = -E
        for o in range(ny):
            J, where = _output_derivative(basis, modal, o, free)
            dG[:, o, j, where[n:] - n] = J[:, n:]
    return G, dG
