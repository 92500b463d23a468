"""Whether residuals on lines follow the inputs, as what a structure misses of a response does.

Noise and, in open loop, turbulence know nothing of the inputs. Of what a structure misses, in a
band of lines of all records,

    E(ω) = ΔG U(ω) + V(ω),

and the share R² of the power of E that one ΔG explains is, of m lines of noise and n inputs, of
chance alone, 1 - R² ~ Beta(m - n, n), whatever spectrum the noise has. So

    Q = -Σ m log(1 - R²),     mean Σ m Σ 1/k,     variance Σ m² Σ 1/k²,     k = m - n … m - 1,

sums over bands, is about of a gamma distribution. Bands that hold little information are left out:
noise that a controller feeds back rules the inputs there. Spectra of residuals take such errors for
noise, and state for random what is not: derivatives may be off by far more.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from casid.arrays import Array, ComplexArray
from casid.display import listed
from casid.errors import warn
from casid.shooting.line_residuals import OnLines
from casid.shooting.lines import Lines
from casid.shooting.spectrum import NoiseSpectrum, leftover, powers

WIDTH = 1.5  # ratio of a band's ends, at least
HOLDS = 0.02  # of the information, in bands that count
SPARE = 4  # lines of a band beyond its inputs, at least
LEVEL = 1e-3  # of the test of all outputs; parameters take their share, chance is rarer still
WORTH = 0.01  # of an output: less, as of rounding in records without noise, is not worth telling
ALONE = 1e-9  # of inputs, the least part that others do not explain


class Followed(NamedTuple):
    """What of an output's residuals follows the inputs."""

    chance: float  # of so much where none does
    share: float  # of the output, where the records tell most


def warn_of_missed(
    method: str,
    lines: Sequence[Lines],
    residuals: Sequence[OnLines],
    taken: Sequence[Array],
    spectra: Sequence[NoiseSpectrum],
) -> bool:
    """Tell of outputs whose residuals surely follow the inputs; ``taken`` by `leverages`.

    Whether there are any.
    """
    found = dict(
        zip(lines[0].record.outputs, followed(lines, residuals, taken, spectra), strict=True)
    )
    missed = {
        name: each.share
        for name, each in found.items()
        if each.chance < LEVEL / len(found) and each.share > WORTH
    }
    if missed:
        parts = [f"{name} ({100 * share:.2g} % of it)" for name, share in missed.items()]
        warn(
            f"{method}: residuals of {listed(parts)} follow the inputs: the structure lacks part "
            "of the response, such as a lag or a mode, or the controller reacts to turbulence; "
            "derivatives may be off by several of their standard errors. Add what is missing, or "
            "compare with a frequency response"
        )
    return bool(missed)


def followed(
    lines: Sequence[Lines],
    residuals: Sequence[OnLines],
    taken: Sequence[Array],
    spectra: Sequence[NoiseSpectrum],
) -> list[Followed]:
    """What of every output's residuals follows the inputs."""
    left, power = leftover(lines, residuals, taken), powers(spectra, lines)
    omega, U = (np.concatenate(part) for part in zip(*map(_inputs, lines), strict=True))
    bands = _bands(omega, U.shape[1] + SPARE)
    found = []
    for i in range(len(lines[0].seen)):
        # Of one variance, whatever the kind of manoeuvre; nothing of outputs not measured.
        scale = np.concatenate(
            [own[:, i] ** -0.5 * each.seen[i] for own, each in zip(power, lines, strict=True)]
        )
        E = np.concatenate([each.E[:, i] for each in residuals]) * scale
        Y = np.concatenate([each.Y[:, i] for each in lines]) * scale
        h = np.concatenate([each[:, i] for each in taken]) * (scale > 0)
        pairs = zip(left, lines, strict=True)
        m = np.concatenate([own[:, i] / each.weight for own, each in pairs]) * (scale > 0)
        found.append(_of_output(bands, U * scale[:, None], E, Y, h, m))
    return found


def _of_output(
    bands: Sequence[NDArray[np.intp]],
    U: ComplexArray,
    E: ComplexArray,
    Y: ComplexArray,
    h: Array,
    m: Array,
) -> Followed:
    """Of residuals E (K,) beside inputs U (K, nu) and output Y, weighed to one variance.

    Lines hold information h and have m left of their one complex degree of freedom.
    """
    rows = []  # h, -m log(1 - R²), its mean and variance by chance, power that follows
    telling = [at for at in bands if h[at].sum() > HOLDS * h.sum()]
    for at in telling:
        basis, size, _ = np.linalg.svd(U[at], full_matrices=False)
        n, free = int(np.sum(size > ALONE * size[0])), float(m[at].sum())
        residual, whole = (float(np.sum(np.abs(each[at]) ** 2)) for each in (E, Y))
        if not size[0] or free < n + 1 or not residual or not whole:
            continue
        explained = float(np.sum(np.abs(basis[:, :n].conj().T @ E[at]) ** 2))
        other = max(1 - explained / residual, 1e-15)
        k = free - np.arange(1, n + 1)
        more = max(1 - other * free / (free - n), 0.0) * residual / whole
        moments = free * np.sum(1 / k), free**2 * np.sum(1 / k**2)
        rows.append((h[at].sum(), -free * np.log(other), *moments, more))
    if not rows:
        return Followed(1.0, 0.0)
    tells, Q, mean, variance, more = np.array(rows).T
    chance = gammaincc(mean.sum() ** 2 / variance.sum(), Q.sum() * mean.sum() / variance.sum())
    return Followed(float(chance), float(np.sqrt(tells @ more / tells.sum())))


def _inputs(lines: Lines) -> tuple[Array, ComplexArray]:
    """Frequencies (K,) of the lines and transforms (K, nu) of the inputs there."""
    u = lines.record.u
    U = np.fft.rfft(u - u.mean(axis=0), axis=0)[1 : len(lines.omega) + 1]
    return lines.omega, U / np.sqrt(len(u))


def _bands(omega: Array, least: int) -> list[NDArray[np.intp]]:
    """Positions of frequencies, band by band."""
    order, found, begin = np.argsort(omega), [], 0
    for k in range(1, len(omega) + 1):
        ended = k == len(omega) or omega[order[k]] > WIDTH * omega[order[begin]]
        if ended and k - begin >= least:
            found.append(order[begin:k])
            begin = k
    return found
