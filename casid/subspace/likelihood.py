"""What a modal model leaves of Fourier transforms, with the best transient of every record.

    E = Y - Σ_m c_m (ρ_m b_m U + ζ_m δ_m) - D U

weighted by residual spectra that are estimated from the residuals themselves: the likelihood that
`casid.subspace.refinement` maximises.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.subspace import modal as modes
from casid.subspace.fourier import Lines, Spectrum
from casid.subspace.pooled_spectra import Alike, Drive, fewest
from casid.subspace.weighing import smoothed


@dataclass(frozen=True, eq=False)
class Factors:
    """Pole factors of one spectrum for the modes and, zero for real ones, their conjugates."""

    real: BoolArray
    r: ComplexArray
    rc: ComplexArray
    slope: ComplexArray
    slope_c: ComplexArray
    transient: ComplexArray
    transient_c: ComplexArray
    drift: ComplexArray
    drift_c: ComplexArray

    @cached_property
    def shared(self) -> Array:
        """What transients do to all outputs but for their C, real over imaginary parts, (2K, n)."""
        return modes.stacked(modes.pair(self.transient, self.transient_c, self.real))

    @cached_property
    def orthogonal(self) -> tuple[Array, Array]:
        """Orthonormal basis (2K, n) of that, and what it is in it."""
        Q, R = np.linalg.qr(self.shared)
        return Q, R


def factors(modal: modes.Modal, spectrum: Lines) -> Factors:
    """``slope`` and ``drift`` are the derivatives of ``r`` and ``transient`` by λ."""
    both = spectrum.pole_factors(np.concatenate([modal.lam, modal.lam.conj()]))
    r, slope, transient, drift = (each[:, : len(modal.lam)] for each in both)
    rc, slope_c, transient_c, drift_c = (
        np.where(modal.real, 0.0, each[:, len(modal.lam) :]) for each in both
    )
    return Factors(modal.real, r, rc, slope, slope_c, transient, transient_c, drift, drift_c)


def all_factors(modal: modes.Modal, data: Sequence[Spectrum]) -> Iterator[Factors]:
    """Pole factors of every spectrum, which records of one length and sampling share."""
    known: dict[tuple[object, ...], Factors] = {}
    for spectrum in data:
        if spectrum.grid not in known:
            known[spectrum.grid] = factors(modal, spectrum)
        yield known[spectrum.grid]


def forced(modal: modes.Modal, spectrum: Lines, f: Factors) -> ComplexArray:
    """Output residual without transient, (..., K, ny)."""
    U = spectrum.U
    X, Xc = f.r * (U @ modal.B.T), f.rc * (U @ modal.B.conj().T)
    return spectrum.Y - X @ modal.C.T - Xc @ modal.C.conj().T - U @ modal.D.T


def without_transients(modal: modes.Modal, data: Sequence[Spectrum]) -> list[ComplexArray]:
    """Residuals (K, ny) of every spectrum with its best transient."""
    # What a transient does to an output are sums of n signals that all share, so that the least
    # squares over all lines of all outputs are those over n rows of each, Q their orthogonal basis.
    found: list[ComplexArray] = []
    mix = modes.mixing(modal.C, modal.real)
    for spectrum, f in zip(data, all_factors(modal, data), strict=True):
        E, (Q, R) = forced(modal, spectrum, f), f.orthogonal
        seen, target = R @ mix, modes.stacked(E)
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
    grids = {spectrum.grid: np.log(spectrum.omega) for spectrum in data}
    levels = {grid: smoothed(at, omega, power) for grid, at in grids.items()}
    weights = {grid: 1 / np.sqrt(level + floor) for grid, level in levels.items()}
    return [weights[spectrum.grid] for spectrum in data]


class Part(NamedTuple):
    """Of spectra alike what a model leaves of them, with the best transient of each."""

    lines: Alike
    f: Factors
    E: ComplexArray  # (R, K, ny) residuals but for transients
    delta: ComplexArray  # (R, nm) transients
    cost: Array  # (R,) weighted squares that are left

    def drive(self) -> Drive:
        """What its signals are made of, in as few stretches as have the same products."""
        return fewest(self.lines.U, self.delta, self.E, self.f.real)


def parts(modal: modes.Modal, groups: Sequence[Alike]) -> list[Part]:
    """What a model leaves of groups of spectra."""
    mix, found = modes.mixing(modal.C, modal.real), []
    for lines in groups:
        f = factors(modal, lines)
        E = forced(modal, lines, f)
        e = modes.stacked(E * lines.w).swapaxes(1, 2).reshape(len(E), -1)
        found.append(Part(lines, f, E, *_transients(f, lines.w, mix, e)))
    return found


def _transients(f: Factors, w: Array, mix: Array, e: Array) -> tuple[ComplexArray, Array]:
    """The best transients δ (R, nm) for weighted residuals (R, ny 2K), and squares left of each."""
    n = mix.shape[1]
    seen = mix.swapaxes(1, 2) @ (f.shared.T * np.hstack([w.T, w.T])[:, None])
    rows = seen.swapaxes(0, 1).reshape(n, -1)
    right = rows @ e.T
    delta = modes.eliminator(np.hstack([rows @ rows.T, right]), n)
    found = delta[: len(f.real)].astype(complex)
    found[~f.real] += 1j * delta[len(f.real) :]
    return found.T, np.sum(e**2, axis=1) - np.sum(right * delta, axis=0)
