"""Spectra of windowed stretches of records, on any grid of frequencies.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapters 7 to
10 (*T&R* below): overlapped windows, averages over all windows of all records, conditioning of
several inputs, composite of several window lengths.

Departures: windows overlap by two thirds, which loses less of a sweep than the half of T&R (on the
sweeps of a linear helicopter with noise: 1.04 dB of rms error, 1.11 dB with half); the transform is
summed at the wanted frequencies themselves, which gives the values of the chirp z-transform and
takes any spacing; one averaged input matrix serves all records at once, so that inputs which move
together within each record (feedback) are separated by the records of the other axes; the noise of
a random error is that of neighbouring frequencies too, since few windows tell it to a factor of two
or three, and lengths weighed by their errors would be those whose error is too small by chance.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import psi

from casid import samples
from casid.arrays import Array, BoolArray, ComplexArray
from casid.record import Record

# Condition number of the inputs' coherence matrix; two inputs with coherence γ² have (1+γ)/(1-γ).
SUSPECT = 40.0  # γ² = 0.9: errors of one input's response spill into the other's
MEANINGLESS = 1000.0  # γ² = 0.996: what separates the inputs is leakage and noise
STEP = 1 / 3  # between windows, in window lengths
OVERLAP_FACTOR = np.sqrt(0.55)  # C_ε of T&R (7.35) for an overlap of half or more

NOISE_FREE = 1e-9  # share of an output's density, the least noise
LEAST = 0.5  # degrees of freedom of what windows leave
NEIGHBOURS = 0.2  # nepers over which the correlation of outputs is smoothed
NOISE = 0.15  # over which their noise is


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectra:
    """Averaged one-sided spectral densities of R records, per rad/s."""

    Guu: ComplexArray  # (R, K, nu, nu) averages of conj(U_a) U_b
    Guy: ComplexArray  # (R, K, nu, ny) of conj(U_a) Y_i
    Gyy: Array  # (R, K, ny) of |Y_i|²
    Gyz: ComplexArray  # (R, K, ny, ny) of conj(Y_i) Y_l
    averages: Array  # (R, K) windows that would fit without overlap
    count: Array  # (K,) windows used
    kept: Array  # (K,) power kept of the input that lost most in windows and records left out
    omega: Array  # (K,) [rad/s]
    references: tuple[ComplexArray, ComplexArray, ComplexArray] | None = None  # Grr, Gru, Gry

    @property
    def known(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Spectra with what noise does not drive: with the references, else with the inputs."""
        return self.references or (self.Guu, self.Guu, self.Guy)


@dataclass(frozen=True, eq=False, kw_only=True)
class Conditioned:
    """What one window length says of every pair, other inputs' parts removed.

    Gxy/Gxx is the response, |Gxy|²/(Gxx Gyy) the partial coherence.
    """

    Gxx: Array  # (K, ny, nu)
    Gxy: ComplexArray  # (K, ny, nu)
    Gyy: Array  # (K, ny, nu)
    random_error: Array  # (K, ny, nu)
    multiple_coherence: Array  # (K, ny)
    condition: Array  # (K,) of the inputs' coherence matrix
    inverse: ComplexArray | None = None  # (K, nu, nu) of the inputs' spectra
    output_correlation: ComplexArray | None = None  # (K, ny, ny) of the errors of two outputs
    input_correlation: ComplexArray | None = None  # (K, nu, nu) of those of two inputs
    driven: Array | None = None  # (K, nu) F of the references in inputs: one, by chance, if none
    undriven: Array | None = None  # (K, ny) of outputs, what references leave

    @property
    def response(self) -> ComplexArray:
        """Gxy/Gxx, (K, ny, nu)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.Gxy / self.Gxx)

    @property
    def left(self) -> Array:
        """Density (K, ny) of outputs that inputs, or references if there are any, leave."""
        if self.undriven is not None:
            return self.undriven
        return np.asarray(((1 - self.coherence) * self.Gyy).min(axis=2))

    @property
    def coherence(self) -> Array:
        """Partial coherence, (K, ny, nu)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.clip(np.abs(self.Gxy) ** 2 / (self.Gxx * self.Gyy), 0.0, 1.0)


def record_spectra(
    records: Sequence[Record],
    omega: Array,
    length: float,
    lost: Sequence[BoolArray] | None = None,
    references: int = 0,
) -> Spectra:
    """Spectra of each record, averaged over overlapped Hann windows of one length [s].

    The last inputs of the records, as many as there are ``references``, count as these.

    The records are equidistant, lost samples (N, ny) filled in: those that are NaN unless told. A
    record shorter than the window is left out, and so is, at each frequency, a window in which
    samples were lost for longer than a period; others weigh by their share of samples.
    """
    lost = [np.isnan(record.y) for record in records] if lost is None else lost
    sums, powers, counts = [], [], []
    for record, gone in zip(records, lost, strict=True):
        Z, Y = _windowed(record, omega, length)
        weight = _weights_of_windows(gone, record.dt, omega, length)  # (windows, K)
        total = weight.sum(axis=0)
        W = weight / np.where(total > 0, total, 1.0)
        # Inputs, then references.
        Gzz = np.einsum("wk,wka,wkb->kab", W, Z.conj(), Z, optimize=True)
        Gzy = np.einsum("wk,wka,wki->kai", W, Z.conj(), Y, optimize=True)
        Gyz = np.einsum("wk,wki,wkl->kil", W, Y.conj(), Y, optimize=True)
        Gyy = np.einsum("kii->ki", Gyz).real
        # n windows cover 1 + (n - 1)/3 lengths.
        averages = np.where(total > 0, 1 + np.maximum(total - 1, 0) * STEP, 0.0)
        sums.append((Gzz, Gzy, Gyy, Gyz, averages))
        powers.append(_powers(Z, weight, record, omega, length))
        counts.append((weight > 0).sum(axis=0))
    Gzz, Gzy, Gyy, Gyz, averages = (np.array(column) for column in zip(*sums, strict=True))
    kept, every = np.sum(powers, axis=0)
    n = records[0].nu - references
    told = (Gzz[:, :, n:, n:], Gzz[:, :, n:, :n], Gzy[:, :, n:])
    return Spectra(
        Guu=Gzz[:, :, :n, :n],
        Guy=Gzy[:, :, :n],
        Gyy=Gyy,
        Gyz=Gyz,
        averages=averages,
        count=np.sum(counts, axis=0),
        kept=np.min(kept / np.where(every > 0, every, 1.0), axis=1, initial=1.0),
        omega=omega,
        references=told if references else None,
    )


def _powers(
    Z: ComplexArray, weight: Array, record: Record, omega: Array, length: float
) -> tuple[Array, Array]:
    """Power of the inputs (K, nu) in windows that are used, and in the whole record.

    Each by the windows that would fit without overlap, in a shorter record a part of one.
    """
    if not len(Z):
        own = record.N * record.dt
        whole = np.abs(_windowed(record, omega, own)[0][0]) ** 2
        return np.zeros_like(whole), whole * (own / length)
    power = np.abs(Z) ** 2
    fit = (1 + (len(Z) - 1) * STEP) / len(Z)
    return fit * np.einsum("wk,wka->ka", weight > 0, power), fit * power.sum(axis=0)


def _weights_of_windows(lost: BoolArray, dt: float, omega: Array, length: float) -> Array:
    """Weight of each window at each frequency, (windows, K): 0 where too much is lost."""
    # Else its share of samples over that of the record's best one: a channel at a rate of its own
    # costs nothing but what its noise shows.
    M = round(length / dt)
    pieces = [lost[i : i + M] for i in _starts(len(lost), M)]
    present = np.array([1 - gone.mean(axis=0).max() for gone in pieces])
    runs = np.array([max(map(longest_run, gone.T)) if gone.any() else 0 for gone in pieces])
    usable = 2 * np.pi / omega >= dt * runs[:, None]
    return np.asarray(usable * (present / max(present.max(initial=0.0), 1e-300))[:, None])


def longest_run(lost: BoolArray) -> int:
    """Most samples in a row that are lost."""
    return int(np.max(np.diff(samples.runs(lost)), initial=0))


def transform(x: Array, dt: float, omega: Array) -> ComplexArray:
    """∫ x exp(-jωt) dt of tapered stretches: (windows, M, channels) to (windows, K, channels)."""
    W = dt * np.exp(-1j * np.outer(omega, dt * np.arange(x.shape[1])))  # (K, M)
    return np.asarray(np.einsum("km,wmc->wkc", W, x, optimize=True))


def _windowed(record: Record, omega: Array, length: float) -> tuple[ComplexArray, ComplexArray]:
    """Scaled transforms of inputs and outputs in every window, (windows, K, channels)."""
    M = round(length / record.dt)
    values = np.hstack([record.u, record.y])
    starts = _starts(len(values), M)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a channel without any sample stays NaN
        values = np.nan_to_num(values - np.nanmean(values, axis=0))
    stretches = np.array([values[i : i + M] for i in starts]).reshape(
        len(starts), M, record.nu + record.ny
    )
    taper = np.sin(np.pi * np.arange(M) / M) ** 2  # Hann's
    # Density: mean square per unit of frequency is 2 |X|² / (2π ∫ taper² dt), one-sided.
    density = np.sqrt(1 / (np.pi * record.dt * np.sum(taper**2)))
    Z = density * transform(stretches * taper[:, None], record.dt, omega)
    if record.hold == "zoh":  # the spectrum of the steps, not of a smooth input through the samples
        jh = 1j * omega * record.dt
        Z[..., : record.nu] *= ((1 - np.exp(-jh)) / jh)[:, None]
    return Z[..., : record.nu], Z[..., record.nu :]


def _starts(N: int, M: int) -> Array:
    """First samples of overlapped windows, spread so that the last one ends the record."""
    if M > N or M < 2:
        return np.zeros(0, dtype=int)
    n = int(np.ceil((N - M) / (M * STEP) - 0.1)) + 1  # an odd sample makes no further window
    return np.round(np.linspace(0, N - M, n)).astype(int)


def condition(spectra: Spectra, *, conditioned: bool) -> Conditioned:
    """Response, partial coherence and random error of every pair from one window length.

    All records share one response: Hᵀ = solve(Guu, Guy) with the sums over records. Partial
    coherence and the number of averages are those on the records that move the input: each record
    counts by its share of the conditioned input's power. When one axis moves at a time these are
    the figures of that axis's records, as in T&R; when all records are alike, those of all records.

    With references r that no noise drives, feedback does no harm: Hᵀ = solve(Gru, Gry), whose error
    is that of a conditioned input of power 1/diag(Gru⁻¹ Grr Gru⁻ᴴ) (Ljung, System Identification,
    2nd ed., section 13.5, the joint input-output approach).
    """
    n = _shares(spectra)
    Grr, Gru, Gry = (np.einsum("rk,rk...->k...", n, each) for each in spectra.known)
    Gyy = np.einsum("rk,rki->ki", n, spectra.Gyy)
    level, size = _level(Grr), _level(np.einsum("rk,rkab->kab", n, spectra.Guu))
    scale = level[:, :, None] * size[:, None, :]
    unit = Gru / scale  # ones on the diagonal: how correlated the inputs are, whatever their units
    unit[~spectra.averages.any(axis=0)] = np.eye(unit.shape[1])
    number = np.linalg.cond(unit)
    if not conditioned:
        unit = unit * np.eye(unit.shape[1])
    wrong = np.linalg.cond(unit) > MEANINGLESS
    unit[wrong] = np.eye(unit.shape[1])
    P = np.linalg.inv(unit) / np.swapaxes(scale, 1, 2)
    H = np.einsum("kab,kbi->kia", P, Gry)  # (K, ny, nu)
    Q = P if spectra.references is None else P @ Grr @ np.swapaxes(P.conj(), 1, 2)
    # Row j: the part of input j that the others do not give, as far as it is known.
    w = P / np.einsum("kaa->ka", Q)[:, :, None]
    power = np.einsum("kja,rkab,kjb->rkj", w, spectra.known[0], w.conj(), optimize=True).real
    H[wrong] = np.nan
    explained = _explained(spectra, P.astype(complex), conditioned=conditioned)
    power = np.maximum(power, 0.0)
    found = _pairs(spectra, H, Gyy, power, number, explained, conditioned=conditioned)
    found = replace(found, inverse=P.astype(complex))
    if not conditioned:
        return found
    across, between = _output_correlation(spectra, H), correlation(Q.astype(complex))
    found = replace(found, output_correlation=across, input_correlation=between)
    if spectra.references is None:
        return found
    driven, undriven = _references(spectra, Q.astype(complex))
    return replace(found, driven=driven, undriven=undriven)


def _references(spectra: Spectra, Q: ComplexArray) -> tuple[Array, Array]:
    """What references give of inputs over what they would by chance (K, nu), and leave of outputs.

    Power 1/Qjj of an input that references and no other input give, over that which no reference
    gives, by the number of averages: the F of weak instruments (D. Staiger, J. H. Stock,
    Econometrica 65(3), 1997). An estimate leans towards that without references by 1/F.
    """
    n = _shares(spectra)
    Grr, Gru, Gry = (np.einsum("rk,rk...->k...", n, each) for each in spectra.known)
    Guu, Gyy = (np.einsum("rk,rk...->k...", n, each) for each in (spectra.Guu, spectra.Gyy))
    inverse = np.linalg.pinv(Grr, hermitian=True)
    inputs, outputs = (
        np.einsum("kaj,kab,kbj->kj", G.conj(), inverse, G, optimize=True).real for G in (Gru, Gry)
    )
    left = np.maximum(np.einsum("kaa->ka", Guu).real - inputs, 0.0)
    count = np.maximum(spectra.averages.sum(axis=0) / OVERLAP_FACTOR**2 - Grr.shape[1], 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        driven = count[:, None] / (np.einsum("kaa->ka", Q).real * left)
    return np.asarray(driven), np.maximum(Gyy - outputs, 0.0)


def _level(G: ComplexArray) -> Array:
    """Square roots (K, n) of the diagonal, one where it is zero."""
    level = np.sqrt(np.einsum("kaa->ka", G).real)
    return np.where(level > 0, level, 1.0)


def _shares(spectra: Spectra) -> Array:
    """Share of each record in the averages, (R, K)."""
    return np.asarray(spectra.averages / np.maximum(spectra.averages.sum(axis=0), 1e-300))


def _explained(spectra: Spectra, P: ComplexArray, *, conditioned: bool) -> Array:
    """How many of an output's windows each record spends on inputs, (R, K, nu or 1)."""
    own = np.einsum("kab,rk,rkba->rka", P, _shares(spectra), spectra.known[1]).real
    return np.asarray(own.sum(axis=2, keepdims=True) if conditioned else own)


def _level_of_noise(density: Array, windows: Array, freedom: Array, spectra: Spectra) -> Array:
    """Density (K, ny, nu) of noise from that of residuals, means over neighbouring frequencies.

    Of m degrees of ``freedom`` in ν independent ``windows`` the residuals' density N is that of
    the noise times Γ(m)/ν, whose logarithm has the mean ψ(m) − ln ν. A few windows hardly tell it.
    """
    fewer = np.log(windows) - psi(np.maximum(freedom, LEAST))
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(_smoothed(np.log(density) + fewer[:, None], spectra, NOISE)))


def _pairs(
    spectra: Spectra,
    H: ComplexArray,
    Gyy: Array,
    power: Array,
    number: Array,
    explained: Array,
    *,
    conditioned: bool,
) -> Conditioned:
    total = np.maximum(spectra.averages.sum(axis=0), 1e-300)[:, None]
    n = _shares(spectra)
    N = _residual(spectra, H, conditioned=conditioned)  # (R, K, ny, nu)
    share = n[:, :, None] * power
    total_power = np.sum(share, axis=0)
    share = share / np.where(
        total_power > 0, total_power, 1.0
    )  # (R, K, nu): how much each record says of an input
    noise = np.maximum(np.einsum("rkj,rkij->kij", share, N), 0.0)
    Gxx = np.einsum("rkj,rkj->kj", share, power)[:, None, :] * np.ones_like(noise)
    output = np.abs(H) ** 2 * Gxx + noise
    each = np.where(n > 0, n, 1.0)[:, :, None]
    independent = total / np.maximum(np.sum(share**2 / each, axis=0), 1e-300) / OVERLAP_FACTOR**2
    taken = OVERLAP_FACTOR**2 * np.sum(share * explained / (total * each), axis=0)
    density = np.maximum(noise, NOISE_FREE * output)
    level = _level_of_noise(density, independent, independent * (1 - taken), spectra)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sqrt(level / (2 * independent[:, None] * np.abs(H) ** 2 * Gxx))
    everywhere = np.einsum("rk,rkij->kij", n, N).min(axis=2)
    return Conditioned(
        Gxx=Gxx,
        Gxy=H * Gxx,
        Gyy=output,
        random_error=error,
        multiple_coherence=np.clip(1 - everywhere / np.where(Gyy > 0, Gyy, 1.0), 0.0, 1.0),
        condition=number,
    )


def correlation(S: ComplexArray) -> ComplexArray:
    """Hermitian matrices (..., n, n) scaled to ones on the diagonal."""
    size = np.sqrt(np.maximum(np.einsum("...ii->...i", S).real, 1e-300))
    return np.asarray(S / (size[..., :, None] * size[..., None, :]))


def _output_correlation(spectra: Spectra, H: ComplexArray) -> ComplexArray:
    """Correlation (K, ny, ny) of what a response leaves of the outputs.

    Smoothed over neighbouring frequencies, and shrunk towards none where there are few averages.
    """
    n, H = _shares(spectra), np.nan_to_num(H)
    cross = np.einsum("rk,rkai,kla->kil", n, spectra.Guy.conj(), H, optimize=True)
    own = np.einsum("kia,rk,rkab,klb->kil", H.conj(), n, spectra.Guu, H, optimize=True)
    left = np.einsum("rk,rkil->kil", n, spectra.Gyz) - cross - np.swapaxes(cross.conj(), 1, 2) + own
    smooth = _smoothed(correlation(left).conj(), spectra, NEIGHBOURS)
    ny, count = H.shape[1], np.sum(spectra.averages, axis=0)[:, None, None]
    return np.asarray((count * smooth + ny * np.eye(ny)) / (count + ny))


def _smoothed(values: Any, spectra: Spectra, width: float) -> Any:  # noqa: ANN401 - real or complex
    """Means (K, n, m) over neighbouring frequencies, of those known there; zero without any."""
    place, known = np.log(spectra.omega), np.isfinite(values) & (spectra.count > 0)[:, None, None]
    W = np.exp(-(((place[:, None] - place) / width) ** 2) / 2)
    total = np.einsum("kl,lij->kij", W, np.where(known, values, 0))
    return total / np.maximum(np.einsum("kl,lij->kij", W, known), 1e-300)


def _residual(spectra: Spectra, H: ComplexArray, *, conditioned: bool) -> Array:
    """What the response leaves of each output's density in each record, (R, K, ny, nu)."""
    Guu, Guy, Gyy = spectra.Guu, spectra.Guy, spectra.Gyy
    if conditioned:
        cross = np.einsum("kia,rkai->rki", H.conj(), Guy).real
        own = np.einsum("kia,rkab,kib->rki", H.conj(), Guu, H, optimize=True).real
        return np.asarray((Gyy - 2 * cross + own)[..., None] * np.ones(H.shape[2]))
    cross = np.einsum("kia,rkai->rkia", H.conj(), Guy).real
    own = np.abs(H) ** 2 * np.einsum("rkaa->rka", Guu).real[:, :, None, :]
    return np.asarray(Gyy[..., None] - 2 * cross + own)
