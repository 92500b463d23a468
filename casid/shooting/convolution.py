"""Gauss-Newton blocks of output error from signals that all its parameters share.

With one sampling interval the sensitivities of output error are convolutions,

    S_k = Σ_m A_d^m F V_{k-1-m},    A_d^m = Σ_i M_i h_{m,i},    h_m = H^m h_0,

of the same few signals V (states, inputs and their breaks), however many parameters the drive F
has: by the theorem of Cayley and Hamilton the powers of A_d lie in the space of at most nx
matrices M_i, which Arnoldi's method finds (Frobenius-orthonormal, so that nothing cancels which
does not cancel in A_d^m itself). The signals z_v = Σ_m h_m V_{k-1-m,v} are filtered once; the
sensitivities are linear in them, S = Σ M_i F_v z_vi, and their Gram matrix is a congruence of that
of the signals, taken once a record instead of for every output.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.shooting.sensitivity import Sums, Sweep, gathered
from casid.threads import on_all_cores

STEPS = 256  # samples of an interval whose signals are held at once
BYTES = 4e6  # of signals held at once by a thread: they stay in the cache
AT_ONCE = 8  # steps that one product filters
ROUNDING = 1e-12  # by which powers of A_d may miss the space of the M_i, relative


def summed(sweep: Sweep) -> Sums:
    """Gauss-Newton blocks of a sweep, by shared signals where that is possible and less work."""
    shared = convolved(sweep)
    return gathered(sweep) if shared is None else shared.sums()


def convolved(sweep: Sweep) -> "Convolution | None":
    """The shared signals of a sweep; None where there are none, or sensitivities are less work."""
    e, layout = sweep.e, sweep.layout
    alike = type(sweep) is Sweep and len(layout.classes) == 1 and (layout.pattern == 0).all()
    if not alike or e.filtering:
        return None
    powers = Powers.of(sweep.matrices.A, sweep.steps.uniform()[0])
    shared = None if powers is None else Convolution(sweep, powers)
    return shared if shared is not None and shared.pays else None


@dataclass(frozen=True, eq=False)
class Powers:
    """A_d^m = Σ_i M_i h_i with h = H^m h_0."""

    M: Array  # (d, nx, nx)
    H: Array  # (d, d)
    start: Array  # (d,) h_0

    @classmethod
    def of(cls, A: Array, Ad: Array) -> "Powers | None":
        """Of the transition matrix A_d = exp(A h), both (nx, nx); None if rounding is in the way.

        The space is that of the polynomials of A, whose own scale keeps them apart better.
        """
        if not (np.isfinite(A).all() and np.isfinite(Ad).all()):
            return None
        nx = len(A)
        _, (unit, _) = scipy.linalg.matrix_balance(A, permute=False, separate=True)
        scale = unit / unit[:, None]
        basis = np.eye(nx).reshape(1, -1) / np.sqrt(nx)
        while len(basis) < nx:
            new = ((A * scale) @ basis[-1].reshape(nx, nx)).ravel()
            size = np.linalg.norm(new)
            for _ in range(2):  # once more, for what rounding left
                new = new - basis.T @ (basis @ new)
            if np.linalg.norm(new) <= ROUNDING * size:
                break
            basis = np.vstack([basis, new / np.linalg.norm(new)])
        M = basis.reshape(-1, nx, nx)
        after = ((Ad * scale) @ M).reshape(len(M), -1)
        H = basis @ after.T
        if np.abs(after.T - basis.T @ H).max() > ROUNDING * np.abs(after).max():
            return None
        start = np.zeros(len(M))
        start[0] = np.sqrt(nx)
        return cls(M / scale, H, start)

    def ahead(self, steps: int) -> Array:
        """What h_0 at the first sample and what drives it at each make of h at the next, as rows.

        (d + steps, (steps + 1) d): of samples 0 to ``steps``, one after the other.
        """
        d = len(self.H)
        found = np.zeros((d + steps, steps + 1, d))
        found[:d, 0] = np.eye(d)
        for k in range(steps):
            found[:, k + 1] = found[:, k] @ self.H.T
            found[d + k, k + 1] = self.start
        return found.reshape(d + steps, -1)


class Convolution:
    """The signals of a sweep, and what parameters, nodes and outputs make of them.

    Signals stand in the order: those of the node (d), the filtered (channels x d), the direct ones,
    one, the residuals.
    """

    def __init__(self, sweep: Sweep, powers: Powers) -> None:
        self.sweep, self.powers = sweep, powers
        e, m = sweep.e, sweep.matrices
        _, drive, self._jumps = sweep.steps.uniform()
        self._live = np.flatnonzero(drive.any(axis=(0, 2)))
        self._direct = np.flatnonzero(sweep.drive.any(axis=(0, 2)))
        self._W = sweep.W[0]
        d, nx, nf, ny = len(powers.M), e.nx, e.nf, e.ny
        self._drive = drive[:, self._live].transpose(1, 0, 2).reshape(-1, nf)  # (live nx, nf)
        moved = np.tensordot(powers.M, drive[:, self._live], axes=1)  # (d, nx, live, nf)
        self._states = moved.transpose(2, 0, 1, 3).reshape(-1, nx, nf)
        self._ahead = powers.ahead(AT_ONCE)
        self.filtered = d * (1 + len(self._live))
        self.count = self.filtered + len(self._direct) + 1 + ny
        out = np.zeros((self.count, ny, nf + nx + ny + 1))
        out[:d, :, nf : nf + nx] = m.C @ powers.M
        out[d : self.filtered, :, :nf] = m.C @ self._states
        one = self.filtered + len(self._direct)
        out[self.filtered : one, :, :nf] = sweep.drive[:, self._direct].transpose(1, 0, 2)
        out[one, :, nf + nx : -1] = np.eye(ny)
        out[one + 1 :, :, -1] = np.eye(ny)
        self._out = np.ascontiguousarray((self._W @ out).transpose(1, 0, 2))  # (ny, signals, nc)

    @property
    def pays(self) -> bool:
        """Whether the Gram matrix of the signals is less work than that of the sensitivities."""
        return bool(self.count**2 < self._out.shape[0] * self._out.shape[2] ** 2)

    def sums(self) -> Sums:
        """Blocks of all records and intervals; the same however many threads there are."""
        layout, d = self.sweep.layout, len(self.powers.M)
        found = Sums.zeros(self.sweep.e)
        signals = np.zeros((len(layout.records), self.count - d, self.count - d))
        portions = list(self._portions())
        for index, (gram, nodes, slopes) in zip(
            portions, on_all_cores(self._portion, portions), strict=True
        ):
            signals[layout.record[index[0]]] += gram
            found.nodes[layout.node[index]] = nodes
            found.slopes[layout.node[index]] = slopes
        self._add_records(found.records, signals)
        found.ends[layout.node] = self.sweep.motion.ends
        return found

    def _add_records(self, records: Array, signals: Array) -> None:
        """What the Gram matrices of each record's signals (records, s, s) add to `Sums.records`."""
        whole, out = signals.sum(axis=0), self._out[:, len(self.powers.M) :]
        for seen in out:
            records[0] += seen.T @ (whole @ seen)
        # A bias moves each output by the signal that is one: each record's is that row of its own.
        one, b = -1 - len(out), slice(-1 - len(out), -1)
        rows = np.einsum("ob,orc->rbc", out[:, one, b], signals[:, one] @ out)
        records[:, b], records[:, :, b] = rows, rows.transpose(0, 2, 1)

    def moments(self, weight: Array, last: Array) -> tuple[Array, Array]:
        """Σ_k weight_k ⊗ S_k over all samples (N, nv) and the ends, whose weights are the first nx.

        By the parameters over all intervals (nv, nx, nf), by its node for each (J, nv, nx, nx); the
        weights of the ends ``last`` (J, nx) and the nodes stand in the order of the layout.
        """
        d, nv = len(self.powers.M), weight.shape[1]
        driven, at_nodes = np.zeros((nv, self.count)), np.zeros((len(last), nv, d))
        portions = list(self._portions())
        moments = on_all_cores(partial(self._moments, weight=weight, last=last), portions)
        for index, (total, own) in zip(portions, moments, strict=True):
            driven += total
            at_nodes[index] = own
        total = np.tensordot(driven[:, d : self.filtered], self._states, axes=1)
        return total, np.tensordot(at_nodes, self.powers.M, axes=1)

    def _portions(self) -> Iterator[np.ndarray]:
        """Rows of the layout, each portion of one record, the longest first."""
        layout = self.sweep.layout
        for record in range(len(layout.records)):
            mine = np.flatnonzero(layout.record == record)
            held = 8 * self.count * (1 + min(STEPS, int(layout.count[mine[0]])))
            size = max(1, int(BYTES / held))
            yield from (mine[k : k + size] for k in range(0, len(mine), size))

    def _portion(self, index: np.ndarray) -> tuple[Array, Array, Array]:
        """Gram matrix of the signals, the node's rows and the slopes of the ends of intervals."""
        count, d, n = self.sweep.layout.count[index], len(self.powers.M), len(index)
        gram = np.zeros((self.count - d, self.count - d))
        cross = np.zeros((d, n * self.count))
        ends = np.empty((n, self.filtered))
        for first, Z in self._signals(index):
            K, node = len(Z) - 1, Z[:-1, 0, :d].copy()
            for j in np.flatnonzero((count > first) & (count <= first + K)):
                ends[j] = Z[count[j] - first, j, : self.filtered]
            for j in np.flatnonzero(count < first + K):
                Z[max(count[j] - first, 0) : K, j] = 0.0
            rows = Z[:K].reshape(K * n, -1)[:, d:]
            gram += rows.T @ rows
            cross += node.T @ Z[:K].reshape(K, -1)
        return gram, self._of_nodes(cross.reshape(d, n, -1)), self._of_ends(ends)

    def _moments(self, index: np.ndarray, weight: Array, last: Array) -> tuple[Array, Array]:
        """Of a portion, by the signals (nv, signals) and by the powers for each (n, nv, d)."""
        layout, d, nv = self.sweep.layout, len(self.powers.M), weight.shape[1]
        count, start = layout.count[index], layout.start[index]
        total, own = np.zeros((nv, self.count)), np.zeros((len(index), nv, d))
        for first, Z in self._signals(index):
            K, left = len(Z) - 1, count - first
            at = np.arange(K)[:, None]
            V = np.zeros((K + 1, len(index), nv))
            V[:-1] = weight[start + np.minimum(first + at, count - 1)] * (at < left)[:, :, None]
            ending = np.flatnonzero((left > 0) & (left <= K))
            V[left[ending], ending, : last.shape[1]] += last[index[ending]]
            Z[-1, :, self.filtered :] = 0.0
            total += V.reshape(-1, nv).T @ Z.reshape(-1, self.count)
            own += V.transpose(1, 2, 0) @ Z[:, 0, :d]
        return total, own

    def _signals(self, index: np.ndarray) -> Iterator[tuple[int, Array]]:
        """First sample and signals (K + 1, n, signals) of intervals, K samples and the next."""
        count, d = self.sweep.layout.count[index], len(self.powers.M)
        y: Array = np.zeros((len(index), self.filtered // d, d))
        y[:, 0] = self.powers.start
        Z = np.empty((min(STEPS, int(count[0])) + 1, len(index), self.count))
        for first in range(0, int(count[0]), STEPS):
            K = min(STEPS, int(count[0]) - first)
            y = self._filter(index, first, Z[: K + 1], y)
            yield first, Z[: K + 1]

    def _filter(self, index: np.ndarray, first: int, Z: Array, y: Array) -> Array:
        """Write the signals of K samples and of the next into Z (K + 1, n, signals)."""
        sweep, layout, f = self.sweep, self.sweep.layout, self.filtered
        (K, n), start = (len(Z) - 1, len(index)), layout.start[index]
        at = start + np.minimum(first + np.arange(K)[:, None], layout.count[index] - 1)
        both = np.concatenate([sweep.motion.states[at], sweep.steps.inputs[at]], axis=2)
        V = np.concatenate([both, self._jumps[at]], axis=2)[:, :, self._live]
        one = f + len(self._direct)
        Z[:-1, :, f:one] = both[:, :, self._direct]
        Z[:-1, :, one] = 1.0
        Z[:-1, :, one + 1 :] = sweep.motion.residuals[at]
        d = y.shape[-1]
        for k in range(0, K, AT_ONCE):
            some = V[k : k + AT_ONCE].transpose(1, 2, 0)
            both = np.zeros((n, f // d, d + AT_ONCE))
            both[:, :, :d] = y
            both[:, 1:, d : d + some.shape[2]] = some
            made = (both.reshape(-1, d + AT_ONCE) @ self._ahead).reshape(n, f // d, -1, d)
            made = made[:, :, : some.shape[2] + 1].transpose(2, 0, 1, 3)
            Z[k : k + len(made) - 1, :, :f] = made[:-1].reshape(-1, n, f)
            y = made[-1]
        Z[K, :, :f] = y.reshape(n, f)
        return y

    def _of_nodes(self, cross: Array) -> Array:
        """Rows (n, nx, nc) of the nodes from Σ h zᵀ (d, n, signals)."""
        e, (d, n, signals) = self.sweep.e, cross.shape
        of_node = self._out[:, :d, e.nf : e.nf + e.nx]
        plain = np.r_[:d, self.filtered : signals]
        through = np.einsum(
            "cix,is->cxs", of_node, cross[:, :, plain].reshape(d, -1), optimize=True
        )
        rows = np.matmul(through.reshape(e.ny, e.nx * n, -1), self._out[:, plain]).sum(axis=0)
        rows = rows.reshape(e.nx, n, -1).transpose(1, 0, 2).copy()
        # What parameters drive is felt as what nodes are: W C M_i, for each of the signals' i.
        felt = np.einsum("cix,cjz->ijxz", of_node, of_node).reshape(d * d, -1)
        driven = cross[:, :, d : self.filtered].reshape(d, n, -1, d).transpose(1, 2, 0, 3)
        driven = (driven.reshape(-1, d * d) @ felt).reshape(n, -1, e.nx, e.nx).swapaxes(1, 2)
        rows[:, :, : e.nf] += driven.reshape(n, e.nx, -1) @ self._drive
        return np.asarray(rows)

    def _of_ends(self, ends: Array) -> Array:
        """Derivatives (n, nx, nf + nx + ny) of the end states from the signals there."""
        e, d = self.sweep.e, len(self.powers.M)
        slopes = np.zeros((len(ends), e.nx, e.nf + e.nx + e.ny))
        slopes[:, :, : e.nf] = np.tensordot(ends[:, d:], self._states, axes=1)
        slopes[:, :, e.nf : e.nf + e.nx] = np.tensordot(ends[:, :d], self.powers.M, axes=1)
        return slopes
