"""Slopes of what a modal model leaves of Fourier transforms, and their normal equations.

Parameters are λ, B, C by mode (real parts, then imaginary ones) and the free entries of D; the
transient of every record is eliminated.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.subspace import modal as modes
from casid.subspace.fourier import Lines, Spectrum
from casid.subspace.likelihood import Factors, Part, factors, forced, parts


def normal_equations(
    modal: modes.Modal,
    data: Sequence[Spectrum],
    weights: Sequence[Array],
    free: np.ndarray,
    known: Callable[[modes.Modal], list[Part]] | None = None,
) -> tuple[Array, Array]:
    """Re Σ Jᴴ W J and Re Σ Jᴴ W E; the parts of a model may be ``known``."""
    # All derivatives of an output are sums of signals that all outputs share, in a small number
    # that its row of C gives: these sums are taken of the Gram matrices, not of the signals.
    n, mix = modal.order, modes.mixing(modal.C, modal.real)
    ny, nu = modal.D.shape
    size = n + n * nu + ny * n + len(free)
    grams, heads = _shared_grams(
        modal, data, weights, known(modal) if known else parts(modal, data, weights)
    )
    wholes = modes.seen(modes.seen(grams, mix, nu).swapaxes(1, 2), mix, nu)
    tops = mix.swapaxes(1, 2) @ modes.seen(heads, mix, nu)
    total = np.zeros((size + 1, size + 1))
    sides = np.zeros((len(data), n, n + size + 1))
    common = (2 + nu) * n  # signals of the transient, λ and B, by which all outputs have slopes
    shared = modes.places(modal, 0, free)[1][:common]
    total[np.ix_(shared[n:] - n, shared[n:] - n)] = wholes[:, n:common, n:common].sum(axis=0)
    sides[:, :, shared] = tops[..., :common].sum(axis=1)
    for o, whole in enumerate(wholes):
        which, where = (part[common:] for part in modes.places(modal, o, free))
        which, where = np.append(which, -1), np.append(where, n + size)  # the error
        across = whole[n:common, which]
        total[np.ix_(shared[n:] - n, where - n)] += across
        total[np.ix_(where - n, shared[n:] - n)] += across.T
        total[np.ix_(where - n, where - n)] += whole[np.ix_(which, which)]
        sides[:, :, where] += tops[:, o][:, :, which]
    others = sides[:, :, n:].reshape(-1, size + 1)
    total -= others.T @ modes.eliminator(sides, n).reshape(-1, size + 1)
    return total[:-1, :-1], total[:-1, -1]


def _shared_grams(
    modal: modes.Modal, data: Sequence[Spectrum], weights: Sequence[Array], known: Sequence[Part]
) -> tuple[Array, Array]:
    """Gram matrices of the signals that span all derivatives, and the error, as outputs weigh them.

    Their sums over all spectra (ny, m, m), and the rows of each spectrum's transient
    (spectra, ny, n, m).
    """
    n, (ny, nu) = modal.order, modal.D.shape
    m = n * (2 + nu) + nu + 1
    grams, heads = np.zeros((ny, m, m)), np.empty((len(data), ny, n, m))
    for spectrum, w, head, (f, E, delta, _) in zip(data, weights, heads, known, strict=True):
        signals = _signals(modal, spectrum, delta, f)
        rows = np.empty((2 * len(signals), m))
        rows[:, :-1] = modes.stacked(signals)
        weighted = np.empty_like(rows)
        for o, (e, scale) in enumerate(zip(modes.stacked(E).T, np.vstack([w, w]).T, strict=True)):
            rows[:, -1] = e
            found = modes.gram(np.multiply(rows, scale[:, None], out=weighted))
            head[o] = found[:n]
            grams[o] += found
    return _with_states(modal, grams, heads, np.array([part.delta for part in known]))


def _with_states(
    modal: modes.Modal, grams: Array, heads: Array, delta: ComplexArray
) -> tuple[Array, Array]:
    """The same with those of the states, which are sums of what inputs and transients do."""
    n, nu = modal.order, modal.B.shape[1]
    B, C = slice(2 * n, (2 + nu) * n), (2 + nu) * n
    P = modes.mixing(modal.B.T, modal.real).reshape(-1, n)  # of inputs
    T = modes.mixing(delta, modal.real)[:, None]  # of each spectrum's transient
    tops = heads[..., B] @ P + heads[..., :n] @ T
    along = grams[..., B] @ P + np.sum(heads.swapaxes(2, 3) @ T, axis=0)
    square = P.T @ along[:, B] + np.sum(T.swapaxes(2, 3) @ tops, axis=0)
    wide = np.concatenate([grams[..., :C], along, grams[..., C:]], axis=2)
    row = np.concatenate([along[:, :C], square, along[:, C:]], axis=1).swapaxes(1, 2)
    whole = np.concatenate([wide[:, :C], row, wide[:, C:]], axis=1)
    return whole, np.concatenate([heads[..., :C], tops, heads[..., C:]], axis=3)


def with_outputs(
    modal: modes.Modal,
    data: Sequence[Spectrum],
    weights: Sequence[Array],
    free: np.ndarray,
    known: Callable[[modes.Modal], list[Part]] | None = None,
) -> modes.Modal:
    """The C and free D that leave least, of given λ and B with the transients that were best.

    Of these the residuals are linear: no Gauss-Newton step has to find them along a curved valley.
    Source: A. Ruhe, P.-A. Wedin, SIAM Review 22 (1980), algorithm 3.
    """
    found = known(modal) if known else parts(modal, data, weights)
    n, (ny, nu) = modal.order, modal.D.shape
    rows = np.vstack(
        [
            modes.stacked(np.hstack([_states(modal, lines, part.delta, part.f), lines.U]))
            for lines, part in zip(data, found, strict=True)
        ]
    )
    left = np.vstack([modes.stacked(_left(modal, part)) for part in found])
    w = np.vstack([each for own in weights for each in (own, own)])
    direct = np.zeros((ny, nu), dtype=bool)
    direct[free[:, 0], free[:, 1]] = True
    grams = np.empty((ny, n + nu, n + nu + 1))
    for o in range(ny):
        own = np.column_stack([rows, left[:, o]]) * w[:, o, None]
        own[:, n:-1] *= direct[o]
        grams[o] = modes.gram(own)[:-1]
    step = modes.eliminator(grams, n + nu)[..., 0]
    C = modal.C + np.array([modes.to_complex(modal, own, 1)[:, 0] for own in step[:, :n]])
    return replace(modal, C=C, D=modal.D + direct * step[:, n:])


def _left(modal: modes.Modal, part: Part) -> ComplexArray:
    """Residuals (K, ny) with the best transient."""
    f = part.f
    ends, ends_c = f.transient * part.delta, f.transient_c * part.delta.conj()
    return part.E - ends @ modal.C.T - ends_c @ modal.C.conj().T


def linearised(
    modal: modes.Modal, data: Sequence[Spectrum], weights: Sequence[Array]
) -> list[tuple[ComplexArray, ComplexArray]]:
    """Residuals (K, ny) but for transients, and what spans their slopes, of every spectrum."""
    found = zip(data, parts(modal, data, weights), strict=True)
    return [(part.E, _basis(modal, lines, part.delta, part.f)) for lines, part in found]


def _signals(modal: modes.Modal, spectrum: Lines, delta: ComplexArray, f: Factors) -> ComplexArray:
    """Signals of the transient, λ, B and D; see `casid.subspace.modal.seen`."""
    U, real = spectrum.U, modal.real
    poles = f.slope * (U @ modal.B.T) + f.drift * delta
    poles_c = f.slope_c * (U @ modal.B.conj().T) + f.drift_c * delta.conj()
    by_input = U[:, :, None] * modes.pair(f.r, f.rc, real)[:, None]
    return np.hstack(
        [
            modes.pair(f.transient, f.transient_c, real),
            modes.pair(poles, poles_c, real),
            by_input.reshape(len(U), -1),
            U,
        ]
    )


def _basis(modal: modes.Modal, spectrum: Lines, delta: ComplexArray, f: Factors) -> ComplexArray:
    """The signals with those of the states before those of D."""
    S, nu = _signals(modal, spectrum, delta, f), modal.B.shape[1]
    return np.hstack([S[:, :-nu], _states(modal, spectrum, delta, f), S[:, -nu:]])


def _states(modal: modes.Modal, spectrum: Lines, delta: ComplexArray, f: Factors) -> ComplexArray:
    """What inputs and transients do to the states, (K, n)."""
    x = f.r * (spectrum.U @ modal.B.T) + f.transient * delta
    xc = f.rc * (spectrum.U @ modal.B.conj().T) + f.transient_c * delta.conj()
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
        basis = _basis(modal, unit, np.zeros(len(modal.lam), dtype=complex), f)
        G[:, :, j] = -forced(modal, unit, f)
        for o in range(ny):
            J, where = modes.output_derivative(basis, modal, o, free)
            dG[:, o, j, where[n:] - n] = J[:, n:]
    return G, dG
