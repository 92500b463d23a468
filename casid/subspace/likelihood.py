"""What a modal model leaves of Fourier transforms, with the best transient of every record.

    E = Y - Σ_m c_m (ρ_m b_m U + ζ_m δ_m) - D U

weighted by residual spectra that are estimated from the residuals themselves: the likelihood that
`casid.subspace.refinement` maximises.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.subspace import modal as modes
from casid.subspace.fourier import Lines, Spectrum
from casid.subspace.weighing import smoothed


@dataclass(frozen=True, eq=False)
class Factors:
    """Pole factors of one spectrum for the modes and, zero for real ones, their conjugates."""

    r: ComplexArray
    rc: ComplexArray
    slope: ComplexArray
    slope_c: ComplexArray
    transient: ComplexArray
    transient_c: ComplexArray
    drift: ComplexArray
    drift_c: ComplexArray


def factors(modal: modes.Modal, spectrum: Lines) -> Factors:
    """``slope`` and ``drift`` are the derivatives of ``r`` and ``transient`` by λ."""
    both = spectrum.pole_factors(np.concatenate([modal.lam, modal.lam.conj()]))
    r, slope, transient, drift = (each[:, : len(modal.lam)] for each in both)
    rc, slope_c, transient_c, drift_c = (
        np.where(modal.real, 0.0, each[:, len(modal.lam) :]) for each in both
    )
    return Factors(r, rc, slope, slope_c, transient, transient_c, drift, drift_c)


def all_factors(modal: modes.Modal, data: Sequence[Spectrum]) -> Iterator[Factors]:
    """Pole factors of every spectrum, which records of one length and sampling share."""
    known: dict[tuple[object, ...], Factors] = {}
    for spectrum in data:
        lines = len(spectrum.omega), spectrum.omega[0], spectrum.h, spectrum.hold
        if lines not in known:
            known[lines] = factors(modal, spectrum)
        yield known[lines]


def forced(modal: modes.Modal, spectrum: Lines, f: Factors) -> ComplexArray:
    """Output residual without transient, (K, ny)."""
    U = spectrum.U
    X, Xc = f.r * (U @ modal.B.T), f.rc * (U @ modal.B.conj().T)
    return spectrum.Y - X @ modal.C.T - Xc @ modal.C.conj().T - U @ modal.D.T


def without_transients(modal: modes.Modal, data: Sequence[Spectrum]) -> list[ComplexArray]:
    """Residuals (K, ny) of every spectrum with its best transient."""
    # What a transient does to an output are sums of n signals that all share, so that the least
    # squares over all lines of all outputs are those over n rows of each, Q their orthogonal basis.
    found: list[ComplexArray] = []
    for spectrum, f in zip(data, all_factors(modal, data), strict=True):
        E = forced(modal, spectrum, f)
        Q, R = np.linalg.qr(modes.stacked(modes.pair(f.transient, f.transient_c, modal.real)))
        seen, target = R @ modes.mixing(modal.C, modal.real), modes.stacked(E)
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


class Part(NamedTuple):
    """Of one spectrum its factors, residual (K, ny), best transient (nm,) and its cost."""

    f: Factors
    E: ComplexArray
    delta: ComplexArray
    cost: float


def parts(modal: modes.Modal, data: Sequence[Spectrum], weights: Sequence[Array]) -> list[Part]:
    """Parts of all spectra."""
    found, mix = [], modes.mixing(modal.C, modal.real)
    for spectrum, w, f in zip(data, weights, all_factors(modal, data), strict=True):
        E = forced(modal, spectrum, f)
        found.append(Part(f, E, *_transient(modal, f, E, w, mix)))
    return found


def _transient(
    modal: modes.Modal, f: Factors, E: ComplexArray, w: Array, mix: Array
) -> tuple[ComplexArray, float]:
    """The best transient δ (nm,) of one spectrum, and the weighted squared residual it leaves."""
    shared = modes.pair(f.transient, f.transient_c, modal.real)
    (K, n), ny = shared.shape, len(mix)
    rows = np.empty((ny, 2 * K, n + 1))  # what transients do to each output, but for its C, and E
    rows[:, :, :n], rows[:, :, n] = modes.stacked(shared), modes.stacked(E).T
    rows *= np.hstack([w.T, w.T])[:, :, None]
    mixed = np.zeros((ny, n + 1, n + 1))
    mixed[:, :n, :n], mixed[:, n, n] = mix, 1.0
    grams = mixed.swapaxes(1, 2) @ (rows.swapaxes(1, 2) @ rows) @ mixed
    G = grams.sum(axis=0)
    delta = modes.eliminator(G, n)[:, 0]
    return modes.to_complex(modal, delta, 1)[:, 0], float(G[n, n] - G[n, :n] @ delta)
