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
from functools import cached_property, partial

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.shooting.sensitivity import Sums, Sweep, gathered
from casid.threads import on_all_cores

STEPS = 16  # samples of an interval whose signals are held at once
BYTES = 1.5e6  # of signals held at once by a thread: they stay in the cache
AT_ONCE = 8  # steps that one product filters
ROUNDING = 1e-11  # by which powers of A_d may miss their sum of M_i, of the largest so far
DEPENDENT = 1e-12  # what is left of a power of A that the others make, relative


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
    longest = int(layout.count.max(initial=0))
    powers = Powers.of(sweep.matrices.A, sweep.steps.uniform()[0], longest)
    shared = None if powers is None else Convolution(sweep, powers)
    return shared if shared is not None and shared.pays else None


@dataclass(frozen=True, eq=False)
class Powers:
    """A_d^m = Σ_i M_i h_i with h = H^m h_0."""

    M: Array  # (d, nx, nx)
    H: Array  # (d, d)
    start: Array  # (d,) h_0

    @classmethod
    def of(cls, A: Array, Ad: Array, steps: int) -> "Powers | None":
        """Of the transition matrix A_d = exp(A h), both (nx, nx); None if rounding is in the way.

        The space is that of the polynomials of A, whose own scale keeps them apart better. What
        rounding does grows with the power, and is seen in those of 1, 2, 4, ... ``steps`` samples.
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
            if np.linalg.norm(new) <= DEPENDENT * size:
                break
            basis = np.vstack([basis, new / np.linalg.norm(new)])
        M = basis.reshape(-1, nx, nx)
        after = ((Ad * scale) @ M).reshape(len(M), -1)
        H = basis @ after.T
        start = np.zeros(len(M))
        start[0] = np.sqrt(nx)
        power, ahead, largest = Ad * scale, H, 1.0
        for _ in range(int(steps).bit_length() + 1):
            missed = np.abs(power.ravel() - basis.T @ (ahead @ start)).max()
            largest = max(largest, np.abs(power).max())
            if not missed <= ROUNDING * largest:
                return None
            power, ahead = power @ power, ahead @ ahead
        return cls(M / scale, H, start)

    def along(self, steps: int) -> Array:
        """h_m of samples 0 to ``steps``, as rows (steps + 1, d)."""
        found, H = self.start[None], self.H
        while len(found) <= steps:
            found, H = np.concatenate([found, found @ H.T]), H @ H
        return found[: steps + 1]

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

    Signals stand in the order: the filtered (d x channels), the direct ones, one, the residuals,
    and those of the node (d).
    """

    def __init__(self, sweep: Sweep, powers: Powers) -> None:
        self.sweep, self.powers = sweep, powers
        e, m = sweep.e, sweep.matrices
        _, drive, jumps = sweep.steps.uniform()
        live = np.flatnonzero(drive.any(axis=(0, 2)))
        direct = np.flatnonzero(sweep.drive.any(axis=(0, 2)))
        d, nx, nf, ny = len(powers.M), e.nx, e.nf, e.ny
        self._parts = sweep.motion.states, sweep.steps.inputs, jumps
        self._live, self._direct = live, direct
        self._drive = drive[:, live].transpose(1, 0, 2).reshape(-1, nf)  # (live nx, nf)
        moved = np.tensordot(powers.M, drive[:, live], axes=1)  # (d, nx, live, nf)
        self._states = moved.transpose(0, 2, 1, 3).reshape(-1, nx, nf)
        self._ahead = np.ascontiguousarray(powers.ahead(AT_ONCE)[:, d:].T)
        self._nodes = powers.along(int(sweep.layout.count.max(initial=0)))
        self.filtered = d * len(live)
        self._one = self.filtered + len(direct)
        self.count = self._one + 1 + ny + d
        rest = np.zeros((self.count - self.filtered, ny, nf + nx + ny + 1))
        rest[: len(direct), :, :nf] = sweep.drive[:, direct].transpose(1, 0, 2)
        rest[len(direct), :, nf + nx : -1] = np.eye(ny)
        rest[len(direct) + 1 : -d, :, -1] = np.eye(ny)
        rest[-d:, :, nf : nf + nx] = m.C @ powers.M
        self._rest = sweep.W[0] @ rest  # what whitened outputs make of the unfiltered signals
        self._seen = self._rest[-d:, :, nf : nf + nx]  # (d, ny, nx) W C M_i

    @property
    def pays(self) -> bool:
        """Whether the Gram matrix of the signals is less work than that of the sensitivities."""
        return bool(self.count**2 < self._rest.shape[1] * self._rest.shape[2] ** 2)

    def sums(self) -> Sums:
        """Blocks of all records and intervals; the same however many threads there are."""
        layout, s = self.sweep.layout, self.count - len(self.powers.M)
        found, whole = Sums.zeros(self.sweep.e), np.zeros((s, s))
        totals = np.zeros((len(layout.records), s))
        portions = self._portions()
        for index, (gram, total, nodes, slopes) in zip(
            portions, on_all_cores(self._portion, portions), strict=True
        ):
            whole += gram
            np.add.at(totals, layout.record[index], total)
            found.nodes[layout.node[index]] = nodes
            found.slopes[layout.node[index]] = slopes
        self._add_records(found.records, whole, totals)
        found.ends[layout.node] = self.sweep.motion.ends
        return found

    def _add_records(self, records: Array, whole: Array, totals: Array) -> None:
        """What the signals' Gram matrix (s, s) and totals (records, s) add to `Sums.records`."""
        e, f, d = self.sweep.e, self.filtered, len(self.powers.M)
        live, nf, nc = f // d, e.nf, self._rest.shape[2]
        own, rest = records[0], self._rest[:-d]
        seen = whole[f:, f:] @ rest.reshape(-1, e.ny * nc)
        own += rest.reshape(-1, nc).T @ seen.reshape(-1, nc)
        pairs = whole[:f, :f].reshape(d, live, d, live).transpose(1, 3, 2, 0).reshape(-1, d * d)
        both = (pairs @ self._twice).reshape(live, live, e.nx, e.nx).swapaxes(1, 2)
        own[:nf, :nf] += self._drive.T @ both.reshape(live * e.nx, -1) @ self._drive
        mixed = self._drive.T @ self._heard(whole[f:, :f].reshape(-1, d, live), rest)
        own[:nf] += mixed
        own[:, :nf] += mixed.T
        # A bias moves each output by the signal that is one: each record's is that row of its own.
        b, one = slice(-1 - e.ny, -1), rest[self._one - f]
        moved = np.tensordot(totals[:, f:], rest, axes=1)
        driven = totals[:, :f].reshape(-1, d, live).swapaxes(1, 2) @ self._seen.reshape(d, -1)
        driven = driven.reshape(-1, live, e.ny, e.nx).swapaxes(1, 2)
        moved[:, :, :nf] += driven.reshape(*moved.shape[:2], -1) @ self._drive
        rows = one[:, b].T @ moved
        records[:, b], records[:, :, b] = rows, rows.transpose(0, 2, 1)

    def moments(self, weight: Array, last: Array) -> tuple[Array, Array]:
        """Σ_k weight_k ⊗ S_k over all samples (N, nv) and the ends, whose weights are the first nx.

        By the parameters over all intervals (nv, nx, nf), by its node for each (J, nv, nx, nx); the
        weights of the ends ``last`` (J, nx) and the nodes stand in the order of the layout.
        """
        d, nv = len(self.powers.M), weight.shape[1]
        driven, at_nodes = np.zeros((self.filtered, nv)), np.zeros((len(last), nv, d))
        portions = self._portions()
        moments = on_all_cores(partial(self._moments, weight=weight, last=last), portions)
        for index, (total, own) in zip(portions, moments, strict=True):
            driven += total
            at_nodes[index] = own
        total = np.tensordot(driven.T, self._states, axes=1)
        return total, np.tensordot(at_nodes, self.powers.M, axes=1)

    def _portions(self) -> list[np.ndarray]:
        """Rows of the layout, the longest intervals first."""
        size = max(1, int(BYTES / (8 * self.count * (STEPS + 1))))
        count = len(self.sweep.layout.count)
        return np.array_split(np.arange(count), -(-count // size))

    def _portion(self, index: np.ndarray) -> tuple[Array, Array, Array, Array]:
        """Gram matrix and totals of signals, the node's rows and the slopes of the ends."""
        count, d = self.sweep.layout.count[index], len(self.powers.M)
        s = self.count - d
        gram, cross = np.zeros((s, s)), np.zeros((self.count, d + 1, len(index)))
        ends = np.empty((len(index), self.count))
        for first, Z in self._signals(index):
            K, n = Z.shape[1] - 1, Z.shape[2]
            ending = np.flatnonzero(count[:n] <= first + K)
            ends[ending] = Z[:, count[ending] - first, ending].T
            if len(ending):
                Z[:, :K] *= first + np.arange(K)[:, None] < count[:n]
            rows = Z.reshape(self.count, -1)[:s, : K * n]
            gram += rows @ rows.T
            along = np.vstack([self._nodes[first : first + K].T, np.ones((1, K))])
            cross[:, :, :n] += along @ Z[:, :K]
        return gram, cross[:s, d].T, self._of_nodes(cross[:, :d]), self._of_ends(ends)

    def _moments(self, index: np.ndarray, weight: Array, last: Array) -> tuple[Array, Array]:
        """Of a portion, by the filtered signals (filtered, nv) and by the powers (n, nv, d)."""
        layout, d, nv = self.sweep.layout, len(self.powers.M), weight.shape[1]
        count, start = layout.count[index], layout.start[index]
        total, own = np.zeros((self.filtered, nv)), np.zeros((len(index), nv, d))
        for first, Z in self._signals(index):
            K, n = Z.shape[1] - 1, Z.shape[2]
            at, left = np.arange(K)[:, None], count[:n] - first
            V = np.zeros((K + 1, n, nv))
            V[:-1] = weight[start[:n] + np.minimum(first + at, count[:n] - 1)]
            V[:-1] *= (at < left)[:, :, None]
            ending = np.flatnonzero(left <= K)
            V[left[ending], ending, : last.shape[1]] += last[index[ending]]
            total += Z[: self.filtered].reshape(self.filtered, -1) @ V.reshape(-1, nv)
            own[:n] += V.transpose(1, 2, 0) @ self._nodes[first : first + K + 1]
        return total, own

    def _signals(self, index: np.ndarray) -> Iterator[tuple[int, Array]]:
        """First sample and signals (signals, K + 1, n) of the n intervals of K samples there.

        With those after the last; past the end of an interval they mean nothing.
        """
        count, start = self.sweep.layout.count[index], self.sweep.layout.start[index]
        f, d = self.filtered, len(self.powers.M)
        live = f // d
        y: Array = np.zeros((d, live, len(index)))
        for first in range(0, int(count[0]), STEPS):
            n, K = int((count > first).sum()), min(STEPS, int(count[0]) - first)
            at = start[:n] + np.minimum(first + np.arange(K)[:, None], count[:n] - 1)
            every = np.concatenate([part[at] for part in self._parts], axis=2).transpose(2, 0, 1)
            Z = np.empty((self.count, K + 1, n))
            Z[f : self._one, :-1], Z[self._one], Z[f:-d, -1] = every[self._direct], 1.0, 0.0
            Z[self._one + 1 : -d, :-1] = self.sweep.motion.residuals[at].transpose(2, 0, 1)
            Z[-d:] = self._nodes[first : first + K + 1].T[:, :, None]
            y = self._filter(every[self._live], y[:, :, :n], Z[:f].reshape(d, live, K + 1, n))
            yield first, Z

    def _filter(self, V: Array, y: Array, into: Array) -> Array:
        """Write what filtering V (channels, K, n) makes of y (d, channels, n) into (.., K + 1, n).

        Returns the last of it.
        """
        (live, K, n), d = V.shape, len(y)
        into[:, :, 0] = y
        for k in range(0, K, AT_ONCE):
            some = V[:, k : k + AT_ONCE].transpose(1, 0, 2)
            both = np.concatenate([y, some]).reshape(-1, live * n)
            made = self._ahead[: d * len(some), : len(both)] @ both
            into[:, :, k + 1 : k + len(some) + 1] = made.reshape(-1, d, live, n).transpose(
                1, 2, 0, 3
            )
            y = made.reshape(-1, d, live, n)[-1]
        return y

    @cached_property
    def _twice(self) -> Array:
        """(W C M_i)ᵀ W C M_j, rows (j, i) and columns by state of the first and of the second."""
        e, d = self.sweep.e, len(self.powers.M)
        flat = self._seen.swapaxes(1, 2).reshape(d * e.nx, -1)
        both: Array = (flat @ flat.T).reshape(d, e.nx, d, e.nx)
        return both.transpose(2, 0, 1, 3).reshape(d * d, -1)

    def _heard(self, cross: Array, rest: Array) -> Array:
        """Rows (n nx, nc): Σ (W C M_i)ᵀ of unfiltered signals, from Σ of these and h (p, d, n)."""
        (_, d, n), (p, ny, nc) = cross.shape, rest.shape
        through = cross.transpose(2, 0, 1).reshape(-1, d) @ self._seen.reshape(d, -1)
        through = through.reshape(n, p, ny, -1).transpose(0, 3, 1, 2)
        return np.asarray(through.reshape(-1, p * ny) @ rest.reshape(-1, nc))

    def _of_nodes(self, cross: Array) -> Array:
        """Rows (n, nx, nc) of the nodes from Σ z hᵀ (signals, d, n)."""
        e, (_, d, n) = self.sweep.e, cross.shape
        rows = self._heard(cross[self.filtered :], self._rest).reshape(n, e.nx, -1)
        # What parameters drive is felt as what nodes are: W C M_i, for each of the signals' i.
        driven = cross[: self.filtered].reshape(d, -1, d, n).transpose(3, 1, 0, 2)
        driven = (driven.reshape(-1, d * d) @ self._twice).reshape(n, -1, e.nx, e.nx).swapaxes(1, 2)
        rows[:, :, : e.nf] += driven.reshape(n, e.nx, -1) @ self._drive
        return rows

    def _of_ends(self, ends: Array) -> Array:
        """Derivatives (n, nx, nf + nx + ny) of the end states from the signals there."""
        e, d = self.sweep.e, len(self.powers.M)
        slopes = np.zeros((len(ends), e.nx, e.nf + e.nx + e.ny))
        driven = ends[:, : self.filtered] @ self._states.reshape(self.filtered, -1)
        slopes[:, :, : e.nf] = driven.reshape(-1, e.nx, e.nf)
        slopes[:, :, e.nf : e.nf + e.nx] = np.tensordot(ends[:, -d:], self.powers.M, axes=1)
        return slopes
