"""Levenberg-Marquardt on the quadratic matching error with the states eliminated.

G(s; λ) = (C (sI − A)⁻¹ B + D) e^(−sτ) and its derivatives are dense linear algebra, a few
milliseconds a step: the way to a start, from which the programme (`casid.matching.programme`)
goes on. Bounds are kept by projection, and no step is taken that moves a pole across the line of
comparison or further beyond it, since from there no descent leads back.
"""

import contextlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.errors import ModelError
from casid.evaluation import Matrices, MatrixFunction
from casid.free import Free
from casid.matching.comparison import Comparison
from casid.matching.mismatch import residual_slopes, weighted_errors

GUARD = 0.02  # distance from the line, in units of the band's middle, that guarded poles keep
PENALTY = 3.0  # of a violated constraint of the structure, in units of the response's size
DAMPING = (1e-2, 1e-9, 1e12)  # first, least and largest of Levenberg and Marquardt


@dataclass(frozen=True, eq=False, kw_only=True)
class Descent:
    """Where a descent ended."""

    values: Array  # (nf,) in physical units
    cost: float
    abscissa: float  # real part of the rightmost pole
    steps: int = 0
    settled: bool = False  # whether further steps would have gained nothing


@dataclass(frozen=True, eq=False, kw_only=True)
class Condensed:
    """Residuals of a structure and their derivatives as functions of its scaled free parameters."""

    free: Free
    comparison: Comparison
    norm: str  # quadratic: the weighted error; decibel: weighted decibels and degrees
    matrices: MatrixFunction
    penalty: float  # weight of a violated constraint
    guarded: bool = False  # whether poles right of the line are penalised, which drives them back

    @classmethod
    def of(cls, free: Free, comparison: Comparison, *, guarded: bool = False) -> "Condensed":
        """The quadratic norm of a comparison."""
        size = np.linalg.norm(comparison.W * comparison.G) / np.sqrt(len(comparison.s))
        return cls(
            free=free,
            comparison=comparison,
            norm="quadratic",
            matrices=MatrixFunction(free),
            penalty=PENALTY * float(size),
            guarded=guarded and comparison.line is not None,
        )

    @cached_property
    def scale(self) -> Array:
        """Typical magnitude of each free parameter, (nf,)."""
        return np.asarray(self.free.scale[self.free.index])

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the scaled parameters."""
        free = self.free
        return free.lower[free.index] / self.scale, free.upper[free.index] / self.scale

    @cached_property
    def _held(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the structure's constraints, then of its delays."""
        items = [(c.lower, c.upper) for c in self.free.model.constraints()]
        limits = np.array([*items, *[(0.0, np.inf)] * self.matrices.nu], dtype=float)
        return limits[:, 0], limits[:, 1]

    @property
    def _rate(self) -> float:
        """Middle of the band [rad/s]."""
        return float(np.sqrt(self.comparison.band[0] * self.comparison.band[1]))

    def idle(self) -> np.ndarray:
        """Positions of the parameters that move no residual, at any of three random points."""
        rng = np.random.default_rng(0)
        middle = self.clip(np.zeros(len(self.scale)))
        size = np.zeros(len(self.scale))
        for _ in range(3):
            away = middle + rng.uniform(-1.0, 1.0, len(middle))
            x = self.clip(2 * self.clip(away) - away)  # reflected: with one at zero others are idle
            with contextlib.suppress(np.linalg.LinAlgError):
                size = np.maximum(size, np.abs(self.jacobian(x)[1]).max(axis=1))
        return np.flatnonzero(size <= 1e-14 * size.max())

    def clip(self, x: Array) -> Array:
        """Scaled parameters moved onto their bounds."""
        return np.asarray(np.clip(x, *self.limits))

    def residual(self, x: Array) -> tuple[Array, float]:
        """Residuals, whose sum of squares is the cost, and the rightmost pole's real part."""
        at = self.matrices(x * self.scale)
        poles = np.linalg.eigvals(at.blocks[0]).real
        errors = self._errors(at.response(self.comparison.s))
        more = self._violation(at)[0], self._right(poles), self._prior_residuals(x)[0]
        return np.concatenate([errors, *more]), float(poles.max())

    def jacobian(self, x: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives (nf, n)."""
        at = self.matrices(x * self.scale)
        G, dG = at.response_slopes(self.comparison.s, self.comparison.W > 0)
        parts = [(self._errors(G), self._slopes(G, dG)), self._violation(at), self._beyond(at)]
        values, slopes = zip(*parts, self._prior_residuals(x), strict=True)
        J = np.concatenate(slopes, axis=1)
        J *= self.scale[:, None]
        return np.concatenate(values), J

    @cached_property
    def _weighed(self) -> slice | np.ndarray:
        """Which entries of all responses have a weight."""
        seen = self.comparison.W.ravel() > 0
        return slice(None) if seen.all() else np.flatnonzero(seen)

    def _errors(self, G: ComplexArray) -> Array:
        """Residuals of a response, (n,); of entries that weigh, or of all decibels."""
        c = self.comparison
        if self.norm == "decibel":
            return weighted_errors(G, c.G, c.decibel_weight).ravel()
        return _real(((c.W / np.sqrt(len(c.s)) * (G - c.G)).ravel())[self._weighed])

    def _slopes(self, G: ComplexArray, dG: ComplexArray) -> Array:
        """Derivatives of `_errors` from those of the response, (nf, n)."""
        c = self.comparison
        if self.norm == "decibel":
            return residual_slopes(G, dG, c.G, c.decibel_weight).reshape(len(dG), -1)
        weight = (c.W / np.sqrt(len(c.s))).ravel()[self._weighed]
        return _real(weight * dG.reshape(len(dG), -1)[:, self._weighed])

    def _violation(self, at: Matrices) -> tuple[Array, Array]:
        """Penalised violation of constraints and delays (m,), and its derivative (nf, m)."""
        c, dc = np.concatenate([at.c, at.tau]), np.concatenate([at.dc, at.dtau], axis=1)
        size = np.abs(dc * self.scale[:, None]).sum(axis=0)
        factor = self.penalty / np.where(size > 0, size, 1.0)
        off = c - np.clip(c, *self._held)
        return off * factor, dc * np.where(off != 0, factor, 0.0)

    def _prior_residuals(self, x: Array) -> tuple[Array, Array]:
        """Distances from prior values (n,), and their derivatives (nf, n)."""
        price = self.comparison.prior_weight(self.norm)
        off, slopes = self.free.prior_residuals(x * self.scale)
        return price * off, price * slopes.T

    def _beyond(self, at: Matrices) -> tuple[Array, Array]:
        """Penalised distance of poles right of the line (nx,), and its derivative (nf, nx)."""
        if not self.guarded:
            return np.zeros(0), np.zeros((len(self.scale), 0))
        nx = at.nx
        poles, right = np.linalg.eig(at.N[:nx, :nx])
        off = self._right(poles.real)
        left = np.linalg.inv(right)
        # d pole = (left row) dA (right column)
        outer = np.zeros((*at.N.shape, nx), dtype=complex)
        outer[:nx, :nx] = np.einsum("ir,ci->rci", left, right)
        slope = np.asarray(at.dN_used @ outer.reshape(-1, nx)[at.used]).real
        return off, np.where(off > 0, self.penalty / self._rate * slope, 0.0)

    def _right(self, poles: Array) -> Array:
        """Penalised distances right of the line of poles' real parts, (nx,); none unguarded."""
        line = self.comparison.line
        if not self.guarded or line is None:
            return np.zeros(0)
        off = poles - line + GUARD * self._rate
        return np.asarray(self.penalty / self._rate * np.maximum(off, 0.0))


def descend(problem: Condensed, values: Array, *, steps: int, tolerance: float) -> Descent:
    """Levenberg-Marquardt from free values in physical units.

    Ends after so many steps, or when a step improves the cost by less than the fraction
    ``tolerance``. A start where the response does not exist is returned as it is.
    """
    x = problem.clip(values / problem.scale)
    here = _try(problem, x)
    line = np.inf if problem.comparison.line is None else problem.comparison.line
    damping = DAMPING[0]
    done, settled = 0, False
    while done < steps and not settled and np.isfinite(here.cost):
        done += 1
        r, J = problem.jacobian(x)
        normal, gradient = J @ J.T, J @ r
        before = here
        while damping < DAMPING[2]:
            trial = problem.clip(x + _step(problem, x, normal, gradient, damping))
            if np.array_equal(trial, x):
                break  # nor does a shorter step move anything
            there = _try(problem, trial)
            if there.cost < here.cost and there.abscissa < max(line, here.abscissa):
                x, here = trial, there
                break
            damping *= 4
        damping = max(damping / 5, DAMPING[1])
        settled = not here.cost < before.cost * (1 - tolerance)
    return replace(here, values=x * problem.scale, steps=done, settled=settled)


def _try(problem: Condensed, x: Array) -> Descent:
    try:
        r, abscissa = problem.residual(x)
    except np.linalg.LinAlgError:
        return Descent(values=x, cost=np.inf, abscissa=np.inf)
    cost = float(r @ r)
    return Descent(values=x, cost=cost if np.isfinite(cost) else np.inf, abscissa=abscissa)


def _step(problem: Condensed, x: Array, normal: Array, gradient: Array, damping: float) -> Array:
    """Damped Gauss-Newton step; parameters that would leave their bounds stop there."""
    diagonal = np.diag(normal)
    H = normal + damping * np.diag(np.maximum(diagonal, 1e-8 * max(diagonal.max(), 1e-300)))
    lower, upper = (limit - x for limit in problem.limits)
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
    """Real and imaginary parts by turns, (..., 2 n) for complex (..., n)."""
    return np.ascontiguousarray(z).view(float)


def check_effects(problem: Condensed, lacking: str = "") -> None:
    """Raise a ModelError for a parameter on which no weighted response depends.

    What is ``lacking`` of the model's channels in the targets is said beside.
    """
    if len(idle := problem.idle()):
        names = [problem.free.names[k] for k in idle]
        has, it = ("has", "it") if len(names) == 1 else ("have", "them")
        raise ModelError(
            f"{', '.join(names)} {has} no effect on any weighted response: no target can identify "
            f"{it}; fix {it} (fixed={{{', '.join(map(repr, names))}}}), or weigh an output that "
            f"depends on {it}" + f" ({lacking})" * bool(lacking)
        )
