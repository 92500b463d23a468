"""Levenberg-Marquardt on the quadratic matching error with the states eliminated.

G(s; λ) = (C (sI − A)⁻¹ B + D) e^(−sτ) and its derivatives are dense linear algebra, a few
milliseconds a step: the way to a start, from which the lifted programme (`casid.matching.lifted`)
goes on. Bounds are kept by projection, and no step is taken that moves a pole across the line of
comparison or further beyond it, since from there no descent leads back.
"""

import contextlib
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse

from casid.arrays import Array, ComplexArray
from casid.matching.comparison import Comparison
from casid.model import Free

GUARD = 0.02  # distance from the line, in units of the band's middle, that guarded poles keep
PENALTY = 3.0  # of a violated constraint of the structure, in units of the response's size
DAMPING = (1e-2, 1e-9, 1e12)  # first, least and largest of Levenberg and Marquardt


@dataclass(frozen=True, eq=False, kw_only=True)
class Numbers:
    """[A B; C D] (nx + ny, nx + nu), τ (nu,), constraints (nc,) and their derivatives at some λ.

    ``dN``, ``dtau`` and ``dc`` have one row a free parameter; the first is sparse, its columns
    the entries of N row by row.
    """

    N: Array
    tau: Array
    c: Array
    dN: scipy.sparse.csr_array  # noqa: N815 - the derivative of N
    dtau: Array
    dc: Array


class Structure:
    """A structure as numbers: matrices and derivatives as functions of its free parameters."""

    def __init__(self, free: Free) -> None:
        lam = ca.SX.sym("lam", len(free.index))
        A, B, C, D, tau, c = free.model.matrices()(free.full(lam))
        N = ca.densify(ca.blockcat([[A, B], [C, D]]))
        J = ca.jacobian(ca.vec(N.T), lam)
        entries: list[Any] = J.nonzeros()
        dense = [ca.densify(part) for part in (tau, c, ca.jacobian(tau, lam), ca.jacobian(c, lam))]
        column = ca.vertcat(ca.SX(0, 1), *entries)
        self._function = ca.Function("structure", [lam], [N, column, *dense])
        place, parameter = J.sparsity().get_triplet()
        self._place, self._parameter = np.array(place, dtype=int), np.array(parameter, dtype=int)
        self.nx, self.nu, self.ny, self.nf = A.shape[0], B.shape[1], C.shape[0], len(free.index)

    def at(self, values: Array) -> Numbers:
        """The numbers at free values (nf,) in physical units."""
        N, entries, tau, c, dtau, dc = (part.full() for part in self._function(values))
        sparse = (entries.ravel(), (self._parameter, self._place))
        dN = scipy.sparse.csr_array(sparse, shape=(self.nf, N.size))
        return Numbers(N=N, tau=tau.ravel(), c=c.ravel(), dN=dN, dtau=dtau.T, dc=dc.T)


@dataclass(frozen=True, eq=False, kw_only=True)
class Descent:
    """Where a descent ended: free values (nf,), mean square error, rightmost pole's real part."""

    values: Array
    cost: float
    abscissa: float


class Condensed:
    """The mean square error of a structure as a function of its scaled free parameters."""

    def __init__(self, free: Free, comparison: Comparison) -> None:
        self.structure, self.comparison = Structure(free), comparison
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
        numbers = self.structure.at(x * self.scale)
        r, abscissa, _ = self._response(numbers)
        poles = self._beyond(numbers)[0]
        return np.concatenate([_real(r.ravel()), self._violation(numbers)[0], poles]), abscissa

    def jacobian(self, x: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives (nf, n)."""
        numbers = self.structure.at(x * self.scale)
        r, _, (Q, V, G, W) = self._response(numbers)
        rows, columns = np.divmod(np.arange(numbers.N.size), numbers.N.shape[1])
        used = np.unique(numbers.dN.indices)
        terms = Q[:, :, rows[used]].transpose(2, 0, 1)[:, :, :, None]
        terms = terms * V[:, columns[used], :].transpose(1, 0, 2)[:, :, None, :]
        J = np.asarray(numbers.dN[:, used] @ terms.reshape(len(used), r.size)).reshape(-1, *r.shape)
        J = J - numbers.dtau[:, None, None, :] * self.comparison.s[:, None, None] * G
        J = (J * W).reshape(len(x), -1) * self.scale[:, None]
        more = [self._violation(numbers), self._beyond(numbers)]
        slopes = [slope * self.scale[:, None] for _, slope in more]
        return (
            np.concatenate([_real(r.ravel()), *(value for value, _ in more)]),
            np.concatenate([_real(J), *slopes], axis=1),
        )

    def _response(
        self, numbers: Numbers
    ) -> tuple[ComplexArray, float, tuple[ComplexArray, ComplexArray, ComplexArray, Array]]:
        c, nx, ny = self.comparison, self.structure.nx, self.structure.ny
        N = numbers.N
        A, B, C, D = N[:nx, :nx], N[:nx, nx:], N[nx:, :nx], N[nx:, nx:]
        s = c.s[:, None, None]
        R = np.linalg.inv(s * np.eye(nx) - A)
        U = np.exp(-s * numbers.tau) * np.eye(len(numbers.tau)) * c.input_scale
        X = R @ (B @ U)
        G = C @ X + D @ U
        W = c.W / c.input_scale / np.sqrt(len(c.s))
        Q = np.concatenate([C @ R, np.broadcast_to(np.eye(ny), (len(s), ny, ny))], axis=2)
        parts = Q, np.concatenate([X, U], axis=1), G, W
        abscissa = float(np.linalg.eigvals(A).real.max())
        return W * (G - c.G * c.input_scale), abscissa, parts

    def _violation(self, numbers: Numbers) -> tuple[Array, Array]:
        """Penalised violation of the structure's constraints (nc,), and its derivative (nf, nc)."""
        size = np.abs(numbers.dc * self.scale[:, None]).sum(axis=0)
        factor = self._penalty / np.where(size > 0, size, 1.0)
        off = numbers.c - np.clip(numbers.c, self._c[:, 0], self._c[:, 1])
        return off * factor, numbers.dc * np.where(off != 0, factor, 0.0)

    def _beyond(self, numbers: Numbers) -> tuple[Array, Array]:
        """Penalised distance of poles right of the line (nx,), and its derivative (nf, nx)."""
        nx, line = self.structure.nx, self.comparison.line
        if not self._guarded or line is None:
            return np.zeros(0), np.zeros((self.structure.nf, 0))
        poles, right = np.linalg.eig(numbers.N[:nx, :nx])
        left = np.linalg.inv(right)
        off = poles.real - line + GUARD * self._rate
        # d pole = (left row) dA (right column)
        outer = np.zeros((*numbers.N.shape, nx), dtype=complex)
        outer[:nx, :nx] = np.einsum("ir,ci->rci", left, right)
        slope = np.asarray(numbers.dN @ outer.reshape(-1, nx)).real
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
