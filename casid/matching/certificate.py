"""The largest singular value of a matching error over a band, from below and from above.

On an interval of frequencies the weighted error is its Taylor series about the centre. The norm
of the affine part is convex, so its largest value lies at an end of the interval; the next terms
are bounded by their norms and the rest by a geometric (resolvent) and an exponential (delay)
majorant series. The bound is rigorous up to rounding, delays included, and its gap closes
with the square of the interval, so few bisections reach any tolerance.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np
import scipy.linalg

from casid.arrays import Array, ComplexArray
from casid.linear import StateSpace
from casid.matching.comparison import Source

TERMS = 4  # of the Taylor series that are kept
LIMIT = 200_000  # intervals examined before the bound is returned as it stands


@dataclass(frozen=True, eq=False, kw_only=True)
class Band:
    """What is known of the error of a model over a band."""

    upper: float  # bound of the largest singular value over the band
    omega: Array  # (M,) frequencies examined [rad/s], increasing
    sigma: Array  # (M, r) singular values there

    @property
    def lower(self) -> float:
        """The largest singular value found."""
        return float(self.sigma[:, 0].max())

    @property
    def peak_omega(self) -> float:
        """Where that is [rad/s]."""
        return float(self.omega[np.argmax(self.sigma[:, 0])])


def band_norm(
    system: StateSpace, source: Source, *, tolerance: float = 1e-3, negligible: float = 0.0
) -> Band:
    """Bound the largest singular value of the weighted error between the ends of the grid.

    Of a measured response only the points exist. Ends when the relative gap between the bounds is
    below ``tolerance``, or the upper one below ``negligible``.
    """
    omega = source.omega
    sigma = np.linalg.svd(source.error(system), compute_uv=False)
    if source.system is None or len(omega) == 1:
        return Band(upper=float(sigma[:, 0].max()), omega=omega, sigma=sigma)
    seen, values = [omega], [sigma]
    nodes = source.nodes[(source.nodes > omega[0]) & (source.nodes < omega[-1])]
    edges = np.unique(np.concatenate([omega, nodes]))
    left, right = edges[:-1], edges[1:]
    closed, pending, examined = 0.0, 0.0, 0
    while len(left) and examined < LIMIT:
        centre, half = (left + right) / 2, (right - left) / 2
        bound, at_centre = _interval_bound(system, source, centre, half)
        seen.append(centre)
        values.append(at_centre)
        examined += len(centre)
        lower = max(float(part[:, 0].max()) for part in values)
        goal = max(lower * (1 + tolerance), negligible)
        open_ = ~(bound <= goal) & (half > 1e-12 * edges[-1])  # what is not known stays open
        closed = max(closed, float(bound[~open_].max(initial=0.0)))
        left, right = (
            np.concatenate([left[open_], centre[open_]]),
            np.concatenate([centre[open_], right[open_]]),
        )
        pending = float(bound[open_].max(initial=0.0))
    omega, sigma = np.concatenate(seen), np.concatenate(values)
    order = np.argsort(omega)
    upper = max(closed, pending, float(sigma[:, 0].max()))
    return Band(upper=upper, omega=omega[order], sigma=sigma[order])


def peaks(band: Band, above: float, spacing: float) -> Array:
    """Frequencies of the local maxima of the largest singular value higher than ``above``.

    Those nearer to each other than the fraction ``spacing`` of themselves count once.
    """
    top = np.concatenate([[-np.inf], band.sigma[:, 0], [-np.inf]])
    is_peak = (top[1:-1] >= top[:-2]) & (top[1:-1] >= top[2:]) & (band.sigma[:, 0] > above)
    kept: list[float] = []
    for i in sorted(np.flatnonzero(is_peak), key=lambda i: -band.sigma[i, 0]):
        if all(abs(band.omega[i] - other) > spacing * other for other in kept):
            kept.append(float(band.omega[i]))
    return np.array(sorted(kept))


def _interval_bound(
    system: StateSpace, source: Source, centre: Array, half: Array
) -> tuple[Array, Array]:
    """Upper bound on every interval (n,), and singular values at its centre (n, r)."""
    assert source.system is not None  # measured responses never come here
    s = source.shift + 1j * centre
    model, tail = _series(system, s, half)
    box, box_tail = _series(source.system, s, half)
    turn = 1j ** np.arange(TERMS + 1)  # s − s_c = j x, x the distance in frequency
    e = (model - box) * turn[:, None, None, None]
    size = abs(model) + abs(box)
    W0 = source.weight_at(centre)
    slope = (source.weight_at(centre + half) - source.weight_at(centre - half)) / (
        2 * half[:, None, None]
    )
    a = W0 * e
    a[1:] += slope * e[:-1]
    h = half[:, None, None]
    rest = _times(W0 + h * abs(slope), tail + box_tail)
    rest += h ** (TERMS + 1) * abs(slope) * size[-1]
    ends = np.maximum(_norm(a[0] + h * a[1]), _norm(a[0] - h * a[1]))
    higher = sum(half**k * _norm(a[k]) for k in range(2, TERMS + 1))
    bound = ends + higher + np.linalg.norm(rest, axis=(1, 2))
    return bound, np.linalg.svd(a[0], compute_uv=False)


def _times(size: Array, bound: Array) -> Array:
    """Products of sizes and bounds; what is zero stays so though its bound be infinite."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(size == 0, 0.0, size * bound))


def _norm(M: ComplexArray) -> Array:
    return np.asarray(np.linalg.norm(M, 2, axis=(1, 2)))


def _series(system: StateSpace, s: ComplexArray, h: Array) -> tuple[ComplexArray, Array]:
    """Taylor coefficients of G(s) about every s, (TERMS + 1, n, ny, nu), and a bound on the rest.

    With R = (s_c I − A)⁻¹ the resolvent is Σ (−δ)^k R^(k+1), whose k-th term beyond the last
    kept one is at most ‖c R‖ ‖R‖^(k−K) ‖R^K b‖ |δ|^k.
    """
    A, B, C = _balanced(system)
    n, nx = len(s), system.nx
    g = np.zeros((TERMS + 1, n, system.ny, system.nu), dtype=complex)
    rest: Array = np.zeros((n, system.ny, system.nu))
    g[0] += system.D
    if nx:
        R = np.linalg.inv(s[:, None, None] * np.eye(nx) - A)
        X = R @ B
        g[0] += C @ X
        for k in range(1, TERMS):
            X = -R @ X
            g[k] = C @ X
        g[TERMS] = -C @ R @ X
        rho = np.linalg.norm(R, 2, axis=(1, 2))
        ratio = h * rho
        rows, columns = np.linalg.norm(C @ R, axis=2), np.linalg.norm(X, axis=1)
        with np.errstate(divide="ignore"):
            geometric = np.where(ratio < 1, h ** (TERMS + 1) * rho / (1 - ratio), np.inf)
        rest = _times(rows[:, :, None] * columns[:, None, :], geometric[:, None, None])
    return _delayed(g, rest, system.delay, s, h)


def _delayed(
    g: ComplexArray, rest: Array, tau: Array, s: ComplexArray, h: Array
) -> tuple[ComplexArray, Array]:
    """The series times e^(−sτ), and the bound on what lies beyond the kept terms."""
    factor = np.exp(-s[:, None] * tau)[:, None, :]
    product, majorant = np.zeros_like(g), np.zeros(g.shape)
    for k in range(TERMS + 1):
        for i in range(k + 1):
            term = tau ** (k - i) / factorial(k - i)
            product[k] += g[i] * (-1) ** (k - i) * term
            majorant[k] += abs(g[i]) * term
    powers = h ** np.arange(TERMS + 1)[:, None]
    growth = np.exp(h[:, None] * tau)[:, None, :]
    partial = np.einsum("kn,knij->nij", powers, majorant)
    whole = (np.einsum("kn,knij->nij", powers, abs(g)) + rest) * growth
    tail = np.where(tau > 0, np.maximum(whole - partial, 0.0), rest)
    return product * factor, np.asarray(tail * abs(factor))


def _balanced(system: StateSpace) -> tuple[Array, Array, Array]:
    """The same system in coordinates in which the norm of its resolvent is small."""
    if not system.nx:
        return system.A, system.B, system.C
    A, (scale, _) = scipy.linalg.matrix_balance(system.A, permute=False, separate=True)
    return A, system.B / scale[:, None], system.C * scale
