"""Residuals of a linear model over all shooting intervals, and what Gauss-Newton needs of them.

Over one interval, from the node x_0 and with the delayed inputs u (`casid.intersample`),

    r_k = C x_k + D u(t_k - τ) + b - y_k          x_{k+1} = A_d x_k + f_k - K_d r_k

with K_d = 0 for output error (a filter: K_d = ∫ e^{As} ds K over the step, or the Kalman gain of
`casid.shooting.kalman`; missing channels left out). The columns of ∂x_k/∂(λ, x_0, b) obey the same
recursion, driven by the derivatives of the maps. All intervals advance together, one dense product
a step; the Gram matrix [J r]ᵀ R⁻¹ [J r] of each interval holds gradient and Gauss-Newton Hessian at
once. It is summed up over blocks of samples, so memory does not grow with the length of an
interval.
"""

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from casid.arrays import Array, BoolArray
from casid.free import Free
from casid.intersample import DelayedInput, integrals
from casid.shooting.delayed_inputs import Delayed
from casid.shooting.gains import Gains
from casid.shooting.intervals import Layout, lay_out
from casid.shooting.kalman import filter_gains
from casid.shooting.stepping import Steps, propagated
from casid.shooting.unknowns import FilterFunction, FilterMatrices, GainUnknowns, NoiseUnknowns

BLOCK = 16  # samples of every interval whose Jacobian rows are held at once
BATCH_BYTES = 8e6  # of Jacobian rows held at once: they stay in the cache
PIECE_BYTES = 64e6  # of a record's total derivatives held at once


@dataclass(frozen=True, eq=False)
class Point:
    """Where residuals are evaluated."""

    lam: Array  # (nf,) free parameters
    bias: Array  # (records, ny) output biases
    nodes: Array  # (J, nx) state at the start of every interval, in chronological order


@dataclass(frozen=True, eq=False)
class Motion:
    """What a simulation of all intervals gives."""

    states: Array  # (N, nx) at every sample
    residuals: Array  # (N, ny) C x + D u + b - y, 0 where a channel is missing
    ends: Array  # (J, nx) one step after each interval's last sample, in the layout's order


@dataclass(frozen=True, eq=False)
class Batch:
    """Gram matrices and end states of some intervals; ``index`` are rows of the layout."""

    index: np.ndarray
    gram: Array  # (n, nc, nc) [J r]ᵀ R⁻¹ [J r]; columns: λ, the node, the biases, the residual
    ends: Array  # (n, nx) state one step after the last sample
    slopes: Array  # (n, nx, nf + nx + ny) its derivative by λ, node and biases


@dataclass(frozen=True, eq=False)
class Sums:
    """Gauss-Newton blocks; intervals (J) in chronological order, columns as in `Batch`."""

    # (records, nc, nc) sums over each record, the nodes' rows and columns not valid; but for the
    # biases' those of all records may stand in the first
    records: Array
    nodes: Array  # (J, nx, nc) the rows of every interval's node
    ends: Array  # (J, nx)
    slopes: Array  # (J, nx, nf + nx + ny)

    @classmethod
    def zeros(cls, evaluator: "Evaluator") -> "Sums":
        """Before anything is summed."""
        nc = evaluator.nf + evaluator.nx + evaluator.ny + 1
        J, nx = len(evaluator.layout.count), evaluator.nx
        sizes = (len(evaluator.layout.records), nc, nc), (J, nx, nc), (J, nx), (J, nx, nc - 1)
        return cls(*(np.zeros(size) for size in sizes))


def whiteners(R: Array, layout: Layout) -> Array:
    """W of every pattern of measured channels, (n_patterns, ny, ny), with WᵀW = R⁻¹ of those."""
    ny = len(R)
    W = np.zeros((len(layout.patterns), ny, ny))
    for p, seen in enumerate(layout.patterns):
        if seen.any():
            block = np.ix_(seen, seen)
            W[p][block] = np.linalg.inv(np.linalg.cholesky(R[block]))
    return W


class Evaluator:
    """Residuals and Gauss-Newton blocks of one model over one layout.

    ``more`` are the unknowns of a filter: its gain, or the noises it follows from; None is output
    error.
    """

    smoothings: ClassVar[int] = 1  # rounds until the first nodes follow the data

    def __init__(
        self, free: Free, layout: Layout, more: GainUnknowns | NoiseUnknowns | None = None
    ) -> None:
        self.layout, self.more = layout, more
        self.filtering, self.kalman = more is not None, isinstance(more, NoiseUnknowns)
        self.curved = more is None  # whether `casid.shooting.curvature` knows what comes of it
        self.matrices = FilterFunction(free, more)
        model = free.model
        self.nx, self.nu, self.ny = len(model.states), len(model.inputs), len(model.outputs)
        self.nf = self.matrices.nf
        self.constants = [model.states.index(name) for name in model.constant_states]
        self.delayed = Delayed(layout.records, self.direct)
        self._steps: tuple[FilterMatrices, Gains | None, Steps] | None = None
        self._gains: tuple[bytes, bool, Gains] | None = None

    @property
    def direct(self) -> BoolArray:
        """Which inputs (nu,) outputs may feel at once, at whatever parameters and states."""
        return self.matrices.direct

    def within(self, delays: Array | None) -> Self:
        """The same, samples passed as for these delays (nu,) instead of τ; NaN follows τ."""
        other = copy.copy(self)
        other.delayed, other._steps = self.delayed.within(delays), None
        return other

    def unbroken(self) -> Self:
        """The same with one interval a record."""
        other = copy.copy(self)
        other.layout, other._steps = lay_out(self.layout.records, np.inf), None
        return other

    def sweep(self, point: Point, motion: Motion, W: Array) -> "Sweep":
        """What turns a simulation into rows of the Jacobian."""
        return Sweep(self, point, motion, W)

    def resting(self) -> Array:
        """Nodes (J, nx) to start from: rest."""
        return np.zeros((len(self.layout.count), self.nx))

    def level(self) -> tuple[Array, Array]:
        """Inputs (nu,) and outputs (ny,) from which their sizes are counted: zero."""
        return np.zeros(self.nu), np.zeros(self.ny)

    def covered(self, point: Point) -> dict[str, tuple[float, float]]:  # noqa: ARG002
        """Spans over the records of what a nonlinear structure is scheduled by: nothing."""
        return {}

    def lost(self, point: Point) -> str:  # noqa: ARG002
        """Where equations first have no value in a simulation from a point; a linear model: ""."""
        return ""

    def held(self, m: FilterMatrices) -> list[DelayedInput]:
        """Delayed inputs of every record."""
        return self.delayed.at(m).inputs

    def steps(self, m: FilterMatrices, gains: Gains | None) -> Steps:
        """The steps of all intervals; a sweep mostly follows a simulation, which has made them."""
        if self._steps is None or self._steps[0] is not m or self._steps[1] is not gains:
            held = self.delayed.at(m)
            breaks = held.columns(self.layout.records, m.A)
            steps = Steps(m, self.layout, held.inputs, breaks, self.filtering, gains)
            self._steps = m, gains, steps
        return self._steps[2]

    def gains(self, lam: Array, *, slopes: bool = False) -> Gains | None:
        """Kalman gains at the unknowns (nf,); None unless noises are estimated."""
        if not self.kalman:
            return None
        key, kept = lam.tobytes(), self._gains
        if kept is None or kept[0] != key or slopes > kept[1]:
            self._gains = kept = key, slopes, filter_gains(self.matrices(lam), self.layout, slopes)
        return kept[2]

    def held_gain(self, lam: Array) -> Array | None:
        """Gain K (nx, ny) of innovations held over the step; a Kalman filter's is its last."""
        gains, m = self.gains(lam), self.matrices(lam)
        if gains is None:
            return m.K if self.filtering else None
        h = self.layout.classes[self.layout.step[-1:]]
        return np.asarray(np.linalg.solve(integrals(m.A, h)[1, 0], gains.K[gains.which[-1]]))

    def densities(self, lam: Array) -> Array | None:
        """Of the noises that drive the states (nx,), if those are estimated."""
        return self.matrices(lam).Q if self.kalman else None

    def nowhere(self) -> Motion:
        """The motion where nothing can be computed: not numbers."""
        N, J = self.layout.y.shape[0], len(self.layout.count)
        return Motion(
            *(np.full(shape, np.nan) for shape in ((N, self.nx), (N, self.ny), (J, self.nx)))
        )

    def simulate(self, point: Point) -> Motion:
        """States and residuals over all intervals."""
        layout, m = self.layout, self.matrices(point.lam)
        gains = self.gains(point.lam)
        steps = self.steps(m, gains)
        seen = layout.patterns[layout.pattern]
        bias = np.repeat(point.bias, [record.N for record in layout.records], axis=0)
        r = steps.inputs[:, : self.nu] @ m.D.T + bias - layout.y
        forcing, nodes = steps.forcing(), point.nodes[layout.node]
        if not self.filtering and len(layout.classes) == 1:
            Ad = steps.uniform()[0]
            states, ends = propagated(Ad, forcing, nodes, layout.start, layout.count)
            return Motion(states, (r + states @ m.C.T) * seen, ends)
        states, ends = np.empty_like(forcing), np.empty_like(nodes)
        x, active = nodes, counts(layout.count)
        for k, n in enumerate(active):
            at = layout.start[:n] + k
            states[at] = x = x[:n]
            if self.filtering:
                r[at] = (r[at] + x @ m.C.T) * seen[at]
            x = steps.state(at, x, forcing[at], r[at] if self.filtering else None)
            if k + 1 == len(active) or active[k + 1] < n:
                done = layout.count[:n] == k + 1
                ends[:n][done] = x[done]
        return Motion(states, r if self.filtering else (r + states @ m.C.T) * seen, ends)


class Sweep:
    """Passes over batches of intervals that turn states into rows of the Jacobian.

    The states being known, all that drives the sensitivities over a block of samples is one dense
    product; only S⁺ = A_d S + F goes sample by sample. W (kinds, ny, ny) are the whiteners of the
    kinds of samples, ``kind`` (N,) which is which: those of `whiteners` for the patterns, or of a
    Kalman filter.
    """

    def __init__(self, evaluator: Evaluator, point: Point, motion: Motion, W: Array) -> None:
        layout = evaluator.layout
        self.e, self.layout, self.motion = evaluator, layout, motion
        self.matrices = m = evaluator.matrices(point.lam)
        self.gains = gains = evaluator.gains(point.lam, slopes=True)
        self.W, self.kind = (W, layout.pattern) if gains is None else (gains.W, gains.which)
        self.steps = evaluator.steps(m, gains)
        self.ns = evaluator.nf + evaluator.nx + (evaluator.ny if evaluator.filtering else 0)
        late = -m.D[:, :, None] * m.tau_lam
        self.drive = np.concatenate([m.C_lam, m.D_lam, late], axis=1)
        self.apart = not np.any(self.W * (1 - np.eye(evaluator.ny)))  # R diagonal
        self.live = np.flatnonzero(self.drive.any(axis=(1, 2)))

    def batches(self) -> Iterator[Batch]:
        """Gram matrices of all intervals, a bounded number of rows at a time."""
        columns = self.e.nf + self.e.nx + self.e.ny + 1
        for index in self.portions():
            gram = np.zeros((len(index), columns, columns))

            def add(j: int, _: int, rows: Array, gram: Array = gram) -> None:
                flat = rows.reshape(-1, rows.shape[-1])
                gram[j] += flat.T @ flat

            slopes = self.run(index, add)
            yield Batch(index, gram, self.motion.ends[index], slopes)

    def portions(self) -> Iterator[np.ndarray]:
        """Rows of the layout in portions whose Jacobian rows stay in the cache."""
        columns = self.e.nf + self.e.nx + self.e.ny + 1
        size = max(1, int(BATCH_BYTES / (8 * BLOCK * self.e.ny * columns)))
        for first in range(0, len(self.layout.count), size):
            yield np.arange(first, min(first + size, len(self.layout.count)))

    def influence(self, follow: Array) -> Iterator[Iterator[Array]]:
        """Derivatives of every record's whitened residuals in k directions, (N, ny, k) in pieces.

        ``follow`` (J, nf + nx + ny, k) says how λ, node and biases of each of the layout's
        intervals move.
        """
        return (self._totals(record, follow) for record in range(len(self.layout.records)))

    def run(self, index: np.ndarray, take: Callable[[int, int, Array], None]) -> Array:
        """Derivatives (n, nx, nf + nx + ny) of the end states of some intervals, longest first.

        ``take`` is given (position in the batch, first sample, rows) block by block.
        """
        e, count = self.e, self.layout.count[index]
        slopes = np.zeros((len(index), e.nx, e.nf + e.nx + e.ny))
        for first, at, trail in self.trails(index):
            rows = self.rows(at, trail[:-1])
            for j in range(at.shape[1]):
                valid = min(int(count[j]) - first, len(at))
                take(j, first, rows[j, :valid])
                if count[j] - first <= len(at):
                    slopes[j, :, : self.ns] = trail[valid][:, j]
        return slopes

    def trails(self, index: np.ndarray) -> Iterator[tuple[int, np.ndarray, Array]]:
        """Sensitivities of some intervals, longest first, a block of samples at a time.

        (first sample, samples (K, n), sensitivities before each and after the last
        (K + 1, nx, n, ns)); n falls as intervals end, and an interval that ends within a block
        repeats its last sample.
        """
        e, start, count = self.e, self.layout.start[index], self.layout.count[index]
        S: Array = np.zeros((e.nx, len(index), self.ns))
        S[:, :, e.nf : e.nf + e.nx] = np.eye(e.nx)[:, None, :]
        for first in range(0, int(count[0]), BLOCK):
            n = int((count > first).sum())
            length = min(BLOCK, int(count[0]) - first)
            at = start[:n] + np.minimum(first + np.arange(length)[:, None], count[:n] - 1)
            trail = self._block(at, S[:, :n])
            yield first, at, trail
            S = trail[-1]

    def _totals(self, record: int, follow: Array) -> Iterator[Array]:
        start, count = self.layout.start, self.layout.count
        mine = np.flatnonzero(self.layout.record == record)
        mine = mine[np.argsort(start[mine])]
        rows = PIECE_BYTES / (8 * self.e.ny * self.e.nf)
        size = max(1, int(rows / count[mine].max()))
        for k in range(0, len(mine), size):
            index = np.sort(mine[k : k + size])  # rows of the layout: the longest first
            yield self._total(index, follow[index])

    def _total(self, index: np.ndarray, moves: Array) -> Array:
        """Derivatives (n, ny, k) of the whitened residuals of adjacent intervals."""
        start, count = self.layout.start[index], self.layout.count[index]
        place = start - start.min()
        slope = np.empty((int(count.sum()), self.e.ny, moves.shape[2]))

        def keep(j: int, k: int, rows: Array) -> None:
            flat = rows.reshape(-1, rows.shape[2])[:, :-1] @ moves[j]
            slope[place[j] + k : place[j] + k + len(rows)] = flat.reshape(len(rows), self.e.ny, -1)

        self.run(index, keep)
        return slope

    def _block(self, at: np.ndarray, S: Array) -> Array:
        """Sensitivities before each of K samples and after the last, (K + 1, nx, n, ns)."""
        K, n = at.shape
        flat, nf = at.ravel(), self.e.nf
        x, r = self.motion.states[flat], self.motion.residuals[flat]
        force = self.steps.force(flat, x, r).reshape(self.e.nx, K, n, nf)
        trail = np.empty((K + 1, *S.shape))
        trail[0] = S
        for k in range(K):
            heard = self._heard(at[k], trail[k]) if self.e.filtering else None
            trail[k + 1] = self.steps.carry(at[k], trail[k], heard)
            trail[k + 1][:, :, :nf] += force[:, k]
        return trail

    def _heard(self, at: np.ndarray, S: Array) -> Array:
        """Derivatives of the measured residuals of one sample, 0 where missing, (ny, n, ns)."""
        heard = (self.matrices.C @ S.reshape(len(S), -1)).reshape(-1, *S.shape[1:])
        self._add_direct(heard, at)
        seen = self.layout.patterns[self.layout.pattern[at]]
        return np.asarray(heard * seen.T[:, :, None])

    def _add_direct(self, out: Array, at: np.ndarray) -> None:
        """Add the derivatives of the outputs not through the states to ``out`` (ny, *at, ns)."""
        nf, nx = self.e.nf, self.e.nx
        V = np.concatenate([self.motion.states[at], self.steps.inputs[at]], axis=-1)
        for a in self.live:
            out[a, ..., :nf] += V @ self.drive[a]
        if self.e.filtering:
            eye = np.eye(self.e.ny).reshape(self.e.ny, *[1] * at.ndim, self.e.ny)
            out[..., nf + nx :] += eye

    def rows(self, at: np.ndarray, S: Array) -> Array:
        """Whitened Jacobian rows and residuals of K samples, (n, K, ny, nc)."""
        e, ns, (K, n) = self.e, self.ns, at.shape
        through = (self.matrices.C @ S.reshape(K, e.nx, -1)).reshape(K, e.ny, n, ns)
        self._add_direct(through.transpose(1, 0, 2, 3), at)
        out = np.empty((n, K, e.ny, e.nf + e.nx + e.ny + 1))
        out[..., e.nf + e.nx : -1] = np.eye(e.ny)
        out[..., :ns] = through.transpose(2, 0, 1, 3)
        out[..., -1] = self.motion.residuals[at.T]
        return self._whitened(out, at)

    def _whitened(self, out: Array, at: np.ndarray) -> Array:
        """Rows (n, K, ny, nc) of samples (K, n) in units of their standard deviations."""
        kind = self.kind[at.T]
        if self.apart:
            out *= np.diagonal(self.W, axis1=1, axis2=2)[kind][..., None]
            return out
        return np.asarray(self.W[kind] @ out)


def gathered(sweep: Sweep) -> Sums:
    """Gauss-Newton blocks of all intervals by their sensitivities."""
    e, layout = sweep.e, sweep.layout
    found, node = Sums.zeros(e), slice(e.nf, e.nf + e.nx)
    for batch in sweep.batches():
        nodes = layout.node[batch.index]
        np.add.at(found.records, layout.record[batch.index], batch.gram)
        found.nodes[nodes], found.ends[nodes] = batch.gram[:, node], batch.ends
        found.slopes[nodes] = batch.slopes
    return found


def counts(count: np.ndarray) -> list[int]:
    """How many intervals (longest first) have more than k samples, k = 0, 1, ..."""
    k = np.arange(int(count[0]))
    return [int(n) for n in np.searchsorted(-count, -k)]
