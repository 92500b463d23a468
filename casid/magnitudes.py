"""Stable systems of given order whose magnitude lies above given values, and least in the mean.

W has its poles and zeros in the left half-plane; log(abs(W(jω))²) is a smooth function of the
logarithms of their frequencies and damping ratios, however little damped they are, and its mean
over log ω is made least, with no value below those given. The numbers v of a W are log(W(0)²), for
odd orders the logarithms of the frequencies of one zero and one pole, then those of frequency and
damping ratio of a pair of zeros, of a pair of poles, and so on.
"""

from functools import cache
from operator import itemgetter

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, ComplexArray
from casid.linear import StateSpace
from casid.nlp import Problem, SolverOptions, solve

TIGHT = 1.5  # times the values in the mean: tight enough
POINTS = 50  # evenly in log ω where a weight is held above the error, beside its peaks
MEAN = 100  # points of the mean
ROUNDS = 6  # of points added where a weight falls below
NEAR = 0.01  # of log(abs(W)²), by which it may
BEYOND = 3.0  # nepers outside the band for poles and zeros, and of damping ratios above one
NOTCH, PEAK = 0.02, 1e-6  # least damping ratios of zeros and of poles
OPTIONS = SolverOptions(tolerance=1e-4, max_iterations=60)


def mean(x: Array, values: Array) -> float:
    """Mean of values over x, which need not be even."""
    return float(np.trapezoid(values, x) / (x[-1] - x[0]))


def with_two_states_more(v: Array, x: Array, y: Array, states: int, tries: int = 3) -> Array:
    """Numbers of a weight of so many states, tight in the mean, given one of two states fewer."""
    if states == 0:
        return v
    if states == 1:
        return _fitted(np.append(v, np.full(2, x.mean())), x, y)[0]
    over = np.clip(_power(len(v))(v, x[None]).full()[0] - y, NEAR, None)
    # Zeros on poles change nothing: in the middle of what is too large, at the highest peak, where
    # it is largest.
    middle, peak, largest = mean(x, x * over) / mean(x, over), x[y.argmax()], x[over.argmax()]
    found = []
    for place, damping in ((middle, 0.3), (peak, 0.05), (largest, 0.1))[:tries]:
        found.append(_fitted(np.append(v, 2 * (place, np.log(damping))), x, y))
        if found[-1][1] < np.log(TIGHT):
            break
    return min(found, key=itemgetter(1))[0]


def _first(n: int) -> int:
    """Where pairs begin among the n numbers of a weight: after one real zero and pole, or none."""
    return 1 + 2 * (n // 2 % 2)


@cache
def _power(n: int) -> ca.Function:
    """log(abs(W)²) at log ω of the n numbers of W."""
    v, x = ca.SX.sym("v", n), ca.SX.sym("x")
    total = v[0]
    for sign, at in ((1, 1), (-1, 2)) if _first(n) > 1 else ():
        total += sign * ca.log(1 + ca.exp(2 * (x - v[at])))
    for at in range(_first(n), n, 4):
        for sign, pair in ((1, v[at : at + 2]), (-1, v[at + 2 : at + 4])):
            t = ca.exp(2 * (x - pair[0]))
            total += sign * ca.log((1 - t) ** 2 + 4 * ca.exp(2 * pair[1]) * t)
    return ca.Function("power", [v, x], [total])


def _fitted(v: Array, x: Array, y: Array) -> tuple[Array, float]:
    """Numbers whose log(abs(W)²) has the least mean with none below y; half its mean above y."""
    n, power = len(v), _power(len(v))
    even, unknown = np.linspace(x[0], x[-1], MEAN), ca.MX.sym("v", n)
    points = np.union1d(np.linspace(x[0], x[-1], POINTS), x[_tops(y)])
    lower, upper = _limits(n, x, y)
    best, least = v, np.inf
    for _ in range(ROUNDS):
        low = np.interp(points, x, y)
        v = np.clip(v, lower, upper)
        problem = Problem(
            x=unknown,
            f=ca.sum2(power.map(MEAN)(unknown, ca.DM(even[None]))) / MEAN,
            g=ca.vec(power.map(len(points))(unknown, ca.DM(points[None]))),
            x0=v,
            lower_x=lower,
            upper_x=upper,
            lower_g=low,
            upper_g=np.full(len(low), np.inf),
        )
        found = solve(problem, OPTIONS, stage="cover").x
        if not np.isfinite(found).all():
            break
        v = found
        over = power(v, x[None]).full()[0] - y
        excess = 0.5 * mean(x, over - over.min())
        if excess < least:
            best, least = np.append(v[0] - over.min(), v[1:]), excess
        if over.min() > -NEAR:
            break
        below = _tops(-over)
        points = np.union1d(points, x[[*below[over[below] < 0], over.argmin()]])
    return best, least


def _tops(values: Array) -> NDArray[np.intp]:
    """Positions of local maxima inside values (K,), plateaus included."""
    inner = values[1:-1]
    return 1 + np.flatnonzero((inner >= values[:-2]) & (inner >= values[2:]))


def _limits(n: int, x: Array, y: Array) -> tuple[Array, Array]:
    """Lower and upper bounds (n,) of a weight's numbers: gain, frequencies, damping ratios."""
    lower, upper, first = np.full(n, x[0] - BEYOND), np.full(n, x[-1] + BEYOND), _first(n)
    lower[0], upper[0] = -np.inf, np.inf
    # The logarithm of a peak falls by at most 1/ζ: none is narrower than the narrowest of y.
    narrow = max(PEAK, 0.5 / np.max(np.abs(np.diff(y) / np.diff(x)), initial=1.0))
    lower[first + 1 :: 4], lower[first + 3 :: 4] = np.log(NOTCH), np.log(narrow)
    upper[first + 1 :: 2] = BEYOND
    return lower, upper


def roots(v: Array) -> ComplexArray:
    """Zeros and poles of pairs, of every one that with the larger imaginary part."""
    omega, zeta = np.exp(v[_first(len(v)) :].reshape(-1, 2).T).astype(complex)
    return np.asarray(omega * (np.sqrt(zeta**2 - 1) - zeta))


def realisation(v: Array) -> StateSpace:
    """W as sections in series, whose poles and zeros stay exactly where they are."""
    first, sections = _first(len(v)), []
    if first > 1:
        p, r = np.exp(v[2]), np.exp(v[2] - v[1])
        sections.append(([[-p]], [[p]], [[1 - r]], r))
    for (w0, zeta0), (w, zeta) in np.exp(v[first:].reshape(-1, 2, 2)):
        r = (w / w0) ** 2
        own = [[1 - r, 2 * (zeta0 * w / w0 - zeta * r)]]
        sections.append(([[0, w], [-w, -2 * zeta * w]], [[0], [w]], own, r))
    A, B, C = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
    D = np.full((1, 1), np.exp(0.5 * v[0]))
    for inner, into, out, direct in sections:
        upper = np.zeros((len(A), len(inner)))
        A, B = np.block([[A, upper], [into @ C, np.array(inner)]]), np.vstack([B, into @ D])
        C, D = np.hstack([direct * C, out]), direct * D
    return StateSpace(A, B, C, D, None, ("w",), ("z",))
