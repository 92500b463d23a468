"""The spectrum of residuals, smoothed over frequency and pooled over manoeuvres of a kind.

    Φ(ω) = Σ w |E|² / Σ (w − h)        over ±0.35 nepers of ω,

one for every output and kind of manoeuvre, with w the lines a line stands for and h its leverage:
what the estimated parameters and transients have taken of its degrees of freedom. The window widens
until it holds enough of them. What a structure misses raises Φ where it misses it, and counts less
there. It is never below the level above which the records hold nothing but noise, and not below
the mean of a band as wide as the uppermost quarter.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, ComplexArray
from casid.shooting.line_residuals import OnLines, halves
from casid.shooting.lines import Lines
from casid.values import seal, storable

REACH = 0.35  # of the smoothing [nepers of frequency]
FREEDOM = 20.0  # degrees of freedom, ten lines, that a window holds at least
STEP = 0.1  # of the grid on which spectra are kept [nepers]
TOP = 0.75  # of the highest line, from where residuals tell the instruments' noise
SPENT = 0.1  # share of its degrees of freedom that a line counts as having left at least
AnyArray = TypeVar("AnyArray", Array, ComplexArray)

FLOOR = 1e-6  # standard deviation of a residual is at least this share of the channel's


@storable
@dataclass(frozen=True, eq=False, kw_only=True)
class NoiseSpectrum:
    """Power of the residuals of manoeuvres of a kind, of sampled white noise its variance."""

    records: tuple[str, ...]
    omega: Array  # (K,) [rad/s]
    power: Array  # (K, ny) squared units of the outputs; NaN of one that was not measured

    def __post_init__(self) -> None:
        seal(self)


def noise_spectra(
    lines: Sequence[Lines], residuals: Sequence[OnLines], taken: Sequence[Array]
) -> tuple[NoiseSpectrum, ...]:
    """Φ of every kind of manoeuvre, in the order of their numbers; ``taken`` by `leverages`."""
    left = leftover(lines, residuals, taken)
    found = []
    for kind in range(max(each.kind for each in lines) + 1):
        mine = [r for r, each in enumerate(lines) if each.kind == kind]
        names = tuple(lines[r].record.name for r in mine)
        ends = [np.log(lines[r].omega[[0, -1]]) for r in mine]
        grid = np.exp(np.linspace(np.min(ends), np.max(ends), max(2, int(np.ptp(ends) / STEP))))
        power = np.full((len(grid), len(lines[0].seen)), np.nan)
        for i in range(power.shape[1]):
            measured = [r for r in mine if lines[r].seen[i]]
            if measured:
                parts = [(lines[r], residuals[r].E[:, i], left[r][:, i]) for r in measured]
                power[:, i] = _power(parts, grid, i)
        found.append(NoiseSpectrum(records=names, omega=grid, power=power))
    return tuple(found)


def _power(parts: list[tuple[Lines, ComplexArray, Array]], grid: Array, i: int) -> Array:
    """Φ of one output and kind from residuals and degrees of freedom of its records."""
    omega = np.concatenate([lines.omega for lines, _, _ in parts])
    power = np.concatenate([lines.weight * np.abs(E) ** 2 for lines, E, _ in parts])
    freedom = np.concatenate([left for _, _, left in parts])
    channel = sum(float(lines.weight @ np.abs(lines.Y[:, i]) ** 2) for lines, _, _ in parts)
    total = sum(float(lines.weight.sum()) for lines, _, _ in parts)
    least = max(_level(omega, power, freedom), FLOOR**2 * channel / total, 1e-300)
    return np.maximum(smoothed(omega, power, freedom, grid), least)


def powers(spectra: Sequence[NoiseSpectrum], lines: Sequence[Lines]) -> list[Array]:
    """Spectra on the lines of every record, (K, ny); 1 where an output was not measured."""
    known: dict[tuple[int, bytes], Array] = {}
    found = []
    for each in lines:
        mine, key = spectra[each.kind], (each.kind, each.omega.tobytes())
        if key not in known:
            places = np.log(each.omega), np.log(mine.omega)
            columns = [np.interp(*places, p) for p in np.log(mine.power.T)]
            known[key] = np.exp(np.array(columns).T)
        found.append(np.where(each.seen, known[key], 1.0))
    return found


def leftover(
    lines: Sequence[Lines], residuals: Sequence[OnLines], taken: Sequence[Array]
) -> list[Array]:
    """Degrees of freedom that every line and output has left, (K, ny) of every record."""
    left: list[Array] = []
    for each, residual, h in zip(lines, residuals, taken, strict=True):
        weight = each.weight[:, None]
        left.append(np.clip(weight - h - _squares(residual.ends), 0.0, weight))
    return left


def reach(lines: Sequence[Lines], taken: Sequence[Array], share: float) -> float:
    """Frequency [rad/s] above which the lines hold at most a share of the information.

    Of that about any combination of the parameters.
    """
    omega = np.concatenate([each.omega for each in lines])
    h = np.concatenate(taken).sum(axis=1)
    order = np.argsort(omega)[::-1]
    beyond = int(np.searchsorted(np.cumsum(h[order]), share))
    return float(omega[order[min(beyond, len(omega) - 1)]])


def leverages(residuals: Sequence[OnLines], F: Array) -> list[Array]:
    """What parameters of information F (nf, nf) take of every line's freedom, (K, ny)."""
    unit = 1 / np.sqrt(np.maximum(np.diag(F), 1e-300))
    values, vectors = np.linalg.eigh(F * np.outer(unit, unit))
    values = np.where(values > 1e-12 * len(F), values, np.inf)
    return type(residuals[0]).leverages(residuals, unit[:, None] * vectors / np.sqrt(values))


def _squares(rows: Array) -> Array:
    """Squared lengths (K, ny) of complex rows in halves (K, 2, ny, n)."""
    return np.asarray(np.einsum("khia,khia->ki", rows, rows))


def _level(omega: Array, power: Array, freedom: Array) -> float:
    """Mean power of the uppermost lines."""
    top = omega >= TOP * omega.max()
    return float(power[top].sum() / max(freedom[top].sum(), 1.0))


def smoothed(omega: Array, power: Array, freedom: Array, at: Array) -> Array:
    """Σ power / Σ freedom over ±0.35 nepers of frequencies, or more where freedom is short.

    ``power`` (n,) or (n, m) stands at frequencies ``omega`` (n,) in any order.
    """
    order = np.argsort(omega)
    zero = np.zeros((1, *power.shape[1:]))
    total = np.concatenate([zero, np.cumsum(power[order], axis=0)])
    edges = np.concatenate([[0.0], np.cumsum(freedom[order])])
    known = omega[order]
    # Ends of windows in cumulated freedom, continuous in it: rounds of estimates settle then.
    low = edges[np.searchsorted(known, at * np.exp(-REACH), side="left")]
    high = edges[np.searchsorted(known, at * np.exp(REACH), side="right")]
    need = min(FREEDOM, edges[-1])
    centre = np.interp(at, known, (edges[1:] + edges[:-1]) / 2)
    begin = np.clip(centre - need / 2, 0.0, edges[-1] - need)
    low, high = np.minimum(low, begin), np.maximum(high, begin + need)
    found = _between(edges, total, high) - _between(edges, total, low)
    return np.asarray(found / np.maximum(high - low, 1e-300).reshape(-1, *[1] * (power.ndim - 1)))


def _between(edges: Array, total: Array, at: Array) -> Array:
    """Cumulated power (n + 1, ...) at places between the edges (n + 1,)."""
    k = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    share = (at - edges[k]) / np.maximum(edges[k + 1] - edges[k], 1e-300)
    share = np.clip(share, 0.0, 1.0).reshape(-1, *[1] * (total.ndim - 1))
    return np.asarray(total[k] + share * (total[k + 1] - total[k]))


def scatter_of_lines(
    lines: Sequence[Lines],
    residuals: Sequence[OnLines],
    powers: Sequence[Array],
    left: Sequence[Array],
    P: Array,
) -> tuple[Array, list[Array]]:
    """Covariance (nf, nf) of estimates from every line's own residual, not smoothed.

    By the inverse information P (nf, nf). Corrected for leverage by what is `leftover`: HC2 of
    MacKinnon and White, Journal of Econometrics 29 (1985), 305. Behind it what weighed residuals of
    unit variance on every line would add to the variances, (K, ny, nf) of every record.
    """
    total, shares = np.zeros_like(P), []
    for each, found, power, freedom in zip(lines, residuals, powers, left, strict=True):
        share = np.clip(freedom / each.weight[:, None], SPENT, 1.0)
        E = found.E / np.sqrt(power * share)
        both = np.stack([halves(E), halves(-1j * E)], axis=1).reshape(len(E), 2, -1)
        own, ny = np.empty((*E.shape, len(P))), E.shape[1]
        for at, rows in found.portions(P):
            slopes = (both[at] @ rows).reshape(-1, len(P))
            total += slopes.T @ slopes
            squares = rows**2
            own[at] = squares[:, :ny] + squares[:, ny:]
        shares.append(own)
    return total, shares


def degrees(lines: Sequence[Lines], shares: Sequence[Array]) -> Array:
    """Degrees of freedom (n,) of the variances that the lines' residuals tell of estimates.

    Satterthwaite's, 2 (mean)² / variance of Σ c |E|²/Φ, with c what a line adds to a variance: the
    ``shares`` (K, n) of every record.
    """
    total, square = (part.sum(axis=0) for part in _of_kinds(lines, shares))
    return np.asarray(total**2 / np.maximum(square, 1e-300))


def weighed_apart(lines: Sequence[Lines], shares: Sequence[Array], fewest: float) -> Array:
    """By what variances (n,) are larger for kinds whose spectra are estimated each by itself.

    1 + 4 Σ w (1 - w)/ν of kinds of a share w and ν degrees of freedom, ``fewest`` at least: what
    is quieter by chance counts more (P. Meier, Biometrics 9 (1953), 59). 1 of one kind.
    """
    total, square = _of_kinds(lines, shares)
    freedom = np.maximum(total**2 / np.maximum(square, 1e-300), fewest)
    share = total / np.maximum(total.sum(axis=0), 1e-300)
    return np.asarray(1 + 4 * np.sum(share * (1 - share) / freedom, axis=0))


def _of_kinds(lines: Sequence[Lines], shares: Sequence[Array]) -> tuple[Array, Array]:
    """Of every kind Σ c and Σ c² by degrees of freedom, (kinds, n), c as `degrees` has it."""
    total = np.zeros((1 + max(each.kind for each in lines), shares[0].shape[1]))
    square = np.zeros_like(total)
    for each, c in zip(lines, shares, strict=True):
        total[each.kind] += c.sum(axis=0)
        square[each.kind] += (1 / each.weight) @ c**2
    return total, square


def contrast(spectra: Sequence[NoiseSpectrum]) -> float:
    """How many times its least power an output's spectrum rises at most."""
    return max(
        float(np.max(column) / np.min(column))
        for each in spectra
        for column in each.power.T
        if np.isfinite(column).all()
    )


def coherent(
    lines: Sequence[Lines],
    residuals: Sequence[OnLines],
    powers: Sequence[Array],
    left: Sequence[Array],
) -> list[ComplexArray]:
    """Smoothed correlation of whitened residuals across outputs, (K, ny, ny) of every record.

    Complex, Hermitian, with ones on the diagonal; ``left`` is what is `leftover`.
    """
    white = [r.E / np.sqrt(power) for r, power in zip(residuals, powers, strict=True)]
    found: dict[int, ComplexArray] = {}
    for mine, at, places in kinds(lines):
        omega = np.concatenate([lines[r].omega for r in mine])
        cross = np.concatenate(
            [
                lines[r].weight[:, None, None] * white[r][:, :, None] * white[r][:, None].conj()
                for r in mine
            ]
        )
        freedom = np.concatenate([left[r].mean(axis=1) for r in mine])
        S = smoothed(omega, cross.reshape(len(omega), -1), freedom, at)
        S = S.reshape(-1, *cross.shape[1:])
        size = np.sqrt(np.maximum(np.einsum("kii->ki", S).real, 1e-300))
        found |= shared(S / (size[:, :, None] * size[:, None]), mine, places)
    return [found[r] for r in range(len(lines))]


def kinds(lines: Sequence[Lines]) -> Iterator[tuple[list[int], Array, list[NDArray[np.intp]]]]:
    """Records of every kind, all frequencies of their lines, and where those of each stand."""
    for kind in sorted({each.kind for each in lines}):
        mine = [r for r, each in enumerate(lines) if each.kind == kind]
        at, places = np.unique(np.concatenate([lines[r].omega for r in mine]), return_inverse=True)
        yield mine, at, np.split(places, np.cumsum([len(lines[r].omega) for r in mine])[:-1])


def shared(
    values: AnyArray, mine: Sequence[int], places: Sequence[NDArray[np.intp]]
) -> dict[int, AnyArray]:
    """Values at all frequencies of a kind for each of its records, one array of the same lines."""
    first = {place.tobytes(): values[place] for place in places}
    return {r: first[place.tobytes()] for r, place in zip(mine, places, strict=True)}
