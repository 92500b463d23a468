"""Starting points of a match, by continuation from the right of the plane.

Far right of all poles a response is smooth, hardly more than its first Markov parameters, and
nearly every start leads to the same best fit; on the line of comparison many end in local minima,
often with poles of A(λ) right of it. So the line begins there and moves left to its place, the
structure fitted at every stop and its poles kept left of it. Two points start: the guess, and one
from alternating least squares. With the states' responses X_k known, every row of A, B, C and D is
linear in λ:

    s_k X_k = A(λ) X_k + B(λ) e^(−s_k τ)        Ĝ_k = C(λ) X_k + D(λ) e^(−s_k τ)

and with λ known X_k is; the two alternate. At first λ is known only to its sign or order of
magnitude, so each equation errs by what its parameters may still contribute. Weighted with the
covariance of these errors, the states follow from what the structure says without λ: kinematics,
an output that is a state, the difference of a specific force and the row of A that shares its
derivatives. The assumed spread of λ then shrinks from one alternation to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from casid.arrays import Array, ComplexArray
from casid.matching.comparison import Comparison
from casid.matching.descent import Condensed, descend

SPREADS = (1.0, 1.0, 0.5, 0.2, 0.1)  # of λ about its present value, in units of its scale
NOISE = 1e-2  # error of an equation that has no parameter, relative to its terms
RIDGE = 1e-10  # weight, on the square, of present parameters of which the states say nothing
NEWTON = 6  # Gauss-Newton steps for the parameters
FARTHEST = 0.4  # of the band's upper end: where the line begins
STRIDE = 1.7  # from one line to the next
SAME = 1e-4  # relative difference of costs of one minimum, found from two starts
GOOD = 0.3  # error of a fit, relative to the response, that calls for another start


@dataclass(frozen=True, eq=False, kw_only=True)
class StartingPoint:
    """Where a programme may start: its name, free parameters (nf,) and their cost."""

    name: str
    values: Array
    cost: float


def starts(problem: Condensed, *, large: bool) -> tuple[StartingPoint, ...]:
    """Starting points of the quadratic programme, the best first; of a large one as few as do."""
    comparison = problem.comparison
    good = GOOD**2 * np.linalg.norm(comparison.W * comparison.G) ** 2 / len(comparison.s)
    found = [_continued(problem, "guess", problem.free.guess)]
    if not (large and found[0].cost < good):
        values = least_squares(problem)
        if values is not None:
            found.append(_continued(problem, "least squares", values))
    if comparison.line is not None:
        found.append(_descended(problem, "guess as it is", problem.free.guess))
    return distinct_minima(found)


def distinct_minima(found: Sequence[StartingPoint]) -> tuple[StartingPoint, ...]:
    """Starts by increasing cost, the first of those that are one minimum, as their costs tell."""
    kept: list[StartingPoint] = []
    for start in sorted(found, key=lambda start: start.cost):
        if not any(np.isclose(start.cost, other.cost, rtol=SAME) for other in kept):
            kept.append(start)
    return tuple(kept)


def _descended(problem: Condensed, name: str, values: Array) -> StartingPoint:
    """Descend from where one is."""
    last = descend(problem, values, steps=100, tolerance=1e-6)
    return StartingPoint(name=name, values=last.values, cost=last.cost)


def _continued(problem: Condensed, name: str, values: Array) -> StartingPoint:
    """Descend on lines that move left to the line of comparison, and on that."""
    comparison = problem.comparison
    if comparison.line is not None:
        here = descend(problem, values, steps=0, tolerance=0.0)
        for line in _lines(comparison, here.abscissa):
            there = replace(problem, comparison=comparison.shifted(line))
            values = descend(there, values, steps=15, tolerance=1e-4).values
    return _descended(problem, name, values)


def _lines(comparison: Comparison, abscissa: float) -> Array:
    """Shifts from far right to the comparison's own, which is left out."""
    low, high = comparison.band
    beyond = abscissa if np.isfinite(abscissa) else 0.0
    first = max(FARTHEST * high, 1.5 * beyond, 2 * comparison.shift)
    last = max(comparison.shift, 0.1 * low)
    count = max(2, int(np.ceil(np.log(first / last) / np.log(STRIDE))))
    lines = np.geomspace(first, last, count + 1)
    return lines if last > comparison.shift else lines[:-1]


def least_squares(problem: Condensed) -> Array | None:
    """Free parameters (nf,) from alternating least squares; None when its numbers give none."""
    try:
        values = _StructureEquations(problem).solve()
    except np.linalg.LinAlgError:
        return None
    return values if np.isfinite(values).all() else None


class _StructureEquations:
    """The structure's equations at all points, linear in the states and nearly so in λ."""

    def __init__(self, problem: Condensed) -> None:
        self._free, self._matrices = problem.free, problem.matrices
        self._comparison = problem.comparison
        self.nx, self.nu, self.ny = self._matrices.nx, self._matrices.nu, self._matrices.ny
        guess = self._matrices(self._free.guess).state_response(self._comparison.s)
        guess = guess * self._comparison.input_scale
        self._guess = np.where(np.isfinite(guess), guess, 0.0)
        self.scale = _size(self._guess)

    def solve(self) -> Array:
        """Free parameters (nf,) in physical units."""
        values, X = self._free.guess, self._guess
        for sweep, spread in enumerate(SPREADS):
            X = self._states(values, X, spread)
            self.scale = _size(X)
            if sweep:  # the first pass only finds the size of the states
                values = self._parameters(values, X)
        return values

    def _weights(self) -> Array:
        """Weights of the rows of every point and input, (K, nx + ny, nu)."""
        c = self._comparison
        rate = np.maximum(np.abs(c.s), 1e-12)
        state = np.repeat(1 / (rate[:, None] * self.scale)[:, :, None], self.nu, axis=2)
        unit = np.linalg.norm(c.W * c.G) / np.sqrt(len(c.s) * self.ny) or 1.0  # of an output
        return np.concatenate([state, c.W / (c.input_scale * unit)], axis=1)

    def _inputs(self, tau: Array) -> ComplexArray:
        """Delayed scaled inputs, (K, nu, nu)."""
        c = self._comparison
        factors = np.exp(-c.s[:, None] * tau) * c.input_scale
        return np.asarray(factors[:, :, None] * np.eye(self.nu))

    def _states(self, values: Array, X: ComplexArray, spread: float) -> ComplexArray:
        """States that fit all equations best when the parameters may be off by their spread."""
        c = self._comparison
        at = self._matrices(values)
        N, tau = at.N, at.tau
        upper = c.s[:, None, None] * np.eye(self.nx) - N[: self.nx, : self.nx]
        lower = np.broadcast_to(-N[self.nx :, : self.nx], (len(c.s), self.ny, self.nx))
        M = np.concatenate([upper, lower], axis=1)
        y = np.concatenate([np.zeros((len(c.s), self.nx, self.nu)), c.G * c.input_scale], axis=1)
        R = N[:, self.nx :] @ self._inputs(tau) - y
        scaled = at.slopes * (spread * self._free.scale[self._free.index])[:, None, None]
        weights = self._weights()
        X = X.copy()
        for j in range(self.nu):
            size = np.concatenate([self.scale, c.input_scale * (np.arange(self.nu) == j)])
            errors = scaled * size  # (nf, rows, columns)
            w = weights[:, :, j]
            cov = np.einsum("lrc,lqc->rq", errors, errors) * w[:, :, None] * w[:, None, :]
            white = np.linalg.inv(np.linalg.cholesky(cov + NOISE**2 * np.eye(len(N))))
            Mw, Rw = white @ (w[:, :, None] * M * self.scale), white @ (w * R[:, :, j])[:, :, None]
            MH = Mw.conj().transpose(0, 2, 1)
            prior = X[:, :, j, None] / self.scale[:, None]
            normal = MH @ Mw + RIDGE * np.eye(self.nx)
            X[:, :, j] = np.linalg.solve(normal, MH @ Rw + RIDGE * prior)[:, :, 0] * self.scale
        return X

    def _parameters(self, values: Array, X: ComplexArray) -> Array:
        """Parameters within their bounds that fit all equations best with these states."""
        free, c, weights = self._free, self._comparison, self._weights()
        scale = free.scale[free.index]
        prior = values

        y = np.concatenate([c.s[:, None, None] * X, c.G * c.input_scale], axis=1)
        limits = free.lower[free.index] / scale, free.upper[free.index] / scale
        x = np.clip(values / scale, *limits)
        for _ in range(NEWTON):  # only delays and products of parameters need more than one step
            at = self._matrices(x * scale)
            N, U = at.N, self._inputs(at.tau)
            V = np.concatenate([X, U], axis=1)
            r = weights * (N @ V - y)
            J = np.tensordot(at.slopes, V, axes=(2, 1)).swapaxes(1, 2)
            late = N[:, self.nx :] @ (-c.s[:, None, None] * U)
            J = J + at.dtau[:, None, None, :] * late
            J = (weights * J).reshape(len(x), -1) * scale[:, None] / np.sqrt(len(c.s))
            step = _bounded_step(J, r.ravel() / np.sqrt(len(c.s)), prior / scale - x, x, limits)
            x = np.clip(x + step, *limits)
            if np.abs(step).max() < 1e-6 * max(1.0, np.abs(x).max()):
                break
        return np.asarray(x * scale)


def _size(X: ComplexArray) -> Array:
    size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
    return np.asarray(np.where(size > 0, size, 1.0))


def _bounded_step(
    J: ComplexArray, r: ComplexArray, prior: Array, x: Array, limits: tuple[Array, Array]
) -> Array:
    """Gauss-Newton step within the bounds, from the normal equations; J is (nf, residuals)."""
    normal = (J.conj() @ J.T).real + RIDGE * np.eye(len(x))
    right = (J.conj() @ -r).real + RIDGE * prior
    factor = np.linalg.cholesky(normal).T
    target = np.linalg.solve(factor.T, right)
    lower = np.minimum(limits[0] - x, -1e-12)
    upper = np.maximum(limits[1] - x, 1e-12)
    step = scipy.optimize.lsq_linear(factor, target, bounds=(lower, upper), method="bvls").x
    return np.asarray(step)
