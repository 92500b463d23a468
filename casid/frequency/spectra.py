"""Spectra of windowed stretches of records, on any grid of frequencies.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., chapters 7 to
10 (*T&R* below): overlapped windows, averages over all windows of all records, conditioning of
several inputs, composite of several window lengths.

Departures: windows overlap by two thirds, which loses less of a sweep than the half of T&R (on the
sweeps of a linear helicopter with noise: 1.04 dB of rms error, 1.11 dB with half); the transform is
summed at the wanted frequencies themselves, which gives the values of the chirp z-transform and
takes any spacing; one averaged input matrix serves all records at once, so that inputs which move
together within each record (feedback) are separated by the records of the other axes; the composite
weighs the errors of the cross-spectrum relative to its magnitude, so that it does not depend on
where its phase happens to lie.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casid import samples
from casid.arrays import Array, BoolArray, ComplexArray
from casid.record import Record

# Condition number of the inputs' coherence matrix; two inputs with coherence γ² have (1+γ)/(1-γ).
SUSPECT = 40.0  # γ² = 0.9: errors of one input's response spill into the other's
MEANINGLESS = 1000.0  # γ² = 0.996: what separates the inputs is leakage and noise
STEP = 1 / 3  # between windows, in window lengths
OVERLAP_FACTOR = np.sqrt(0.55)  # C_ε of T&R (7.35) for an overlap of half or more

FIELDS = ("Gxx", "Gxy", "Gyy", "random_error", "multiple_coherence", "condition")
NEIGHBOURS = 0.2  # nepers over which the correlation of outputs is smoothed


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectra:
    """Averaged one-sided spectral densities of R records, per rad/s."""

    Guu: ComplexArray  # (R, K, nu, nu) averages of conj(U_a) U_b
    Guy: ComplexArray  # (R, K, nu, ny) of conj(U_a) Y_i
    Gyy: Array  # (R, K, ny) of |Y_i|²
    Gyz: ComplexArray  # (R, K, ny, ny) of conj(Y_i) Y_l
    averages: Array  # (R, K) windows that would fit without overlap
    count: Array  # (K,) windows used
    kept: Array  # (K,) power kept of the input that lost most in windows left out
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

    @property
    def response(self) -> ComplexArray:
        """Gxy/Gxx, (K, ny, nu)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.Gxy / self.Gxx)

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
        power = np.abs(Z) ** 2
        powers.append(np.array([np.einsum("wk,wka->ka", weight > 0, power), power.sum(axis=0)]))
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
    found = _pairs(spectra, H, Gyy, np.maximum(power, 0.0), number, conditioned=conditioned)
    found = replace(found, inverse=P.astype(complex))
    if not conditioned:
        return found
    across, between = _output_correlation(spectra, H), correlation(Q.astype(complex))
    return replace(found, output_correlation=across, input_correlation=between)


def _level(G: ComplexArray) -> Array:
    """Square roots (K, n) of the diagonal, one where it is zero."""
    level = np.sqrt(np.einsum("kaa->ka", G).real)
    return np.where(level > 0, level, 1.0)


def _shares(spectra: Spectra) -> Array:
    """Share of each record in the averages, (R, K)."""
    return np.asarray(spectra.averages / np.maximum(spectra.averages.sum(axis=0), 1e-300))


def _pairs(
    spectra: Spectra, H: ComplexArray, Gyy: Array, power: Array, number: Array, *, conditioned: bool
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
    coherence = np.abs(H) ** 2 * Gxx / np.where(output == 0, 1.0, output)
    spread = share**2 / np.where(n > 0, n, 1.0)[:, :, None]
    effective = total / np.maximum(np.sum(spread, axis=0), 1e-300)
    lost = (H.shape[2] - 1) / total if conditioned else 0.0
    averages = np.maximum(effective * (1 - lost), 0.0)[:, None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        error = OVERLAP_FACTOR * np.sqrt((1 - coherence) / (2 * averages * coherence))
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
    place = np.log(spectra.omega)
    W = np.exp(-(((place[:, None] - place) / NEIGHBOURS) ** 2) / 2)
    smooth = np.einsum("kl,lij->kij", W / W.sum(axis=1, keepdims=True), correlation(left).conj())
    ny, count = H.shape[1], np.sum(spectra.averages, axis=0)[:, None, None]
    return np.asarray((count * smooth + ny * np.eye(ny)) / (count + ny))


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


def composite(parts: Sequence[Conditioned], usable: BoolArray, iterations: int = 8) -> Conditioned:
    """One set of spectra that explains those of all window lengths best, T&R chapter 10.

    Minimises per pair and frequency, by Gauss-Newton steps on all of them at once,

        Σ_w W_w [(Gxx/Gxx_w - 1)² + (Gyy/Gyy_w - 1)² + |Gxy - Gxy_w|²/|Gxy_w|² + 5 (γ²/γ_w² - 1)²],

    W_w = (ε_w / min ε)⁻⁴, over the ``usable`` windows (windows, K); NaN where there is none. The
    residuals are small and the start is their weighted mean, so that few iterations do.
    """
    stacked = {name: np.array([getattr(part, name) for part in parts]) for name in FIELDS}
    W = window_weights(stacked["random_error"], usable)  # (windows, K, ny, nu)
    means = {name: _mean(W, stacked[name]) for name in ("Gxx", "Gyy", "Gxy", "random_error")}
    # Relative to the weighted means: four unknowns of order one, the phase of the mean removed.
    a, b, z = (_relative(W, stacked[name], means[name]) for name in ("Gxx", "Gyy", "Gxy"))
    c = np.zeros((4, *W.shape[1:]))
    c[:3] = 1.0
    limits = np.array([0.1, 0.1, -9.0, -9.0])[:, None, None, None]
    for _ in range(iterations):
        c = np.clip(c - _step(c, np.sqrt(W), a, b, z), limits, 9.0)
    none = ~np.asarray(usable.any(axis=0), dtype=bool)
    lost = np.where(none, np.nan, 1.0)
    multiple = _mean(W.mean(axis=3), stacked["multiple_coherence"])
    G = {name: lost[:, None, None] * value for name, value in means.items()}
    return Conditioned(
        Gxx=c[0] * G["Gxx"],
        Gyy=c[1] * G["Gyy"],
        Gxy=(c[2] + 1j * c[3]) * G["Gxy"],
        random_error=G["random_error"],
        multiple_coherence=lost[:, None] * multiple,
        condition=np.max(stacked["condition"], axis=0),
        output_correlation=_blend(W, [part.output_correlation for part in parts]),
        input_correlation=_blend(W, [part.input_correlation for part in parts]),
    )


def _blend(W: Array, matrices: Sequence[ComplexArray | None]) -> ComplexArray | None:
    """Mean (K, n, n) over window lengths, of those that are used; none, uncorrelated."""
    if any(each is None for each in matrices):
        return None
    weight = W.mean(axis=(2, 3))
    weight = weight / np.maximum(weight.sum(axis=0), 1e-300)
    mean = np.einsum("wk,wkij->kij", weight, np.array(matrices))
    lost = ~np.isfinite(mean).all(axis=(1, 2)) | (weight.sum(axis=0) < 0.5)
    return np.where(lost[:, None, None], np.eye(mean.shape[1]), mean)


def _mean(W: Array, values: Any) -> Any:  # noqa: ANN401 - real or complex
    """Mean over window lengths with weights that add up to one."""
    return np.sum(np.where(W > 0, W * np.where(W > 0, values, 0), 0), axis=0)


def _relative(W: Array, values: Any, mean: Any) -> Any:  # noqa: ANN401 - real or complex
    """Values over their mean; one where they do not count."""
    counts = (W > 0) & (np.abs(mean) > 0)
    return np.where(counts, values, 1.0) / np.where(counts, mean, 1.0)


def window_weights(error: Array, usable: BoolArray) -> Array:
    """W_w of every window length, adding up to one; zero where it may not be used."""
    known = np.where(np.isfinite(error), np.maximum(error, 1e-6), 1e6)
    trusted = np.where(usable[:, :, None, None], known, np.inf)
    best = trusted.min(axis=0)
    W = np.where(np.isfinite(trusted), (trusted / np.where(np.isfinite(best), best, 1)) ** -4.0, 0)
    total = W.sum(axis=0)
    return np.asarray(W / np.where(total > 0, total, 1.0))


def _step(c: Array, sw: Array, a: Array, b: Array, z: ComplexArray) -> Array:
    """Gauss-Newton step of the composite's four unknowns, (4, K, ny, nu)."""
    size = np.maximum(np.abs(z), 1e-12)
    gamma_w = np.maximum(size**2 / (a * b), 1e-12)
    gamma = (c[2] ** 2 + c[3] ** 2) / (c[0] * c[1])
    five = np.sqrt(5.0)
    real, imag = (c[2] - z.real) / size, (c[3] - z.imag) / size
    r = np.stack([c[0] / a - 1, c[1] / b - 1, real, imag, five * (gamma / gamma_w - 1)])
    J = np.zeros((5, 4, *z.shape))
    J[0, 0], J[1, 1], J[2, 2], J[3, 3] = 1 / a, 1 / b, 1 / size, 1 / size
    modulus = c[0] * c[1] * gamma_w / five
    J[4, 0], J[4, 1] = -five * gamma / gamma_w / c[0], -five * gamma / gamma_w / c[1]
    J[4, 2], J[4, 3] = 2 * c[2] / modulus, 2 * c[3] / modulus
    r, J = sw * r, sw * J
    H = np.einsum("rawkij,rbwkij->kijab", J, J)
    g = np.einsum("rawkij,rwkij->kija", J, r)
    H[~sw.any(axis=0)] = np.eye(4)
    return np.moveaxis(np.linalg.solve(H, g[..., None])[..., 0], -1, 0)
