"""Noise that a controller feeds back into the inputs, and how far it biases a response.

Inputs that carry the outputs' noise v bias a response found from them, whatever the method, by

    Ĝ − G = Φ_vu Φ_u⁻¹                    (L. Ljung, System Identification, 2nd ed., section 13.4),

up to the controller's inverse where nothing else moves them. An autoregression of z = (y, u),
A(q) z = e, e of covariance S (`casid.excitations`), tells the noise from what the inputs make,

    Φ_vu = (A_yy − D A_uy)⁻¹ (S_y − D S_u) H_uᴴ,      H = A⁻¹, rows of outputs y and of inputs u,

D the direct term of the outputs. Noise and controller are smooth in frequency, and one with few
lags of all flights together is enough for Φ_vu. What comes from outside need not be smooth: Φ_u is
that of the estimate itself. Where an input's spectrum falls off steeply, few lags do not see it,
and `casid.frequency.sampling.excited_ends` tells where it ends.

Few lags take slow motion for noise too, of helicopters up to 10⁴ times what there is. What inputs
leave of the outputs is

    Φ_y|u = ([Φ_z⁻¹]_yy)⁻¹,      Φ_z⁻¹ = Aᴴ S⁻¹ A,

and an estimate's residuals measure it: where these are less, so is the noise.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from casid.arrays import Array, BoolArray, ComplexArray
from casid.channels import FORCES
from casid.errors import DataWarning
from casid.excitations import Flights, flights
from casid.frequency.leakage import over_three
from casid.frequency.spectra import Conditioned
from casid.record import Record
from casid.vector_autoregression import VectorAutoregression

CHANCE = 2.0  # times the squared coherence of noise and inputs that is expected by chance
LEVEL = 1e-4  # of the test whether inputs follow an output's noise at all
OCTAVE = 1.0  # on either side of a frequency: over which noise is smooth
MUCH = 0.5  # of a response, the largest bias that an error states


@dataclass(frozen=True, eq=False)
class NoiseInInputs:
    """Noise of outputs that inputs carry, at K frequencies; spectra are two-sided, per Hz."""

    omega: Array  # (K,) [rad/s]
    cross: ComplexArray  # (K, ny, nu) of noise and inputs
    left: Array  # (K, ny) of outputs, what inputs do not explain

    @classmethod
    def none(cls, omega: Array, ny: int, nu: int) -> "NoiseInInputs":
        """Inputs that carry none."""
        return cls(omega, np.zeros((len(omega), ny, nu), complex), np.ones((len(omega), ny)))

    def of(self, outputs: Sequence[int]) -> "NoiseInInputs":
        """That of some outputs, by their places."""
        return NoiseInInputs(self.omega, self.cross[:, outputs], self.left[:, outputs])

    def share(self, left: Array) -> Array:
        """Share (K, ny) of this noise that there is where an estimate leaves (K, ny) of outputs.

        In a gap of the excitation inputs explain noise too; it is smooth, and the most that is left
        within an octave tells its level.
        """
        near = np.abs(np.log2(self.omega[:, None] / self.omega)) < OCTAVE
        most = np.max(np.where(near[:, :, None], np.nan_to_num(left), 0.0), axis=1)
        return np.asarray(np.minimum(most / self.left, 1.0))


def noise_in_inputs(
    records: Sequence[Record], omega: Array, *, later: bool = False
) -> NoiseInInputs:
    """Noise of the outputs in the inputs, at omega (K,) [rad/s].

    Inputs that act a sample ``later`` at the earliest, as references do through a controller, tell
    more: what they share with outputs in one sample is feedback.

    None where it is no more than chance, where nothing tells noise from what the inputs make, and
    of channels that rest.
    """
    first = records[0]
    nothing = NoiseInInputs.none(omega, first.ny, first.nu)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # of gaps, which others tell
        try:
            flown = flights(records, together=True)
        except ValueError:
            return nothing
    if flown.singular:
        return nothing
    rows = [first.outputs.index(name) for name in flown.outputs]
    columns = [first.inputs.index(name) for name in flown.inputs]
    size = flown.size[: len(rows), None] * flown.size[len(rows) :]
    held = first.hold == "zoh"
    found = flown.dt * size * _significant(flown, omega, held=held, later=later)
    if held:  # as the inputs' own spectra
        jh = 1j * omega * first.dt
        found = found * ((1 - np.exp(-jh)) / jh).conj()[:, None, None]
    cross, left = nothing.cross.copy(), nothing.left.copy()
    cross[:, np.array(rows)[:, None], columns] = found
    (model,) = flown.models
    unexplained = _left(model, omega * flown.dt, len(rows))
    left[:, rows] = flown.dt * flown.size[: len(rows)] ** 2 * unexplained
    return NoiseInInputs(omega, cross, left)


def bias_of_windows(
    noise: NoiseInInputs, parts: Sequence[Conditioned], W: Array, G: ComplexArray
) -> Array:
    """Relative bias (K, ny, nu) of a response G averaged over window lengths with weights W.

    Spectra of windows are one-sided, per rad/s.
    """
    inverse = np.array([part.inverse for part in parts])
    W = W * np.array([noise.share(np.pi * part.left) for part in parts])[..., None]
    # Of conj(U_a) U_b: the transpose of what stands beside noise times conjugate inputs.
    return relative(np.einsum("wkij,kia,wkja->kij", W, noise.cross / np.pi, inverse), G)


def relative(bias: ComplexArray, G: ComplexArray) -> Array:
    """Magnitudes of biases as shares of a response, a mean of three neighbouring frequencies."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.minimum(np.nan_to_num(np.abs(bias) / np.abs(G)), 1.0)
    return np.asarray(np.sqrt(over_three(share**2)))


def _significant(flown: Flights, omega: Array, *, held: bool, later: bool) -> ComplexArray:
    """The cross-spectrum of channels that move, each as large as its root mean square.

    What inputs and outputs share in one sample is the outputs' direct term or feedback. A line from
    sample to sample acts in the last one already, and what is taken is the smaller of both. Steps
    that are ``held`` do not, but on forces: where past outputs are fed back, so are present ones.
    """
    found = _beyond_chance(flown, np.isin(flown.outputs, FORCES), omega)
    if later:
        return found
    least = _beyond_chance(flown, np.ones(len(flown.outputs), dtype=bool), omega)
    if not least.any():
        return least
    return found if held else np.where(np.abs(least) < np.abs(found), least, found)


def _beyond_chance(flown: Flights, direct: BoolArray, omega: Array) -> ComplexArray:
    """The cross-spectrum less what p lags and N samples make of noise that is not fed back.

    That has the squared coherence p/N with each input, in the mean over all frequencies χ² of p
    degrees of freedom: pairs in which it is no more are left out.
    """
    (model,) = flown.models
    lags = len(model.A)
    grid = np.pi * (np.arange(2 * lags) + 0.5) / (2 * lags)
    cross, noise, power = _spectra(model, direct, np.concatenate([grid, omega * flown.dt]))
    squared, by_chance = np.abs(cross) ** 2, lags / model.rows * noise[:, :, None] * power[:, None]
    size = np.mean((squared / by_chance)[: len(grid)], axis=0)
    left = np.maximum(squared - CHANCE * by_chance, 0.0) * (size > chdtri(lags, LEVEL) / lags)
    return np.asarray(cross * np.sqrt(left / np.maximum(squared, 1e-300)))[len(grid) :]


def _left(model: VectorAutoregression, phase: Array, ny: int) -> Array:
    """Density (K, ny) of outputs that past and future inputs do not explain."""
    A = model.polynomial(phase)[:, :, :ny]
    inverse = A.conj().swapaxes(1, 2) @ np.linalg.solve(model.S, A)  # the outputs' block of Φ_z⁻¹
    return np.asarray(np.einsum("kii->ki", np.linalg.inv(inverse)).real)


def _spectra(
    model: VectorAutoregression, direct: BoolArray, phase: Array
) -> tuple[ComplexArray, Array, Array]:
    """Of noise and inputs (K, ny, nu), of noise (K, ny) and of inputs (K, nu)."""
    ny, S = len(direct), model.S
    D = np.zeros((ny, len(S) - ny))
    if direct.any():
        before = [*np.flatnonzero(~direct), *range(ny, len(S))]
        gain = np.linalg.solve(S[np.ix_(before, before)], S[np.ix_(before, np.flatnonzero(direct))])
        D[direct] = gain[(~direct).sum() :].T
    A = model.polynomial(phase)
    H = np.linalg.inv(A)
    v = np.linalg.inv(A[:, :ny, :ny] - D @ A[:, ny:, :ny])
    own = S[:ny] - D @ S[ny:]
    cross = v @ own @ H[:, ny:].conj().swapaxes(1, 2)
    noise = np.einsum("kij,jl,kil->ki", v, own[:, :ny] - own[:, ny:] @ D.T, v.conj()).real
    power = np.einsum("kij,jl,kil->ki", H[:, ny:], S, H[:, ny:].conj()).real
    return cross, noise, power
