"""Slopes of what a modal model leaves of Fourier transforms, and their normal equations.

Parameters are λ, B, C by mode (real parts, then imaginary ones) and the free entries of D; the
transient of every record is eliminated.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.subspace import modal as modes
from casid.subspace.fourier import Lines
from casid.subspace.likelihood import Factors, Part, factors, forced
from casid.subspace.pooled_spectra import Drive


def normal_equations(
    modal: modes.Modal, known: Sequence[Part], free: np.ndarray
) -> tuple[Array, Array]:
    """Re Σ Jᴴ W J and Re Σ Jᴴ W E, of what a model leaves of spectra (`parts`)."""
    # All derivatives of an output are sums of signals that all outputs share, in a small number
    # that its row of C gives: these sums are taken of the Gram matrices, not of the signals.
    n, (ny, nu) = modal.order, modal.D.shape
    mix, blocks = modes.mixing(modal.C, modal.real), 1 + nu
    size = n + n * nu + ny * n + len(free)
    grams = np.sum([_grams(modal, part) for part in known], axis=0)
    wholes = modes.seen(modes.seen(grams, mix, blocks).swapaxes(1, 2), mix, blocks)
    total = np.zeros((size + 1, size + 1))
    for o, whole in enumerate(wholes):
        which, where = (place[n:] - n for place in modes.places(modal, o, free))
        which, where = np.append(which, -1), np.append(where, size)  # the error
        total[np.ix_(where, where)] += whole[np.ix_(which, which)]
    for part in known:
        own, sides = _sides(modal, part, mix, free)
        rows = sides.reshape(n, -1)
        ends = modes.eliminator(np.hstack([own, rows]), n)
        total -= sides.reshape(-1, size + 1).T @ ends.reshape(-1, size + 1)
    return total[:-1, :-1], total[:-1, -1]


def _grams(modal: modes.Modal, part: Part) -> Array:
    """Gram matrices (ny, m, m) of the signals that span all derivatives, and the error, weighed."""
    drive, w = part.drive(), np.vstack([part.lines.w, part.lines.w])
    signals = modes.stacked(_signals(modal, drive, part.f))
    R, K, m = signals.shape
    rows, weighed = np.empty((R, K, m + 1)), np.empty((R, K, m + 1))
    rows[..., :-1] = signals
    found = np.empty((len(modal.C), m + 1, m + 1))
    for o, e in enumerate(modes.stacked(drive.E).transpose(2, 0, 1)):
        rows[..., -1] = e
        np.multiply(rows, w[:, o, None], out=weighed)
        found[o] = modes.gram(weighed.reshape(-1, m + 1))
    return found


def _sides(modal: modes.Modal, part: Part, mix: Array, free: np.ndarray) -> tuple[Array, Array]:
    """What transients of spectra alike have in common with one another and with all parameters.

    Products of derivatives, weighed and summed over lines and outputs: (n, n) of the transients,
    the same for every stretch, and (n, R, parameters + 1) with the parameters and the error.
    """
    # Outputs are summed line by line, before the inputs of the stretches come in.
    n, (ny, nu), f, real = modal.order, modal.D.shape, part.f, modal.real
    U, w = part.lines.U, part.lines.w
    R, K = U.shape[:2]
    ends = modes.pair(f.transient, f.transient_c, real) @ mix  # (ny, K, n)
    heavy = ends * (w.T**2)[..., None]

    def across(r: ComplexArray, rc: ComplexArray) -> ComplexArray:
        """Products (K, n, n) of transients, and of modal signals as outputs see them."""
        other = modes.pair(r, rc, real) @ mix
        return np.asarray(heavy.transpose(1, 2, 0) @ other.conj().swapaxes(0, 1))

    flat = modes.stacked(U).swapaxes(0, 1).reshape(2 * K, -1)
    by_slope, by_input = (
        (modes.stacked(both.reshape(K, -1)).T @ flat).reshape(n, n, R, nu)
        for both in (across(f.slope, f.slope_c), across(f.r, f.rc))
    )
    drift = across(f.drift, f.drift_c).real.sum(axis=0) @ modes.mixing(part.delta, real)
    inputs = modes.mixing(modal.B.T, real)  # (nu, n, n)
    poles = np.einsum("iqrj,jqp->irp", by_slope, inputs, optimize=True) + drift.swapaxes(0, 1)
    rows = modes.stacked(heavy)  # (ny, 2K, n)
    x = modes.stacked(_states(modal, _whole(part), f)).swapaxes(0, 1).reshape(2 * K, -1)
    states = (rows.swapaxes(1, 2) @ x).reshape(ny, n, R, n)
    direct = (rows.swapaxes(1, 2) @ flat).reshape(ny, n, R, nu)
    left = modes.stacked(part.E).transpose(2, 1, 0).reshape(-1, R)
    sides = [
        poles,
        by_input.transpose(0, 2, 1, 3).reshape(n, R, -1),
        states.transpose(1, 2, 0, 3).reshape(n, R, -1),
        direct[free[:, 0], :, :, free[:, 1]].transpose(1, 2, 0),
        (rows.reshape(-1, n).T @ left)[..., None],
    ]
    own = modes.stacked(ends).reshape(-1, n).T @ rows.reshape(-1, n)
    return own, np.concatenate(sides, axis=2)


def with_outputs(modal: modes.Modal, known: Sequence[Part], free: np.ndarray) -> modes.Modal:
    """The C and free D that leave least, of given λ and B with the transients that were best.

    Of these the residuals are linear: no Gauss-Newton step has to find them along a curved valley.
    Source: A. Ruhe, P.-A. Wedin, SIAM Review 22 (1980), algorithm 3.
    """
    n, (ny, nu) = modal.order, modal.D.shape
    direct = np.zeros((ny, nu), dtype=bool)
    direct[free[:, 0], free[:, 1]] = True
    grams = np.zeros((ny, n + nu, n + nu + 1))
    for part in known:
        drive, w = part.drive(), np.vstack([part.lines.w, part.lines.w])
        rows = modes.stacked(np.concatenate([_states(modal, drive, part.f), drive.U], axis=2))
        left = modes.stacked(_left(modal, drive, part.f))
        for o in range(ny):
            own = np.concatenate([rows, left[..., o, None]], axis=2) * w[:, o, None]
            own[..., n:-1] *= direct[o]
            grams[o] += modes.gram(own.reshape(-1, n + nu + 1))[:-1]
    step = modes.eliminator(grams, n + nu)[..., 0]
    C = modal.C + np.array([modes.to_complex(modal, own, 1)[:, 0] for own in step[:, :n]])
    return replace(modal, C=C, D=modal.D + direct * step[:, n:])


def linearised(
    modal: modes.Modal, known: Sequence[Part]
) -> list[tuple[ComplexArray, ComplexArray]]:
    """Residuals (K, ny) but for transients, and what spans their slopes, of every spectrum."""
    found: dict[int, tuple[ComplexArray, ComplexArray]] = {}
    for part in known:
        basis = _basis(modal, _whole(part), part.f)
        found |= dict(zip(part.lines.which, zip(part.E, basis, strict=True), strict=True))
    return [found[i] for i in range(len(found))]


def _whole(part: Part) -> Drive:
    """What drives every stretch."""
    ends = part.delta[:, None]
    return Drive(part.lines.U, ends, ends.conj(), part.E)


def _left(modal: modes.Modal, drive: Drive, f: Factors) -> ComplexArray:
    """Residuals (R, K, ny) with the best transient."""
    ends, ends_c = f.transient * drive.delta, f.transient_c * drive.delta_c
    return np.asarray(drive.E - ends @ modal.C.T - ends_c @ modal.C.conj().T)


def _signals(modal: modes.Modal, drive: Drive, f: Factors) -> ComplexArray:
    """Signals of λ, B, C and D, (R, K, n (2 + nu) + nu); see `casid.subspace.modal.seen`."""
    U, real = drive.U, modal.real
    poles = f.slope * (U @ modal.B.T) + f.drift * drive.delta
    poles_c = f.slope_c * (U @ modal.B.conj().T) + f.drift_c * drive.delta_c
    by_input = U[..., None] * modes.pair(f.r, f.rc, real)[:, None]
    return np.concatenate(
        [
            modes.pair(poles, poles_c, real),
            by_input.reshape(*U.shape[:2], -1),
            _states(modal, drive, f),
            U,
        ],
        axis=2,
    )


def _basis(modal: modes.Modal, drive: Drive, f: Factors) -> ComplexArray:
    """The signals (R, K, m) with those of the transient before them."""
    ends, signals = modes.pair(f.transient, f.transient_c, modal.real), _signals(modal, drive, f)
    every = np.broadcast_to(ends, (*signals.shape[:2], modal.order))
    return np.concatenate([every, signals], axis=2)


def _states(modal: modes.Modal, drive: Drive, f: Factors) -> ComplexArray:
    """What inputs and transients do to the states, (R, K, n)."""
    x = f.r * (drive.U @ modal.B.T) + f.transient * drive.delta
    xc = f.rc * (drive.U @ modal.B.conj().T) + f.transient_c * drive.delta_c
    return modes.pair(x, xc, modal.real)


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
        none = np.zeros((1, 1, len(modal.lam)), dtype=complex)
        (basis,) = _basis(modal, Drive(unit.U[None], none, none, unit.Y[None]), f)
        G[:, :, j] = -forced(modal, unit, f)
        for o in range(ny):
            J, where = modes.output_derivative(basis, modal, o, free)
            dG[:, o, j, where[n:] - n] = J[:, n:]
    return G, dG
