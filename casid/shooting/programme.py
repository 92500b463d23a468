"""The multiple-shooting programme: Gram blocks of the intervals in, an IPOPT problem out.

    min  ( ℓ(λ, biases, nodes; R) + ½ Σ (λ − λ₀)²/σ² ) / n
    subject to  x_end(λ, x_j) - x_{j+1} = 0  within every record,  and the model's own constraints

with the negative log-likelihood ℓ of `casid.shooting.likelihood` and prior values, if any, of
`casid.shooting.priors`. If R is estimated it is the most
likely one at every iterate, so that ℓ is the concentrated likelihood: its gradient is that of ½ Σ
rᵀR⁻¹r with R held (the envelope theorem). The Hessian is the generalised Gauss-Newton one (Bock
1987): the Gram matrix of the residuals, with the nodes kept as variables. What IPOPT is given of it
is `casid.shooting.newton`.
"""

import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from casid.arrays import Array
from casid.assembly import Pattern, grid, stack, upper_triangle
from casid.free import Free
from casid.shooting.convolution import summed
from casid.shooting.likelihood import Noise, moments_of
from casid.shooting.priors import Knowledge
from casid.shooting.sensitivity import Evaluator, Motion, Point, Sweep, whiteners


@dataclass(frozen=True, eq=False)
class Blocks:
    """Gauss-Newton blocks in scaled variables, of all intervals (J) in chronological order.

    Suffixes: l the parameters, b the biases of the interval's record, n the interval's node.
    ``H`` and ``g`` are Hessian and gradient of ½ Σ rᵀR⁻¹r; ``ends`` and ``slope`` the end states
    and their derivatives; ``sweep`` is what computed them, in physical units.
    """

    Hll: Array
    Hlb: Array
    Hbb: Array
    Hln: Array
    Hbn: Array
    Hnn: Array
    gl: Array
    gb: Array
    gn: Array
    ends: Array
    slope_l: Array
    slope_n: Array
    slope_b: Array
    c_lam: Array
    sweep: Sweep

    def scaled(self, l: Array, b: Array, n: Array) -> "Blocks":
        """The same for variables whose units are so many times as large."""
        return Blocks(
            Hll=self.Hll * np.outer(l, l), Hlb=self.Hlb * np.outer(l, b),
            Hbb=self.Hbb * np.outer(b, b), Hln=self.Hln * np.outer(l, n),
            Hbn=self.Hbn * np.outer(b, n), Hnn=self.Hnn * np.outer(n, n),
            gl=self.gl * l, gb=self.gb * b, gn=self.gn * n, ends=self.ends,
            slope_l=self.slope_l * (l / n[:, None]), slope_n=self.slope_n * (n / n[:, None]),
            slope_b=self.slope_b * (b / n[:, None]), c_lam=self.c_lam * l, sweep=self.sweep,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Values:
    """Cost per observation, constraints, and the R and the motion that go with them."""

    cost: float
    g: Array
    R: Array
    motion: Motion


@dataclass(frozen=True, eq=False)
class Scales:
    """Typical magnitudes of parameters (nf,), outputs' biases (ny,) and states (nx,)."""

    lam: Array
    bias: Array
    state: Array


class Programme:
    """One weighted least-squares problem over all intervals, for IPOPT."""

    def __init__(
        self, evaluator: Evaluator, free: Free, scales: Scales, noise: Noise, biases: bool
    ) -> None:
        layout = evaluator.layout
        self.evaluator, self.free, self.scales = evaluator, free, scales
        self.noise, self.biases = noise, biases
        self.records, self.J = len(layout.records), len(layout.count)
        back = np.argsort(layout.node)
        self.record = layout.record[back]
        self.links = np.flatnonzero(~layout.last[back])  # nodes with a successor
        self.n = max(layout.observations, 1)
        self.knowledge = Knowledge(free, noise, self.record, self.evaluator.layout.records)
        self._forget()

    def variant(
        self,
        *,
        scales: Scales | None = None,
        noise: Noise | None = None,
        evaluator: Evaluator | None = None,
        free: Free | None = None,
    ) -> "Programme":
        """The same problem in other units, with another R, evaluator or bounds."""
        other = copy.copy(self)
        other.scales, other.noise = scales or self.scales, noise or self.noise
        other.evaluator, other.free = evaluator or self.evaluator, free or self.free
        other.knowledge = Knowledge(
            other.free, other.noise, self.record, other.evaluator.layout.records
        )
        other._forget()
        return other

    def roomier(self, room: float) -> "Programme":
        """The same with bounds wider by so much of their size, at least of one scaled unit.

        What is known goes with it. Values that are held stay so.
        """
        free, unit = self.free, self.free.scale.copy()
        unit[free.index] = self.scales.lam[: len(free.index)]
        wide = np.where(free.lower < free.upper, room, 0.0)
        with np.errstate(invalid="ignore"):  # of what has no bound
            low, high = (wide * np.maximum(unit, np.abs(side)) for side in (free.lower, free.upper))
            lower, upper = free.lower - low, free.upper + high
        other = copy.copy(self)
        other.free = replace(free, lower=lower, upper=upper)
        return other

    def _forget(self) -> None:
        self._seen: tuple[bytes, Values] | None = None
        self._blocks: tuple[bytes, Blocks] | None = None

    # ---- variables ------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of variables."""
        return self.first_node + self.J * self.evaluator.nx

    @property
    def nuisances(self) -> int:
        """How many numbers are estimated beside λ, those on continuity constraints left out."""
        return self._local + self.noise.unknowns + self.evaluator.nf - len(self.free.index)

    @property
    def _local(self) -> int:
        """Number of initial states and biases."""
        e = self.evaluator
        return self.records * (e.nx + self.biases * (e.ny - len(self.free.unbiased)))

    def understatement(self, held: int) -> float:
        """n/(n - p), by which residuals of p fitted numbers understate variances; 1 of a given R.

        Of n measurements; ``held`` parameters are on bounds or tied to others.
        """
        if self.noise.given is not None:
            return 1.0
        p = self._local + len(self.free.index) - held
        return self.n / max(self.n - p, 1)

    @property
    def first_node(self) -> int:
        """Position of the first node among the variables: behind λ and the biases."""
        return self.evaluator.nf + self.biases * self.records * self.evaluator.ny

    @property
    def _bias_moves_states(self) -> bool:
        return self.biases and self.evaluator.filtering

    def pack(self, point: Point) -> Array:
        """Scaled variables of a point."""
        parts = [point.lam / self.scales.lam]
        if self.biases:
            parts.append((point.bias / self.scales.bias).ravel())
        return np.concatenate([*parts, (point.nodes / self.scales.state).ravel()])

    def unpack(self, x: Array) -> Point:
        """Point of scaled variables."""
        nf, ny, nx = self.evaluator.nf, self.evaluator.ny, self.evaluator.nx
        bias = x[nf : self.first_node].reshape(-1, ny) if self.biases else None
        return Point(
            lam=x[:nf] * self.scales.lam,
            bias=np.zeros((self.records, ny)) if bias is None else bias * self.scales.bias,
            nodes=x[self.first_node :].reshape(-1, nx) * self.scales.state,
        )

    # ---- values and blocks ----------------------------------------------------------------------

    def values(self, x: Array) -> "Values":
        """Cost, constraints and R at scaled variables."""
        key = x.tobytes()
        if self._seen is None or self._seen[0] != key:
            with np.errstate(over="ignore", invalid="ignore"):
                self._seen = key, self._values(self.unpack(x))
        return self._seen[1]

    def _values(self, point: Point) -> "Values":
        layout = self.evaluator.layout
        try:
            motion = self.evaluator.simulate(point)
        except np.linalg.LinAlgError:  # far out, where a filter's covariance overflows
            motion = self.evaluator.nowhere()
        moments = moments_of(motion.residuals, layout.pattern, len(layout.patterns))
        ends = motion.ends[np.argsort(layout.node)]
        gaps = (ends[self.links] - point.nodes[self.links + 1]) / self.scales.state
        c = self.evaluator.matrices(point.lam).c / self.ties
        g = np.concatenate([gaps.ravel(), c])
        if not np.isfinite(moments).all():
            return Values(np.nan, g, np.eye(self.evaluator.ny), motion)
        gains = self.evaluator.gains(point.lam)
        if gains is None:
            R = self.noise.covariance(moments)
            cost = self.noise.cost(R, moments)
        else:
            R, cost = self.evaluator.matrices(point.lam).R, gains.cost(motion.residuals)
        return Values((cost + self.knowledge.cost(point)) / self.n, g, R, motion)

    def blocks(self, x: Array) -> Blocks:
        """Gauss-Newton blocks at scaled variables."""
        key = x.tobytes()
        if self._blocks is None or self._blocks[0] != key:
            with np.errstate(over="ignore", invalid="ignore"):
                self._blocks = key, self._sum(self.unpack(x), self.values(x))
        return self._blocks[1]

    def balanced(self, point: Point) -> "Programme":
        """The same in units that make the curvature per observation one, at most the present ones.

        What is known at the point goes with it.
        """
        # IPOPT's tolerance is then relative to the noise, whatever the noise is.
        x, s = self.pack(point), self.scales
        blocks = self.blocks(x)
        H = np.diag(blocks.Hll), np.diag(blocks.Hbb.sum(axis=0)), np.diag(blocks.Hnn.sum(axis=0))
        lam, bias, state = (1 / np.sqrt(np.maximum(h / self.n, 1.0)) for h in H)
        other = self.variant(scales=Scales(s.lam * lam, s.bias * bias, s.state * state))
        values, gaps = self.values(x), len(self.links) * len(state)
        g = np.append(values.g[:gaps] / np.tile(state, len(self.links)), values.g[gaps:])
        key = other.pack(point).tobytes()
        other._seen = key, replace(values, g=g)
        other._blocks = key, blocks.scaled(lam, bias, state)
        return other

    def _sum(self, point: Point, values: "Values") -> Blocks:
        e, s = self.evaluator, self.scales
        sweep = e.sweep(point, values.motion, whiteners(values.R, e.layout))
        nf, nx = e.nf, e.nx
        unit = np.concatenate([s.lam, s.state, s.bias, [1.0]])
        sums = summed(sweep)
        per_record, G, slopes = sums.records, sums.nodes, sums.slopes
        self.knowledge.add(per_record, G, point)
        per_record *= unit[:, None] * unit
        G *= s.state[:, None] * unit
        slopes *= unit[:-1] / s.state[:, None]
        l, n, b = slice(0, nf), slice(nf, nf + nx), slice(nf + nx, len(unit) - 1)
        total = per_record.sum(axis=0)
        if sweep.gains is not None:
            gradient, information = sweep.gains.through_covariance(values.motion.residuals)
            total[l, l] += information * np.outer(s.lam, s.lam)
            total[l, -1] += gradient * s.lam
        return Blocks(
            Hll=total[l, l], Hlb=per_record[:, l, b], Hbb=per_record[:, b, b],
            Hln=G[:, :, l].transpose(0, 2, 1), Hbn=G[:, :, b].transpose(0, 2, 1), Hnn=G[:, :, n],
            gl=total[l, -1], gb=per_record[:, b, -1], gn=G[:, :, -1], ends=sums.ends,
            slope_l=slopes[:, :, l], slope_n=slopes[:, :, n], slope_b=slopes[:, :, b],
            c_lam=sweep.matrices.c_lam / self.ties[:, None] * s.lam, sweep=sweep,
        )  # fmt: skip

    def units(self) -> tuple[Array, Array]:
        """Physical size of one of each variable, and of each constraint."""
        s = self.scales
        bias = [np.tile(s.bias, self.records)] if self.biases else []
        x = np.concatenate([s.lam, *bias, np.tile(s.state, self.J)])
        return x, np.concatenate([np.tile(s.state, len(self.links)), self.ties])

    # ---- sparse assembly ------------------------------------------------------------------------

    def _places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions of λ (nf,), biases (records, ny) and nodes (J, nx) among the variables."""
        e = self.evaluator
        bias = e.nf + np.arange(self.biases * self.records * e.ny).reshape(-1, e.ny)
        return np.arange(e.nf), bias, self.first_node + np.arange(self.J * e.nx).reshape(-1, e.nx)

    def hessian_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the entries of a Hessian's upper triangle."""
        l, b, n = self._places()
        grids = [grid(l[None], l[None], upper=True)]
        if self.biases:
            grids += [grid(np.tile(l, (len(b), 1)), b), grid(b, b, upper=True)]
            grids += [grid(b[self.record], n)]
        grids += [grid(np.tile(l, (self.J, 1)), n), grid(n, n, upper=True)]
        return stack(grids)

    def hessian(self, x: Array) -> Array:
        """Nonzeros of the Gauss-Newton Hessian's upper triangle, per observation."""
        blocks = self.blocks(x)
        return (
            self._hessian_pattern.order(
                self.hessian_parts(blocks, blocks.Hll, blocks.Hln, blocks.Hnn)
            )
            / self.n
        )

    def hessian_parts(self, blocks: Blocks, Hll: Array, Hln: Array, Hnn: Array) -> Array:
        """Entries of a Hessian at those places; its blocks of λ and the nodes are given."""
        parts = [upper_triangle(Hll[None])]
        if self.biases:
            parts += [blocks.Hlb.ravel(), upper_triangle(blocks.Hbb), blocks.Hbn.ravel()]
        return np.concatenate([*parts, Hln.ravel(), upper_triangle(Hnn)])

    def gradient(self, x: Array) -> Array:
        """Gradient of the cost, per observation."""
        blocks = self.blocks(x)
        bias = [blocks.gb.ravel()] if self.biases else []
        return np.concatenate([blocks.gl, *bias, blocks.gn.ravel()]) / self.n

    @cached_property
    def ties(self) -> Array:
        """Physical size of one of each of the model's constraints, (m,)."""
        return self.free.constraint_sizes

    @cached_property
    def _hessian_pattern(self) -> Pattern:
        return Pattern(*self.hessian_places(), size=self.size)

    @cached_property
    def jacobian_pattern(self) -> Pattern:
        """Places of the constraints' Jacobian."""
        rows = len(self.links) * self.evaluator.nx + len(self.ties)
        return Pattern(*self._jacobian_entries(), size=self.size, rows=rows)

    def _jacobian_entries(self) -> tuple[np.ndarray, np.ndarray]:
        l, b, n = self._places()
        nx, ties = self.evaluator.nx, len(self.ties)
        links = np.arange(len(self.links) * nx).reshape(-1, nx)
        grids = [
            grid(links, np.tile(l, (len(links), 1))),
            grid(links, n[self.links]),
            (links.ravel(), n[self.links + 1].ravel()),
            grid(links.size + np.arange(ties)[None], l[None]),
        ]
        if self._bias_moves_states:
            grids.append(grid(links, b[self.record[self.links]]))
        return stack(grids)

    def jacobian(self, x: Array) -> Array:
        """Nonzeros of the constraints' Jacobian."""
        blocks = self.blocks(x)
        parts = [
            blocks.slope_l[self.links].ravel(),
            blocks.slope_n[self.links].ravel(),
            -np.ones(len(self.links) * self.evaluator.nx),
            blocks.c_lam.ravel(),
        ]
        if self._bias_moves_states:
            parts.append(blocks.slope_b[self.links].ravel())
        return self.jacobian_pattern.order(np.concatenate(parts))

    def hessian_matrix(self, x: Array) -> scipy.sparse.csc_array:
        """Upper triangle of the Gauss-Newton Hessian of the whole cost."""
        return self._hessian_pattern.matrix(self.hessian(x) * self.n)

    def constraint_matrix(self, x: Array) -> scipy.sparse.csc_array:
        """Jacobian of all constraints."""
        return self.jacobian_pattern.matrix(self.jacobian(x))

    def continuity_matrix(self, x: Array) -> scipy.sparse.csc_array:
        """Jacobian of the continuity constraints."""
        links = len(self.links) * self.evaluator.nx
        return self.constraint_matrix(x)[:links]

    def limits(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Lower and upper bounds of the scaled λ and unknowns of a filter, and of constraints."""
        free, more = self.free, self.evaluator.more
        own = free.lower[free.index], free.upper[free.index]
        others = (np.zeros(0), np.zeros(0)) if more is None else more.bounds()
        lower, upper = (np.concatenate(part) for part in zip(own, others, strict=True))
        bounds = lower / self.scales.lam, upper / self.scales.lam
        sides = free.constraint_limits
        return bounds, (sides[0], sides[1])
