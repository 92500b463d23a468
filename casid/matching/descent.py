"""Levenberg-Marquardt on the quadratic matching error with the states eliminated.

G(s; λ) = (C (sI − A)⁻¹ B + D) e^(−sτ) and its derivatives are dense linear algebra, a few
milliseconds a step: the way to a start, from which the lifted programme (`casid.matching.lifted`)
goes on. Bounds are kept by projection, and no step is taken that moves a pole across the line of
comparison or further beyond it, since from there no descent leads back.
"""

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.evaluation import Matrices, MatrixFunction
from casid.matching.comparison import Comparison
from casid.model import Free

GUARD = 0.02  # distance from the line, in units of the band's middle, that guarded poles keep
PENALTY = 3.0  # of a violated constraint of the structure, in units of the response's size
DAMPING = (1e-2, 1e-9, 1e12)  # first, least and largest of Levenberg and Marquardt


@dataclass(frozen=True, eq=False, kw_only=True)
class Descent:
    """Where a descent ended: free values (nf,), mean square error, rightmost pole's real part."""

    values: Array
    cost: float
    abscissa: float


class Condensed:
    """The mean square error of a structure as a function of its scaled free parameters."""

    def __init__(self, free: Free, comparison: Comparison) -> None:
        self.matrices, self.comparison = MatrixFunction(free), comparison
        self.scale = free.scale[free.index]
        self.lower = free.lower[free.index] / self.scale
        self.upper = free.upper[free.index] / self.scale
        items = free.model.constraints()
        self._c = np.array([[item.lower, item.upper] for item in items], dtype=float).reshape(-1, 2)
        size = np.linalg.norm(comparison.W * comparison.G) / np.sqrt(len(comparison.s))
        self._penalty = PENALTY * float(size)
        self._rate = float(np.sqrt(comparison.band[0] * comparison.band[1]))
        self._guarded = False

    def on(self, comparison: Comparison) -> "Condensed":
        """The same structure compared elsewhere."""
        other = object.__new__(Condensed)
        other.__dict__.update(self.__dict__, comparison=comparison)
        return other

    def guarded(self) -> "Condensed":
        """The same with a penalty on poles right of the line, which drives them back."""
        other = self.on(self.comparison)
        other._guarded = self.comparison.line is not None
        return other

    def idle(self) -> np.ndarray:
        """Positions of the parameters that move no residual, at any of three random points."""
        rng = np.random.default_rng(0)
        middle = self.clip(np.zeros(len(self.scale)))
        size = np.zeros(len(self.scale))
        for _ in range(3):
            x = self.clip(middle + rng.uniform(-1.0, 1.0, len(middle)))
            with contextlib.suppress(np.linalg.LinAlgError):
                size = np.maximum(size, np.abs(self.jacobian(x)[1]).max(axis=1))
        return np.flatnonzero(size <= 1e-14 * size.max())

    def clip(self, x: Array) -> Array:
        """Scaled parameters moved onto their bounds."""
        return np.asarray(np.clip(x, self.lower, self.upper))

    def residual(self, x: Array) -> tuple[Array, float]:
        """Residuals, whose sum of squares is the cost, and the rightmost pole's real part."""
        at, c = self.matrices(x * self.scale), self.comparison
        r = c.W / np.sqrt(len(c.s)) * (at.response(c.s) - c.G)
        abscissa = float(np.linalg.eigvals(at.blocks[0]).real.max())
        return np.concatenate(
            [_real(r.ravel()), self._violation(at)[0], self._beyond(at)[0]]
        ), abscissa

    def jacobian(self, x: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives (nf, n)."""
        at, c = self.matrices(x * self.scale), self.comparison
        G, slope = at.response_slopes(c.s)
        W = c.W / np.sqrt(len(c.s))
        J = _real((W * slope).reshape(len(x), -1))
        more = [self._violation(at), self._beyond(at)]
        values = [_real((W * (G - c.G)).ravel()), *(value for value, _ in more)]
        slopes = [J, *(part for _, part in more)]
        return np.concatenate(values), np.concatenate(slopes, axis=1) * self.scale[:, None]

    def _violation(self, at: Matrices) -> tuple[Array, Array]:
        """Penalised violation of the structure's constraints (nc,), and its derivative (nf, nc)."""
        size = np.abs(at.dc * self.scale[:, None]).sum(axis=0)
        factor = self._penalty / np.where(size > 0, size, 1.0)
        off = at.c - np.clip(at.c, self._c[:, 0], self._c[:, 1])
        return off * factor, at.dc * np.where(off != 0, factor, 0.0)

    def _beyond(self, at: Matrices) -> tuple[Array, Array]:
        """Penalised distance of poles right of the line (nx,), and its derivative (nf, nx)."""
        nx, line = at.nx, self.comparison.line
        if not self._guarded or line is None:
            return np.zeros(0), np.zeros((len(self.scale), 0))
        poles, right = np.linalg.eig(at.N[:nx, :nx])
        left = np.linalg.inv(right)
        off = poles.real - line + GUARD * self._rate
        # d pole = (left row) dA (right column)
        outer = np.zeros((*at.N.shape, nx), dtype=complex)
        outer[:nx, :nx] = np.einsum("ir,ci->rci", left, right)
        slope = np.asarray(at.dN @ outer.reshape(-1, nx)).real
        factor = self._penalty / self._rate
        return factor * np.maximum(off, 0.0), np.where(off > 0, factor * slope, 0.0)


def descend(problem: Condensed, values: Array, *, steps: int, tolerance: float) -> Descent:
    """Levenberg-Marquardt from free values in physical units.

    Ends after so many steps, or when a step improves the cost by less than the fraction
    ``tolerance``. A start where the response does not exist is returned as it is.
    """
    x = problem.clip(values / problem.scale)
    here = _try(problem, x)
    damping = DAMPING[0]
    for _ in range(steps):
        if not np.isfinite(here.cost):
            break
        r, J = problem.jacobian(x)
        normal, gradient = J @ J.T, J @ r
        before = here
        while damping < DAMPING[2]:
            trial = problem.clip(x + _step(problem, x, normal, gradient, damping))
            there = _try(problem, trial)
            if there.cost < here.cost and _allowed(problem, here, there):
                x, here = trial, there
                break
            damping *= 4
        damping = max(damping / 5, DAMPING[1])
        if not here.cost < before.cost * (1 - tolerance):
            break
    return replace(here, values=x * problem.scale)


def _try(problem: Condensed, x: Array) -> Descent:
    try:
        r, abscissa = problem.residual(x)
    except np.linalg.LinAlgError:
        return Descent(values=x, cost=np.inf, abscissa=np.inf)
    cost = float(r @ r)
    return Descent(values=x, cost=cost if np.isfinite(cost) else np.inf, abscissa=abscissa)


def _allowed(problem: Condensed, here: Descent, there: Descent) -> bool:
    line = problem.comparison.line
    return line is None or there.abscissa < max(line, here.abscissa)


def _step(problem: Condensed, x: Array, normal: Array, gradient: Array, damping: float) -> Array:
    """Damped Gauss-Newton step; parameters that would leave their bounds stop there."""
    diagonal = np.diag(normal)
    H = normal + damping * np.diag(np.maximum(diagonal, 1e-8 * max(diagonal.max(), 1e-300)))
    lower, upper = problem.lower - x, problem.upper - x
    step = np.zeros_like(x)
    free = ~(((lower >= 0) & (gradient > 0)) | ((upper <= 0) & (gradient < 0)))
    for _ in range(4):
        if not free.any():
            break
        right = -gradient[free] - H[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(H[np.ix_(free, free)], right)
        out = free & ((step < lower) | (step > upper))
        if not out.any():
            break
        step[out] = np.clip(step, lower, upper)[out]
        free &= ~out
    return step


def _real(z: ComplexArray) -> Array:
    return np.concatenate([z.real, z.imag], axis=-1)
