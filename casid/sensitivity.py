"""Residuals of a linear model over all shooting intervals, and what Gauss-Newton needs of them.

Over one interval, from the node x_0 and with the delayed inputs u,

    x_{k+1} = A_d x_k + B0 u_k + B1 u_{k+1}        r_k = W (C x_k + D u_k + b - y_k),   WᵀW = R⁻¹

and the columns of S_k = ∂x_k/∂(λ, x_0) obey the same recursion, driven by the derivatives of the
maps. All intervals advance together, one dense product a step; the Gram matrix [J r]ᵀ[J r] of each
interval holds gradient and Gauss-Newton Hessian at once. Memory is bounded by working on batches
of intervals.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.integrate import StepMap, step_map
from casid.intervals import Layout
from casid.model import Free
from casid.spline import DelayedInput

BATCH_BYTES = 3e7  # of Jacobian rows held at once


@dataclass(frozen=True, eq=False)
class Numbers:
    """Model matrices and their derivatives by the free parameters (last axis, nf)."""

    A: Array
    B: Array
    C: Array
    D: Array
    tau: Array
    c: Array
    A_lam: Array
    B_lam: Array
    C_lam: Array
    D_lam: Array
    tau_lam: Array
    c_lam: Array


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
    """What one batch of intervals has to say; ``index`` are rows of the layout.

    Parameters
    ----------
    rows : (n, M, ny, nf + nx + ny + 1) array
        Whitened Jacobian by λ, node and bias, and the residual; zero past an interval's end.
    ends : (n, nx) array
        State one step after the last sample.
    slopes : (n, nx, nf + nx) array
        Its derivative by λ and node.
    """

    index: np.ndarray
    rows: Array
    ends: Array
    slopes: Array


class Structure:
    """The matrices of a model as functions of its free parameters."""

    def __init__(self, free: Free) -> None:
        lam = ca.SX.sym("lam", len(free.index))
        dense = [ca.densify(m) for m in free.model.matrices()(free.full(lam))]
        slopes = [ca.densify(ca.jacobian(ca.vec(m), lam)) for m in dense]
        self._function = ca.Function("structure", [lam], [*dense, *slopes])

    def __call__(self, lam: Array) -> Numbers:
        """Matrices and derivatives at the free values (nf,)."""
        found = [m.full() for m in self._function(lam)]
        values, slopes = found[:6], found[6:]
        shaped = [
            slope.reshape((*value.shape, len(lam)), order="F")
            for value, slope in zip(values, slopes, strict=True)
        ]
        values[4], values[5] = values[4].ravel(), values[5].ravel()
        shaped[4], shaped[5] = shaped[4][:, 0], shaped[5][:, 0]
        return Numbers(*values, *shaped)


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
    """Residuals and Gauss-Newton blocks of one model over one layout."""

    def __init__(self, free: Free, layout: Layout) -> None:
        self.layout = layout
        self.structure = Structure(free)
        model = free.model
        self.nx, self.nu, self.ny = len(model.states), len(model.inputs), len(model.outputs)
        self.nf = len(free.index)
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
        maps = [step_map(numbers.A, numbers.B, h, hold) for h, hold in layout.classes]
        u, _ = self.delayed(numbers.tau)
        r = np.empty_like(layout.y)
        ends = np.empty((len(layout.count), self.nx))
        x = point.nodes[layout.node]
        bias = point.bias[layout.record]
        for k in range(int(layout.count[0])):
            n = int(np.searchsorted(-layout.count, -k))  # intervals with more than k samples
            x, at = x[:n], layout.start[:n] + k
            after = np.minimum(at + 1, len(u) - 1)
            r[at] = x @ numbers.C.T + u[at] @ numbers.D.T + bias[:n] - layout.y[at]
            x = self._advance(maps, layout.step[at], x, u[at], u[after])
            done = layout.count[:n] == k + 1
            ends[:n][done] = x[done]
        return np.where(layout.patterns[layout.pattern], r, 0.0), ends

    def batches(self, point: Point, W: Array) -> Iterator[Batch]:
        """Jacobian rows of all intervals, a bounded number at a time."""
        layout, numbers = self.layout, self.structure(point.lam)
        maps = [
            step_map(numbers.A, numbers.B, h, hold, numbers.A_lam, numbers.B_lam)
            for h, hold in layout.classes
        ]
        drives = [_state_drive(m, numbers.tau_lam) for m in maps]
        inputs = self.delayed(numbers.tau)
        columns = self.nf + self.nx + self.ny + 1
        size = max(1, int(BATCH_BYTES / (8 * layout.count[0] * self.ny * columns)))
        for first in range(0, len(layout.count), size):
            index = np.arange(first, min(first + size, len(layout.count)))
            yield self._batch(index, point, numbers, W, maps, drives, inputs)

    def _batch(
        self,
        index: np.ndarray,
        point: Point,
        numbers: Numbers,
        W: Array,
        maps: list[StepMap],
        drives: list[Array],
        inputs: tuple[Array, Array],
    ) -> Batch:
        layout, nf, nx, ny = self.layout, self.nf, self.nx, self.ny
        (u, du), ns = inputs, nf + nx
        start, count = layout.start[index], layout.count[index]
        x, bias = point.nodes[layout.node[index]], point.bias[layout.record[index]]
        WC, W0 = W[0] @ numbers.C, W[0]
        drive = _output_drive(numbers, W0)
        S: Array = np.zeros((nx, len(index), ns))
        S[:, :, nf:] = np.eye(nx)[:, None, :]
        rows = np.zeros((len(index), int(count[0]), ny, ns + ny + 1))
        ends, slopes = np.empty((len(index), nx)), np.empty((len(index), nx, ns))
        for k in range(int(count[0])):
            n = int(np.searchsorted(-count, -k))
            x, S, at = x[:n], S[:, :n], start[:n] + k
            after = np.minimum(at + 1, len(u) - 1)
            out = np.empty((ny, n, ns + ny + 1))
            out[:, :, :ns] = (WC @ S.reshape(nx, -1)).reshape(ny, n, ns)
            out[:, :, :nf] += np.hstack([x, u[at], du[at]]) @ drive
            out[:, :, ns:-1] = W0[:, None, :]
            raw = x @ numbers.C.T + u[at] @ numbers.D.T + bias[:n] - layout.y[at]
            out[:, :, -1] = W0 @ raw.T
            _blank_missing(out, layout.pattern[at], W)
            rows[:n, k] = out.transpose(1, 0, 2)
            V = np.hstack([x, u[at], u[after], du[at], du[after]])
            S = self._push(maps, drives, layout.step[at], S, V)
            x = self._advance(maps, layout.step[at], x, u[at], u[after])
            done = count[:n] == k + 1
            ends[:n][done], slopes[:n][done] = x[done], S[:, done].transpose(1, 0, 2)
        return Batch(index, rows, ends, slopes)

    def _advance(
        self, maps: list[StepMap], step: np.ndarray, x: Array, u: Array, u1: Array
    ) -> Array:
        """States one step on; ``step`` names the map of each row."""
        new = np.empty_like(x)
        for i in np.unique(step):
            mine = slice(None) if (step == i).all() else np.flatnonzero(step == i)
            m = maps[i]
            new[mine] = x[mine] @ m.Ad.T + u[mine] @ m.B0.T + u1[mine] @ m.B1.T
        return new

    def _push(
        self, maps: list[StepMap], drives: list[Array], step: np.ndarray, S: Array, V: Array
    ) -> Array:
        """Sensitivities (nx, n, ns) one step on."""
        new = np.empty_like(S)
        nx, _, ns = S.shape
        for i in np.unique(step):
            mine = slice(None) if (step == i).all() else np.flatnonzero(step == i)
            part = (maps[i].Ad @ S[:, mine].reshape(nx, -1)).reshape(nx, -1, ns)
            part[:, :, : self.nf] += V[mine] @ drives[i]
            new[:, mine] = part
        return new


def _longest(free: Free) -> float:
    """Longest delay the bounds allow [s], at most that of the guess where they are infinite."""
    delays = free.model.matrices()
    guess = free.model.vector()
    corners = [np.where(np.isfinite(side), side, guess) for side in (free.lower, free.upper)]
    return float(max(np.max(delays(lam)[4].full(), initial=0.0) for lam in (guess, *corners)))


def _state_drive(m: StepMap, tau_lam: Array) -> Array:
    """What drives ∂x/∂λ: (nx, nx + 4 nu, nf), against (x, u_k, u_k+1, u'_k, u'_k+1)."""
    delay = [B[:, :, None] * tau_lam for B in (m.B0, m.B1)]
    return np.ascontiguousarray(np.concatenate([m.Ad_lam, m.B0_lam, m.B1_lam, *delay], axis=1))


def _output_drive(numbers: Numbers, W: Array) -> Array:
    """What enters ∂y/∂λ directly: (ny, nx + 2 nu, nf), against (x, u_k, u'_k), whitened."""
    parts = [numbers.C_lam, numbers.D_lam, numbers.D[:, :, None] * numbers.tau_lam]
    drive = np.concatenate(parts, axis=1)
    return np.ascontiguousarray(np.tensordot(W, drive, axes=1))


def _blank_missing(out: Array, pattern: np.ndarray, W: Array) -> None:
    """Turn rows whitened as complete samples into those of samples with missing channels."""
    for p in np.unique(pattern):
        if p > 0:
            mine = np.flatnonzero(pattern == p)
            change = W[p] @ np.linalg.inv(W[0])
            out[:, mine] = np.tensordot(change, out[:, mine], axes=1)
