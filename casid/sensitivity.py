"""Residuals of a linear model over all shooting intervals, and what Gauss-Newton needs of them.

Over one interval, from the node x_0 and with the delayed inputs u,

    r_k = C x_k + D u_k + b - y_k          x_{k+1} = A_d x_k + B0 u_k + B1 u_{k+1} - K_d r_k

with K_d = 0 for output error (process noise: K_d = ∫ e^{As} ds K over the step, missing channels
left out). The columns of ∂x_k/∂(λ, x_0, b) obey the same recursion, driven by the derivatives of
the maps. All intervals advance together, one dense product a step; the Gram matrix
[J r]ᵀ R⁻¹ [J r] of each interval holds gradient and Gauss-Newton Hessian at once. It is summed up
over blocks of samples, so memory does not grow with the length of an interval.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.intervals import Layout
from casid.model import Free
from casid.spline import DelayedInput
from casid.stepping import Steps, groups
from casid.unknowns import Numbers, Structure

BLOCK = 32  # samples of every interval whose Jacobian rows are held at once
BATCH_BYTES = 8e6  # of Jacobian rows held at once: they stay in the cache


@dataclass(frozen=True, eq=False)
class Point:
    """Where residuals are evaluated.

    Parameters
    ----------
    lam : (nf,) array
        Free parameters.
    bias : (records, ny) array
        Output biases.
    nodes : (J, nx) array
        State at the start of every interval, in chronological order.
    """

    lam: Array
    bias: Array
    nodes: Array


@dataclass(frozen=True, eq=False)
class Batch:
    """What a batch of intervals has to say; ``index`` are rows of the layout.

    Parameters
    ----------
    gram : (n, nc, nc) array
        [J r]ᵀ R⁻¹ [J r]; columns are λ (nf), the node (nx), the biases (ny) and the residual.
    ends : (n, nx) array
        State one step after the last sample.
    slopes : (n, nx, nf + nx + ny) array
        Its derivative by λ, node and biases.
    """

    index: np.ndarray
    gram: Array
    ends: Array
    slopes: Array


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

    Parameters
    ----------
    free : Free
        Structure and free parameters.
    layout : Layout
        Records and intervals.
    gain : (nx, ny) array or None
        Innovation gain K [state/s per output]; None is output error.
    gain_free : bool
        Whether K's entries are unknowns, ``gain`` being their start.
    """

    def __init__(
        self, free: Free, layout: Layout, gain: Array | None = None, gain_free: bool = False
    ) -> None:
        self.layout, self.gain = layout, gain
        self.filtering = gain is not None
        self.structure = Structure(free, gain, gain_free)
        model = free.model
        self.nx, self.nu, self.ny = len(model.states), len(model.inputs), len(model.outputs)
        self.nf = len(free.index) + gain_free * self.nx * self.ny
        self._inputs = [DelayedInput(record, _longest(free)) for record in layout.records]

    def delayed(self, tau: Array) -> tuple[Array, Array]:
        """Delayed inputs of all samples (N, nu), and their derivatives by the delay."""
        pairs = [source.at(tau) for source in self._inputs]
        return np.concatenate([u for u, _ in pairs]), np.concatenate([du for _, du in pairs])

    def simulate(self, point: Point) -> tuple[Array, Array]:
        """Residuals C x + D u + b - y (N, ny), 0 where missing, and end states (J, nx).

        End states are in the order of the layout; those of a record's last interval mean nothing.
        """
        layout, numbers = self.layout, self.structure(point.lam)
        u, _ = self.delayed(numbers.tau)
        steps = Steps(numbers, layout.classes, self.filtering, slopes=False)
        CD = _output_map(numbers)
        seen = layout.patterns[layout.pattern]
        r = np.empty_like(layout.y)
        ends = np.empty((len(layout.count), self.nx))
        bias, x = point.bias[layout.record], point.nodes[layout.node]
        for k in range(int(layout.count[0])):
            n = int(np.searchsorted(-layout.count, -k))  # intervals with more than k samples
            at = layout.start[:n] + k
            after = np.minimum(at + 1, len(u) - 1)
            V = np.hstack([x[:n], u[at], u[after]])
            r[at] = (V @ CD.T + bias[:n] - layout.y[at]) * seen[at]
            x = steps.state(layout.step[at], V, r[at])
            done = layout.count[:n] == k + 1
            ends[:n][done] = x[done]
        return r, ends

    def batches(self, point: Point, W: Array) -> Iterator[Batch]:
        """Gram matrices of all intervals, a bounded number of rows at a time."""
        layout, numbers = self.layout, self.structure(point.lam)
        steps = Steps(numbers, layout.classes, self.filtering, slopes=True)
        inputs = self.delayed(numbers.tau)
        columns = self.nf + self.nx + self.ny + 1
        size = max(1, int(BATCH_BYTES / (8 * BLOCK * self.ny * columns)))
        for first in range(0, len(layout.count), size):
            index = np.arange(first, min(first + size, len(layout.count)))
            yield _Sweep(self, numbers, steps, inputs, point, W, index).run()

    def influence(self, point: Point, W: Array, record: int, follow: Array) -> Array:
        """Total derivative by λ of one record's whitened residuals, (N, ny, nf).

        ``follow`` (J, nf + nx + ny, nf) says how λ, node and biases of every interval (rows of the
        layout) move with λ.
        """
        layout, numbers = self.layout, self.structure(point.lam)
        steps = Steps(numbers, layout.classes, self.filtering, slopes=True)
        index = np.flatnonzero(layout.record == record)
        first = layout.start[index].min()
        slope = np.empty((int(layout.count[index].sum()), self.ny, follow.shape[2]))

        def keep(j: int, k: int, rows: Array) -> None:
            at = layout.start[index[j]] - first + k
            slope[at : at + len(rows)] = rows[:, :, :-1] @ follow[index[j]]

        _Sweep(self, numbers, steps, self.delayed(numbers.tau), point, W, index).run(keep)
        return slope


class _Sweep:
    """One pass over a batch of intervals: states, sensitivities and Gram matrices together."""

    def __init__(
        self,
        evaluator: Evaluator,
        numbers: Numbers,
        steps: Steps,
        inputs: tuple[Array, Array],
        point: Point,
        W: Array,
        index: np.ndarray,
    ) -> None:
        layout = evaluator.layout
        self.e, self.numbers, self.steps, self.inputs = evaluator, numbers, steps, inputs
        self.W, self.index = W, index
        self.start, self.count = layout.start[index], layout.count[index]
        self.bias = point.bias[layout.record[index]]
        self.x = point.nodes[layout.node[index]]
        nf, nx, ny, n = evaluator.nf, evaluator.nx, evaluator.ny, len(index)
        self.ns = nf + nx + (ny if evaluator.filtering else 0)
        self.nc = nf + nx + ny + 1
        self.S: Array = np.zeros((nx, n, self.ns))
        self.S[:, :, nf : nf + nx] = np.eye(nx)[:, None, :]
        self.rows = np.empty((n, min(BLOCK, int(self.count[0])), ny, self.nc))
        self.gram = np.zeros((n, self.nc, self.nc))
        self.CD = _output_map(numbers)
        self.drive = np.concatenate([numbers.C_lam, numbers.D_lam], axis=1)
        self.live = np.flatnonzero(self.drive.any(axis=(1, 2)))
        self.delay = numbers.D[:, :, None] * numbers.tau_lam[:, numbers.delaying]

    def run(self, keep: Callable[[int, int, Array], None] | None = None) -> Batch:
        """All samples of the batch; ``keep`` is given (interval, sample, rows) as they come."""
        n, nx, last = len(self.index), self.e.nx, int(self.count[0]) - 1
        ends, slopes = np.empty((n, nx)), np.zeros((n, nx, self.nc - 1))
        for k in range(last + 1):
            active = int(np.searchsorted(-self.count, -k))
            self.x, self.S = self._step(k, active)
            done = self.count[:active] == k + 1
            if done.any():
                ends[:active][done] = self.x[done]
                slopes[:active, :, : self.ns][done] = self.S[:, done].transpose(1, 0, 2)
            if (k + 1) % BLOCK == 0 or k == last:
                self._sum_up(k - k % BLOCK, keep)
        return Batch(self.index, self.gram, ends, slopes)

    def _step(self, k: int, n: int) -> tuple[Array, Array]:
        """Rows of sample k of the first n intervals, then states and sensitivities one step on."""
        layout, (u, du) = self.e.layout, self.inputs
        at = self.start[:n] + k
        after = np.minimum(at + 1, len(u) - 1)
        V = np.hstack([self.x[:n], u[at], u[after]])
        dV = np.hstack([du[at], du[after]])
        seen = layout.patterns[layout.pattern[at]]
        r = (V @ self.CD.T + self.bias[:n] - layout.y[at]) * seen
        out = self._outputs(self.S[:, :n], V, dV, r)
        self._store(out, layout.pattern[at], k % BLOCK)
        heard = None
        if self.e.filtering:
            heard = out[:, :, : self.ns] * seen.T[:, :, None]
        S = self.steps.slope(layout.step[at], self.S[:, :n], V, dV, r, heard)
        return self.steps.state(layout.step[at], V, r), S

    def _outputs(self, S: Array, V: Array, dV: Array, r: Array) -> Array:
        """Derivatives of the outputs by all columns, and the residuals: (ny, n, nc)."""
        nf, nx, ny, ns, nu = self.e.nf, self.e.nx, self.e.ny, self.ns, self.e.nu
        out = np.zeros((ny, S.shape[1], self.nc))
        out[:, :, :ns] = (self.numbers.C @ S.reshape(nx, -1)).reshape(ny, -1, ns)
        for a in self.live:
            out[a, :, :nf] += V[:, : nx + nu] @ self.drive[a]
        if len(self.numbers.delaying):
            out[:, :, self.numbers.delaying] += dV[:, :nu] @ self.delay
        out[:, :, nf + nx : -1] += np.eye(ny)[:, None, :]
        out[:, :, -1] = r.T
        return out

    def _store(self, out: Array, pattern: np.ndarray, place: int) -> None:
        ny, n, nc = out.shape
        for p, mine in groups(pattern, len(self.W)):
            part = (self.W[p] @ out[:, mine].reshape(ny, -1)).reshape(ny, -1, nc)
            self.rows[:n, place][mine] = part.transpose(1, 0, 2)

    def _sum_up(self, first: int, keep: Callable[[int, int, Array], None] | None) -> None:
        """Add the rows held, from sample ``first`` on, to the Gram matrices."""
        for j, count in enumerate(self.count):
            valid = min(int(count) - first, BLOCK)
            if valid <= 0:
                continue
            if keep is None:
                flat = self.rows[j, :valid].reshape(-1, self.nc)
                self.gram[j] += flat.T @ flat
            else:
                keep(j, first, self.rows[j, :valid])


def _output_map(numbers: Numbers) -> Array:
    """(C, D, 0), against (x, u_k, u_k+1)."""
    return np.hstack([numbers.C, numbers.D, np.zeros_like(numbers.D)])


def _longest(free: Free) -> float:
    """Longest delay the bounds allow [s], at most that of the guess where they are infinite."""
    delays = free.model.matrices()
    guess = free.model.vector()
    corners = [np.where(np.isfinite(side), side, guess) for side in (free.lower, free.upper)]
    return float(max(np.max(delays(lam)[4].full(), initial=0.0) for lam in (guess, *corners)))
