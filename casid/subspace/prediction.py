"""Maximum-likelihood refinement of a black box of the samples themselves.

The subspace estimate is moved by Gauss-Newton steps to minimise the determinant of the covariance
of the one-step prediction errors of its innovation form, the likelihood of Gaussian innovations,

    x⁺ = (A - KC) x + (B - KD) u + K y        ŷ = C x + D u + c        min log det Σ (y - ŷ)(y - ŷ)ᵀ

with the initial state and a constant c free for every stretch. The predictor is stable whatever the
system, and unbiased under feedback if loop or plant has a delay. Source: L. Ljung, System
Identification, 2nd ed., sections 7.2 and 8.3.

Errors whose size changes along a record, as those do that grow with the motion, may be divided by
their local level, estimated from themselves: the likelihood of a variance that varies slowly.

The predictor is handled in modal coordinates (`casid.subspace.modal`): the signals all derivatives
are made of are first-order filters of u and y, and one Gram matrix of them serves all outputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import scipy

from casid.arrays import Array, BoolArray, ComplexArray
from casid.linear import StateSpace
from casid.record import Record
from casid.samples import runs
from casid.subspace import modal as modes
from casid.subspace.refinement import log_factor
from casid.subspace.slopes import response_derivative
from casid.values import storable

States = tuple[ComplexArray, ComplexArray, Array]  # of a stretch, and its errors: `_states`
Known = Callable[[modes.Modal], list[States]]

ROUNDS = 3  # of estimating the innovations' covariance
STEPS = 12  # Gauss-Newton steps a round
SETTLED = 1e-6  # relative decrease of the cost that ends a round
RADIUS = 1 - 1e-4  # of the disc the predictor's poles stay in
FLOOR = 1e-10  # of an output's standard deviation: its innovations are not smaller
NEAR = 50.0  # samples, the width of local levels: 180 count, which gives a variance within 10 %
LEAST = 1e-3  # of the errors' standard deviation: local levels are not smaller


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive samples without a gap, scaled."""

    v: Array  # (N, nu + ny) inputs and outputs
    y: Array  # (N, ny)
    weight: Array  # (N, 1) of each sample's errors


@storable
@dataclass(frozen=True, eq=False)
class SampledUncertainty:
    """Covariance, factor factorᵀ, of μ, [B - KD, K], C and free D in modal coordinates."""

    modal: modes.Modal
    free: np.ndarray
    factor: Array  # (parameters, rank)
    nu: int
    h: float  # sampling interval [s]

    def response_factor(self, omega: Array) -> ComplexArray:
        """F (K, ny, nu, rank): an estimate of ln G is off by F z, z of standard normal numbers.

        With W the predictor's response to u and y, G = (I - W_y)⁻¹ W_u.
        """
        omega = np.atleast_1d(omega)
        ny = len(self.modal.D)
        none = np.zeros((len(omega), ny), dtype=complex)
        unit = partial(_Shifted, np.exp(1j * omega * self.h), Y=none)
        W, dW = response_derivative(self.modal, self.free, unit, len(omega))
        left = np.eye(ny) - W[:, :, self.nu :]
        G = np.linalg.solve(left, W[:, :, : self.nu])
        change = dW[:, :, : self.nu] + np.einsum("koyp,kyi->koip", dW[:, :, self.nu :], G)
        dG = np.linalg.solve(left, change.reshape(len(omega), ny, -1)).reshape(change.shape)
        return log_factor(G, dG, self.factor)


@dataclass(frozen=True, eq=False)
class _Shifted:
    """Transforms at points z of a discrete model, whose modes are 1/(z - μ)."""

    z: ComplexArray
    U: ComplexArray
    Y: ComplexArray

    def pole_factors(self, lam: ComplexArray) -> tuple[ComplexArray, ...]:
        """Factors of the input and of the transient, each with its derivative by μ."""
        r = 1 / (self.z[:, None] - lam)
        return r, r**2, self.z[:, None] * r, self.z[:, None] * r**2


def stretches(records: Sequence[Record], su: Array, sy: Array, shortest: int) -> list[Stretch]:
    """Scaled stretches between missing samples, at least ``shortest``: two more than the order."""
    found = []
    for record in records:
        for start, end in runs(np.asarray(np.isfinite(record.y).all(axis=1))):
            if end - start >= shortest:
                y = record.y[start:end] / sy
                v = np.hstack([record.u[start:end] / su, y])
                found.append(Stretch(v, y, np.ones((len(y), 1))))
    if not found:
        raise ValueError(
            f"no {shortest} samples in a row have all outputs, which an order of {shortest - 2} "
            "needs to be refined; lower the order, or refine=False"
        )
    return found


def refine_samples(
    system: StateSpace, K: Array, records: Sequence[Record], su: Array, sy: Array, mask: BoolArray
) -> tuple[StateSpace, Array, SampledUncertainty]:
    """Refine a discrete black box on its records; A - KC is stable before and after.

    The records are equidistant, of one interval; missing outputs split them. Channels are scaled by
    ``su`` (nu,) and ``sy`` (ny,); the direct term stays as it is where ``mask`` (ny, nu) is
    False. Also returns the asymptotic covariance.
    """
    nu, ny, nx = len(su), len(sy), system.nx
    data: Sequence[Stretch] = stretches(records, su, sy, nx + 2)
    free = np.argwhere(np.hstack([mask, np.zeros((ny, ny), dtype=bool)]))
    scales = np.concatenate([su, sy])
    both = np.hstack([system.B - K @ system.D, K])
    direct = np.hstack([system.D, np.zeros((ny, ny))])
    predictor = StateSpace(system.A - K @ system.C, both, system.C, direct)
    modal = modes.to_modal(predictor, scales, sy, np.hstack([mask, np.zeros((ny, ny), bool)]))
    modal, W, data = fitted(modal, data, free, STEPS, local=False)
    H, _ = normal_equations(modal, data, W, free)
    rows = sum(stretch.y.size for stretch in data)
    used = len(H) + len(data) * (nx + ny)
    factor = modes.covariance_factor(H, modal) * np.sqrt(rows / max(rows - used, 1))
    found = modes.from_modal(modal, scales, sy, predictor)
    C, D, gain = found.C, found.D[:, :nu], found.B[:, nu:]
    A, B = found.A + gain @ C, found.B[:, :nu] + gain @ D
    refined = replace(system, A=A, B=B, C=C, D=D, states=())
    return refined, gain, SampledUncertainty(modal, free, factor, nu, float(system.dt or 1.0))


def fitted(
    modal: modes.Modal, data: Sequence[Stretch], free: np.ndarray, steps: int, *, local: bool
) -> tuple[modes.Modal, Array, Sequence[Stretch]]:
    """Maximum likelihood by at most ``steps`` steps in each of `ROUNDS` rounds.

    The model's poles stay within the disc of `RADIUS`; W (ny, ny), Wᵀ W the inverse covariance of
    its errors; the data, whose errors are weighted by their local level if ``local``.
    """
    modal = _inside(modal)
    W: Array = np.eye(len(modal.D))
    for _ in range(ROUNDS):
        W = _whitener(modal, data, W)
        if local:
            data = _levelled(modal, data, W)
            W = _whitener(modal, data, W)
        known = lru_cache(1)(partial(_all_states, data=data, W=W))  # of the last trial
        modal = modes.descend(
            modal,
            cost=partial(_cost, known=known, W=W),
            normal=partial(_normal, known=known, data=data, W=W, free=free),
            tidy=_inside,
            free=free,
            steps=steps,
            settled=SETTLED,
        )
    return modal, _whitener(modal, data, W), data


def _inside(modal: modes.Modal) -> modes.Modal:
    """The predictor's poles within the disc of `RADIUS`."""
    shrink = np.minimum(1, RADIUS / np.maximum(np.abs(modal.lam), 1e-9))
    return replace(modal, lam=np.asarray(modal.lam * shrink))


def _filtered(lam: ComplexArray, w: Array | ComplexArray) -> ComplexArray:
    """x⁺ = μ x + w from rest, for every mode; w (N, nm, ...)."""
    out = np.empty(w.shape, dtype=complex)
    for m, pole in enumerate(lam):
        out[:, m] = scipy.signal.lfilter([0.0, 1.0], [1.0, -pole], w[:, m], axis=0)
    return out


def _real(phi: ComplexArray, modal: modes.Modal) -> Array:
    """Real basis of modal signals (N, ..., nm); see `casid.subspace.modal.pair`."""
    sums = np.where(modal.real, 1.0, 2.0) * phi.real
    return np.concatenate([sums, -2.0 * phi.imag[..., ~modal.real]], axis=-1)


def _centred(signal: Array, weight: Array) -> Array:
    """A signal (N, c) weighted, a free constant eliminated."""
    mean = (weight**2 * signal).sum(axis=0) / np.sum(weight**2)
    return np.asarray(weight * (signal - mean))


def _decay(modal: modes.Modal, N: int) -> ComplexArray:
    """μ^k, (N, nm); each doubling of the rows takes one product."""
    rows, step = np.ones((1, len(modal.lam)), dtype=complex), modal.lam
    while len(rows) < N:
        rows, step = np.concatenate([rows, rows * step]), step * step
    return np.asarray(rows[:N])


def _states(modal: modes.Modal, stretch: Stretch, W: Array) -> States:
    """States and their decay (N, nm) from the best initial state, and weighted errors (N, ny)."""
    decay = _decay(modal, len(stretch.v))
    forced = _filtered(modal.lam, stretch.v @ modal.B.T)
    basis = _centred(_real(decay, modal), stretch.weight)
    twice = np.where(modal.real, 1.0, 2.0)
    y = (forced @ (modal.C * twice).T).real + stretch.v @ modal.D.T
    e = _centred(stretch.y - y, stretch.weight)
    n = basis.shape[1]
    G = basis.T @ np.hstack([basis, e])
    T = modes.mixing(modal.C, modal.real)
    whitened = np.tensordot(W, T, 1)
    across = whitened.swapaxes(1, 2)
    left = (across @ G[:, :n] @ whitened).sum(axis=0)
    right = (across @ (W @ G[:, n:].T)[:, :, None]).sum(axis=0)[:, 0]
    small = 1e-13 * np.trace(left) / n * np.eye(n)
    x0 = np.linalg.solve(left + small, right)
    seen = basis @ (T @ x0).T
    return forced + decay * modes.to_complex(modal, x0, 1)[:, 0], decay, e - seen


def _all_states(modal: modes.Modal, data: Sequence[Stretch], W: Array) -> list[States]:
    """States of every stretch, see `_states`."""
    return [_states(modal, each, W) for each in data]


def prediction_errors(modal: modes.Modal, data: Sequence[Stretch], W: Array) -> list[Array]:
    """Weighted errors (N, ny) of every stretch with its best initial state and constant."""
    return [e for *_, e in _all_states(modal, data, W)]


def _whitener(modal: modes.Modal, data: Sequence[Stretch], W: Array) -> Array:
    """W (ny, ny) with Wᵀ W the inverse covariance of prediction errors; from the one before."""
    E = np.vstack(prediction_errors(modal, data, W))
    R = E.T @ E / len(E) + FLOOR**2 * np.eye(len(W))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(R)))


def _levelled(modal: modes.Modal, data: Sequence[Stretch], W: Array) -> list[Stretch]:
    """The data with errors weighted by the inverse of their local level."""
    # The level is that of all outputs' whitened errors. The weights' geometric mean is one, so that
    # the covariance of weighted errors still is the likelihood.
    pairs = zip(prediction_errors(modal, data, W), data, strict=True)
    power = [np.mean((E @ W.T / s.weight) ** 2, axis=1, keepdims=True) for E, s in pairs]
    least = LEAST**2 * np.mean(np.vstack(power))
    smooth = scipy.ndimage.gaussian_filter1d
    level = [np.sqrt(smooth(each, NEAR, axis=0) + least) for each in power]
    typical = np.exp(np.mean(np.log(np.vstack(level))))
    return [replace(s, weight=typical / each) for s, each in zip(data, level, strict=True)]


def _cost(modal: modes.Modal, known: Known, W: Array) -> float:
    return sum(float(np.sum((E @ W.T) ** 2)) for *_, E in known(modal))


def normal_equations(
    modal: modes.Modal, data: Sequence[Stretch], W: Array, free: np.ndarray
) -> tuple[Array, Array]:
    """Σ Jᵀ R⁻¹ J and Σ Jᵀ R⁻¹ e, initial states and constants eliminated; see `_normal`."""
    return _normal(modal, partial(_all_states, data=data, W=W), data, W, free)


def _normal(
    modal: modes.Modal, known: Known, data: Sequence[Stretch], W: Array, free: np.ndarray
) -> tuple[Array, Array]:
    """Normal equations of a Gauss-Newton step.

    Parameters are μ, [B - KD, K] and C by mode (real parts, then imaginary ones), and the free
    entries of D.
    """
    ny, nv = modal.D.shape
    n = modal.order
    size = n + n * nv + ny * n + len(free)
    q = n * (3 + nv) + nv  # signals that derivatives are made of
    T = np.zeros((ny, q, n + size))
    for o in range(ny):
        J, where = modes.output_derivative(np.eye(q), modal, o, free)
        T[o][:, where] = J
    seen = np.einsum("io,oqp->iqp", W, T)  # whitened outputs' derivatives, in signals

    total = np.zeros((size + 1, size + 1))
    for stretch, (x, decay, e) in zip(data, known(modal), strict=True):
        v = np.repeat(stretch.v[:, None], len(modal.lam), axis=1)
        slope, channels = _filtered(modal.lam, x), _filtered(modal.lam, v)
        S = _centred(
            np.hstack(
                [
                    _real(decay, modal),
                    _real(slope, modal),
                    _real(channels.swapaxes(1, 2), modal).reshape(len(x), -1),
                    _real(x, modal),
                    stretch.v,
                ]
            ),
            stretch.weight,
        )
        gram = S.T @ np.hstack([S, e @ W.T])
        G = np.zeros((n + size + 1, n + size + 1))
        for i in range(ny):
            G[:-1, :-1] += seen[i].T @ gram[:, :q] @ seen[i]
            G[:-1, -1] += seen[i].T @ gram[:, q + i]
        G[-1, :-1] = G[:-1, -1]
        total += modes.schur(G, n)
    return total[:-1, :-1], total[:-1, -1]
