"""The programmes of model matching: the parameters are the variables, responses follow from them.

At every point s_k of a `Comparison` the weighted error of the structure is

    E_k = W_k ∘ (G(s_k; λ) − Ĝ_k),    G = (C (sI − A)⁻¹ B + D) e^(−sτ),

with exact first and second derivatives (`casid.evaluation`). The quadratic norm minimises the mean
of ‖E_k‖²_F. The H-infinity norm minimises t subject to t I − E_kᴴ E_k = L_k L_kᴴ: √t is the largest
singular value over the points, exactly (M. Bergamasco, M. Lovera, "Rotorcraft system
identification: a time/frequency domain approach", equation (10) as an epigraph,
`casid.matching.epigraph`). What matters only where the error is not largest leaves the norm as it
is, so the optimum need not be unique; a small share of the mean square error decides. The third
norm is the cost in decibels and degrees, `casid.matching.costs`.

Everything is scaled: parameters by their typical magnitude, inputs and outputs by the comparison's
weights, errors by ``unit``.
"""

import contextlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.assembly import Pattern, evaluated, grid, stack, upper_triangle
from casid.evaluation import MatrixFunction
from casid.free import Free
from casid.matching import epigraph
from casid.matching.comparison import Comparison
from casid.matching.costs import Decibels, MeanSquare
from casid.matching.side_constraints import SideConstraints
from casid.nlp import Problem, SolverOptions, solve

START = 1.05  # t at the start, in units of the largest squared error there
HELD = 100  # trial points beyond the line, after which a solve is given up
TIE = 1e-3  # weight of the mean square error beside the largest squared one

# A quadratic programme starts next to its solution, which its barrier must not blur.
CLOSE: dict[str, float | str] = {"mu_init": 1e-7, "bound_push": 1e-8, "bound_frac": 1e-8}
CLOSE |= {"tol": 1e-11, "acceptable_tol": 1e-6, "acceptable_iter": 3}
# Along a valley of solutions the barrier moves it for ever; there a cost that stays is the end.
CLOSE |= {"acceptable_compl_inf_tol": 1e-10, "acceptable_obj_change_tol": 1e-12}
FAR: dict[str, float | str] = {"mu_init": 1e-2, "bound_mult_init_method": "mu-based"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Optimum:
    """Where a programme ended, by IPOPT's word and with its effort."""

    values: Array  # (nf,) free parameters in physical units, on or inside their bounds
    multipliers: Array  # (nf,) derivatives of the cost by the bounds' positions
    prices: Array  # (nc,) the same by the constraints' positions
    cost: float  # what was minimised: the mean square, or t and a share of it
    success: bool
    status: str
    iterations: int
    held: bool = False  # whether poles were held back on the way


@dataclass(frozen=True, eq=False, kw_only=True)
class _Point:
    """Responses at one parameter set."""

    lam: Array
    G: ComplexArray  # (K, ny, nu)
    E: ComplexArray  # errors, (K, ny, nu)


class Programme:
    """One programme over x = (λ, t, L_k of all points, Lyapunov factor), each scaled.

    The norm is "quadratic", "hinf" or "decibel"; it starts from free values (nf,) in physical
    units. If ``stable``, a Lyapunov equation keeps A(λ) − σ I Hurwitz. Trial points where a pole
    exceeds the ``line`` [1/s] have no value; those of the start must not. A solve that is held
    there again and again is given up, no point having a value any more.
    """

    def __init__(
        self,
        free: Free,
        comparison: Comparison,
        norm: str,
        values: Array,
        *,
        stable: bool = False,
        line: float | None = None,
    ) -> None:
        self.free, self.comparison, self.norm, self.start = free, comparison, norm, values
        self.line = np.inf if line is None else line
        self.scale = free.scale[free.index]
        self.matrices = MatrixFunction(free)
        at = self.matrices(values)
        K, ny, nu = comparison.G.shape
        error = comparison.W * (at.response(comparison.s) - comparison.G)
        self.unit = _largest(error) if norm == "hinf" else 0.0
        self.unit = self.unit or _largest(comparison.W * comparison.G) or 1.0
        self.cost_of: MeanSquare | Decibels
        if norm == "decibel":
            self.cost_of = Decibels(comparison, self.unit)
        else:
            share = TIE if norm == "hinf" else 1.0
            self.cost_of = MeanSquare(comparison, self.unit, share)
        self.wide = ny < nu
        self.r = min(ny, nu) if norm == "hinf" else 0
        self.side = SideConstraints(free, comparison, at if stable else None)
        self.price = comparison.prior_weight(norm) / self.unit
        nf = len(values)
        self.first = nf + (norm == "hinf")
        self.factors = self.first + K * self.r**2
        self.points = np.arange(K * self.r**2).reshape(K, -1)
        self._held = 0
        self._last: _Point | None = None
        self._slopes: tuple[_Point, ComplexArray] | None = None

    # ---- solving --------------------------------------------------------------------------------

    def solve(self, options: SolverOptions, stage: str) -> Optimum:
        """Solve it with IPOPT."""
        near = FAR if self.norm == "hinf" else CLOSE
        found = solve(
            self.problem(), replace(options, ipopt=near | dict(options.ipopt)), stage=stage
        )
        unit = self.unit**2
        ties = self.points.size + np.arange(len(self.free.model.constraints()))
        return Optimum(
            values=self.parameters(found.x), cost=found.f * unit, success=found.success,
            multipliers=-found.multipliers_x[: len(self.scale)] / self.scale * unit,
            prices=-found.multipliers_g[ties] / self.free.constraint_sizes * unit,
            status=found.status, iterations=found.iterations, held=self._held > 0,
        )  # fmt: skip

    def parameters(self, x: Array) -> Array:
        """Free parameters (nf,) in physical units, on or inside their bounds."""
        free = self.free
        values = x[: len(free.index)] * self.scale
        return np.asarray(np.clip(values, free.lower[free.index], free.upper[free.index]))

    def problem(self) -> Problem:
        """The programme for `casid.nlp.solve`."""
        free, s = self.free, self.scale
        parts = [(self.start / s, free.lower[free.index] / s, free.upper[free.index] / s)]
        if self.r:
            parts.append((np.array([START]), np.zeros(1), np.full(1, np.inf)))
            gram = self._gram(self._point(self.start / s).E)
            L = epigraph.numbers(np.linalg.cholesky(START * np.eye(self.r) - gram))
            lower = np.where(np.arange(self.r**2) < self.r, 0.0, -np.inf)  # the diagonal first
            parts.append((L.ravel(), np.tile(lower, len(L)), np.full(L.size, np.inf)))
        parts.append(self.side.start)
        x0, lower, upper = (np.concatenate(column) for column in zip(*parts, strict=True))
        sides = np.pad(self.side.limits, ((0, 0), (self.points.size, 0)))
        patterns = self._jacobian_pattern.sparsity, self._hessian_pattern.sparsity
        return evaluated(self, (x0, lower, upper), (sides[0], sides[1]), *patterns)

    # ---- what IPOPT asks ------------------------------------------------------------------------

    def cost(self, x: Array) -> float:
        """Mean square, or t and a share of it; and of distances from prior values."""
        off = self.price * self.free.prior_residuals(x[: len(self.scale)] * self.scale)[0]
        top = float(x[len(self.scale)]) if self.r else 0.0
        return top + self.cost_of.value(self._point(x).E) + float(off @ off)

    def gradient(self, x: Array) -> Array:
        """Its gradient."""
        point, dE = self._at(x)
        off, pull = self.free.prior_residuals(point.lam)
        slope = np.zeros(len(x))
        slope[len(self.scale) : self.first] = 1.0
        slope[: len(self.scale)] = _gram(dE, self.cost_of.pull(point.E)[None])[:, 0]
        slope[: len(self.scale)] += 2 * self.price**2 * (pull.T @ off) * self.scale
        return slope

    def constraints(self, x: Array) -> Array:
        """Eᴴ E + L Lᴴ − t I of every point, then the structure's own."""
        values = self.side.values(self._own(x))
        if not self.r:
            return values
        r = self.r
        l = self._factor(x)
        g = epigraph.numbers(self._gram(self._point(x).E))
        g += np.einsum("kv,mvw,kw->km", l, epigraph.squares(r), l, optimize=True)
        g[:, :r] -= x[len(self.scale)]
        return np.concatenate([g.ravel(), values])

    def jacobian(self, x: Array) -> Array:
        """Nonzeros of their Jacobian."""
        parts = [self.side.slopes(self._own(x)).ravel()]
        if self.r:
            point, dE = self._at(x)
            E, dE = self._tall(point.E), self._tall(dE)
            half = E.conj().swapaxes(-1, -2) @ dE
            slope = epigraph.numbers(half + half.conj().swapaxes(-1, -2))
            by_factor = 2 * np.tensordot(self._factor(x), epigraph.squares(self.r), axes=(1, 2))
            top = np.full(len(self.points) * self.r, -1.0)
            m, v = self._touched
            parts += [slope.transpose(1, 2, 0).ravel(), top, by_factor[:, m, v].ravel()]
        return self._jacobian_pattern.order(np.concatenate(parts))

    def hessian(self, x: Array, f: float, mu: Array) -> Array:
        """Nonzeros of the upper triangle of the Lagrangian's Hessian."""
        point, dE = self._at(x)
        nf, s = len(self.scale), self.scale
        pull, curved = f * self.cost_of.pull(point.E), f * self.cost_of.curved(point.E, dE)
        parts = []
        if self.r:
            local = mu[: self.points.size].reshape(self.points.shape)
            Y = epigraph.hermitian_weights(local)
            pull += 2 * self._tall(self._tall(point.E) @ Y)
            curved += 2 * self._tall(self._tall(dE) @ Y)
            twice = 2 * np.tensordot(local, epigraph.squares(self.r), axes=1)
            v, w = self._bent
            parts.append(twice[:, v, w].ravel())
        off = self.free.prior_residuals(point.lam)[1] * self.price * s
        H = 2 * f * off.T @ off + _gram(dE, curved)
        at = self.matrices(point.lam)
        by_N, by_tau, bend = at.response_curvature(
            self.comparison.s, pull * np.conj(self.cost_of.factor(point.G))
        )
        H += (bend + self.matrices.curvature(point.lam, by_N, by_tau)) * np.outer(s, s)
        beside = self.side.curvature(self._own(x), mu[self.points.size :])
        H += beside[:nf, :nf]
        parts += [beside[:nf, nf:].ravel(), upper_triangle(beside[None, nf:, nf:])]
        return self._hessian_pattern.order(np.concatenate([upper_triangle(H[None]), *parts]))

    # ---- pieces ---------------------------------------------------------------------------------

    def _own(self, x: Array) -> Array:
        """Variables of the constraints beside the responses."""
        return np.concatenate([x[: len(self.scale)], x[self.factors :]])

    def _factor(self, x: Array) -> Array:
        """The numbers of L of every point, (K, r²)."""
        return x[self.first : self.factors].reshape(-1, self.r**2)

    def _point(self, x: Array) -> _Point:
        lam = x[: len(self.scale)] * self.scale
        if self._last is None or not np.array_equal(lam, self._last.lam):
            at, G = self.matrices(lam), np.full(self.comparison.G.shape, complex(np.nan))
            with contextlib.suppress(np.linalg.LinAlgError):  # a pole on a point, or far out
                beyond = np.linalg.eigvals(at.blocks[0]).real.max() > self.line
                self._held += int(beyond)
                G = G if beyond or self._held > HELD else at.response(self.comparison.s)
            self._last = _Point(lam=lam, G=G, E=self.cost_of.errors(G))
        return self._last

    def _at(self, x: Array) -> tuple[_Point, ComplexArray]:
        """The point, and its errors' derivatives by the scaled parameters, (nf, K, ny, nu)."""
        point = self._point(x)
        if self._slopes is None or self._slopes[0] is not point:
            dG = self.matrices(point.lam).response_slopes(self.comparison.s)[1]
            dG *= self.cost_of.factor(point.G) * self.scale[:, None, None, None]
            self._slopes = point, dG
        return self._slopes

    def _tall(self, E: ComplexArray) -> ComplexArray:
        """Errors (..., q, r), r <= q; and back."""
        return E.swapaxes(-1, -2) if self.wide else E

    def _gram(self, E: ComplexArray) -> ComplexArray:
        E = self._tall(E)
        return np.asarray(E.conj().swapaxes(-1, -2) @ E)

    # ---- sparsity -------------------------------------------------------------------------------

    @cached_property
    def _touched(self) -> tuple[np.ndarray, ...]:
        """Constraints of a point and the numbers of its L that they depend on."""
        return np.nonzero(epigraph.squares(self.r).any(axis=2))

    @cached_property
    def _bent(self) -> tuple[np.ndarray, ...]:
        """Pairs of numbers of an L that multiply each other."""
        return np.nonzero(np.triu(epigraph.squares(self.r).any(axis=0)))

    @cached_property
    def _jacobian_pattern(self) -> Pattern:
        nf, rows = len(self.scale), self.points
        size = self.factors + len(self.side.start[0])
        own = np.concatenate([np.arange(nf), np.arange(self.factors, size)])[None]
        places = [grid(rows.size + np.arange(self.side.count)[None], own)]
        if self.r:
            m, v = self._touched
            diagonal = rows[:, : self.r].ravel()
            places += [
                grid(rows, np.tile(np.arange(nf), (len(rows), 1))),
                (diagonal, np.full(len(diagonal), nf)),
                (rows[:, m].ravel(), self.first + rows[:, v].ravel()),
            ]
        return Pattern(*stack(places), size=size, rows=rows.size + self.side.count)

    @cached_property
    def _hessian_pattern(self) -> Pattern:
        nf = len(self.scale)
        size = self.factors + len(self.side.start[0])
        lam, m = np.arange(nf)[None], np.arange(self.factors, size)[None]
        places = [grid(lam, lam, upper=True)]
        if self.r:
            v, w = (self.first + self.points[:, each].ravel() for each in self._bent)
            places.append((v, w))
        places += [grid(lam, m), grid(m, m, upper=True)]
        return Pattern(*stack(places), size=size)


def _gram(left: ComplexArray, right: ComplexArray) -> Array:
    """Re Σ conj(left_i) ∘ right_j over all entries."""
    a, b = (np.ascontiguousarray(z.reshape(len(z), -1)).view(float) for z in (left, right))
    return np.asarray(a @ b.T)


def _largest(E: ComplexArray) -> float:
    return float(np.linalg.norm(E, 2, axis=(1, 2)).max())
