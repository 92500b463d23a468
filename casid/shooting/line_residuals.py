"""Residuals on lines, what the ends of records leave there, and what Gauss-Newton needs of both.

What begins and ends, x_0 − x_N of every record, enters linearly and is eliminated (variable
projection: Golub and Pereyra 1973); so is what noise does that was under way before
(`casid.shooting.noise_transients`), which has a variance. Derivatives by λ are products of signals
and of what outputs feel, summed over lines as `casid.shooting.line_products` has it; they are laid
out line by line only where somebody asks.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, ComplexArray
from casid.shooting.line_products import Hermitian, contracted, gram, parted
from casid.shooting.noise_transients import DOUBTED, Outside

PORTION = 100  # lines whose derivatives are held at once, in the processor's cache
RANK = 1e-13  # eigenvalue of the transient's information, to unit diagonal, that counts as zero


@dataclass(frozen=True, eq=False)
class Felt:
    """What outputs of records that are alike feel on their lines, and what their ends leave there.

    Records of one length, weighed alike, under one discrete model.
    """

    weight: Array  # (K, ny) root of the lines' weights
    C: Array
    R: ComplexArray  # (K, nx, nx) resolvent
    end: ComplexArray  # (K,) what one of a state's transient drives
    noise: Outside | None
    drive: Array  # (nx, nz) states that follow, by those before and signals
    slopes: Array  # (nz, p, nf) Ψ of `casid.shooting.line_products`
    direct: NDArray[np.intp]  # outputs that parameters act upon at once

    @cached_property
    def L(self) -> ComplexArray:
        """Weighed outputs by the states that follow and by what acts at once, (K, ny, p)."""
        K, ny = self.weight.shape
        nx = self.C.shape[1]
        L = np.zeros((K, ny, nx + len(self.direct)), dtype=complex)
        L[:, :, :nx] = self.weight[:, :, None] * (self.C @ self.R)
        L[:, self.direct, nx + np.arange(len(self.direct))] = self.weight[:, self.direct]
        return L

    @cached_property
    def H(self) -> Hermitian:
        """Lᴴ L of every line."""
        return Hermitian.squares(self.L.swapaxes(1, 2))

    @cached_property
    def columns(self) -> tuple[Array, Array]:
        """Weighed outputs by the transient d (K, 2, ny, m), and 1/variance (m,) of what is known.

        Of its zeros.
        """
        nx = self.C.shape[1]
        own = self.L[:, :, :nx] * self.end[:, None, None]
        if self.noise is None or not self.noise.output:
            return halves(own), np.zeros(nx)
        at = list(self.noise.output)
        columns = np.zeros((*own.shape[:2], nx + len(at)), dtype=complex)
        columns[:, :, :nx] = own
        columns[:, at, nx + np.arange(len(at))] = self.noise.columns * self.weight[:, at]
        return halves(columns), np.repeat([0.0, 1 / DOUBTED], [nx, len(at)])

    @cached_property
    def root(self) -> Array:
        """Root of the covariance of the transient, (m, m)."""
        return _root(*self.columns)

    @cached_property
    def ends(self) -> Array:
        """Weighed derivative of the model by d, orthonormal columns, (K, 2, ny, m).

        Those of noise from outside are shorter, as far as their variance holds them.
        """
        return np.asarray(self.columns[0] @ self.root)

    @cached_property
    def along_ends(self) -> ComplexArray:
        """The same, complex, (K, ny, m)."""
        return np.asarray(self.ends[:, 0] + 1j * self.ends[:, 1])

    @cached_property
    def met(self) -> Array:
        """What of L is along the ends: endsᴴ L, as `met_by` has it."""
        return met_by(self.along_ends, self.L)

    def left(self, d: Array) -> tuple[ComplexArray, ComplexArray]:
        """States (K, nx, n) and outputs (K, ny, n) of transients (m, n)."""
        nx = self.C.shape[1]
        begun = (self.R.reshape(-1, nx) @ d[:nx]).reshape(len(self.R), nx, -1)
        begun *= self.end[:, None, None]
        out = self.C @ begun
        if self.noise is not None:
            for i, column, size in zip(
                self.noise.output, self.noise.columns.T, d[nx:], strict=True
            ):
                out[:, i] += column[:, None] * size
        return begun, out

    def gram(self, Z: ComplexArray, H: Hermitian | None = None) -> Array:
        """Information (nf, nf) of records of signals Z (K, nz, n) were transients known."""
        flat = self.slopes.reshape(-1, self.slopes.shape[2])
        return np.asarray(flat.T @ gram(Z, self.H if H is None else H) @ flat)

    def along(self, met: Array, Z: Array) -> Array:
        """What of derivatives by λ is along columns (n, m, nf), by what these meet of L.

        With signals Z (2 K, nz, n) of records in halves one after the other.
        """
        (_, nz, n), (_, p, nf) = Z.shape, self.slopes.shape
        both = (met.T @ Z.reshape(len(Z), -1)).reshape(-1, p, nz, n).transpose(3, 0, 2, 1)
        return np.asarray(both.reshape(n, -1, nz * p) @ self.slopes.reshape(-1, nf))


@dataclass(frozen=True, eq=False)
class OnLines(ABC):
    """Residuals of one record on lines and their derivatives, all that is its own eliminated."""

    E: ComplexArray  # (K, ny) measured less the model, 0 where not measured
    g: Array  # (nf,) gradient of the cost

    @property
    @abstractmethod
    def F(self) -> Array:
        """Information (nf, nf)."""

    @property
    @abstractmethod
    def ends(self) -> Array:
        """Weighed derivative of the model by what is eliminated, (K, 2, ny, m), orthonormal."""

    @abstractmethod
    def portions(self, by: Array) -> Iterator[tuple[slice, Array]]:
        """Weighed derivatives of the model by λ, the rest following, times a matrix (nf, c).

        Halves one after the other, (k, 2 ny, c), a portion of the lines after the other.
        """

    @classmethod
    @abstractmethod
    def leverages(cls, residuals: Sequence[Self], root: Array) -> list[Array]:
        """What parameters take of every line's freedom, (K, ny) of every record.

        By a root (nf, nf) of their covariance.
        """

    @classmethod
    @abstractmethod
    def scatter(cls, residuals: Sequence[Self], across: Sequence[ComplexArray]) -> Array:
        """Covariance (nf, nf) of the gradient of the cost of weighed residuals that are correlated.

        By the correlations (K, ny, ny), Hermitian, of every record's outputs.
        """

    def moved(self, by: Array) -> Array:
        """`portions`, of all lines: (K, 2 ny, c)."""
        return np.concatenate([rows for _, rows in self.portions(by)])

    def shares(self, by: Array, sizes: Array) -> Array:
        """Σ of squares of these by outputs, times ``sizes`` (K, n, ny) of them: (K, n, c)."""
        twice = np.concatenate([sizes, sizes], axis=2)
        found = np.empty((*sizes.shape[:2], by.shape[1]))
        for at, rows in self.portions(by):
            found[at] = twice[at] @ rows**2
        return found


@dataclass(frozen=True, eq=False)
class Residual(OnLines):
    """Weighed residuals of one record's lines and their normal equations, transient eliminated.

    The transient d (m,), x_0 − x_N and noise from outside, minimises the sum of squares.
    """

    felt: Felt
    Z: ComplexArray  # (K, nz) states and signals
    follow: Array  # (m, nf) what of the derivatives by d, orthonormal, is in those by λ
    cost: float  # half the weighed sum of squares

    @cached_property
    def F(self) -> Array:
        """See `OnLines`."""
        known = self.felt.gram(self.Z[:, :, None])
        return np.asarray(known - self.follow.T @ self.follow)

    def portions(self, by: Array) -> Iterator[tuple[slice, Array]]:
        """See `OnLines`."""
        (nz, p, nf), c, K = self.felt.slopes.shape, by.shape[1], len(self.Z)
        slopes = (self.felt.slopes.reshape(-1, nf) @ by).reshape(nz, p * c)
        follow, ends = self.follow @ by, self.ends.reshape(K, -1, len(self.follow))
        for k in range(0, K, PORTION):
            at = slice(k, k + PORTION)
            signals = (halves(self.Z[at]).reshape(-1, nz) @ slopes).reshape(-1, 2 * p, c)
            rows = as_real(self.felt.L[at]) @ signals
            rows -= ends[at] @ follow
            yield at, rows

    @classmethod
    def leverages(cls, residuals: Sequence[Self], root: Array) -> list[Array]:
        """See `OnLines`."""
        inverse, along = root @ root.T, {}
        for each in residuals:
            if id(each.felt) not in along:
                slopes = each.felt.slopes.reshape(-1, len(root)) @ root
                along[id(each.felt)] = parted(slopes @ slopes.T, len(each.felt.slopes))
        return [each._taken(inverse, along[id(each.felt)]) for each in residuals]

    def _taken(self, inverse: Array, C: tuple[Array, Array]) -> Array:
        """What parameters of a covariance (nf, nf) take of every line's freedom, (K, ny).

        C = Ψ inverse Ψᵀ, `parted`.
        """
        nz, p, nf = self.felt.slopes.shape
        beside = self.felt.slopes.reshape(-1, nf) @ (2 * inverse @ self.follow.T)
        beside, within = beside.reshape(nz, -1), self.follow @ inverse @ self.follow.T
        out = np.empty(self.E.shape)
        for k in range(0, len(self.Z), 4 * PORTION):
            at = slice(k, k + 4 * PORTION)
            L, Z, ends = self.felt.L[at], np.ascontiguousarray(self.Z[at]), self.felt.along_ends[at]
            own, met = L @ contracted(Z, C), np.empty((len(L), beside.shape[1]), dtype=complex)
            met.real, met.imag = Z.real @ beside, Z.imag @ beside
            mixed = L @ met.reshape(len(L), p, -1) - ends @ within
            out[at] = _products(own, L) - _products(mixed, ends)
        return out

    @property
    def ends(self) -> Array:
        """See `OnLines`; as `Felt` has it."""
        return self.felt.ends

    @classmethod
    def scatter(cls, residuals: Sequence[Self], across: Sequence[ComplexArray]) -> Array:
        """See `OnLines`."""
        alike: dict[tuple[int, int], list[Self]] = {}
        for each, S in zip(residuals, across, strict=True):
            alike.setdefault((id(each.felt), id(S)), []).append(each)
        by_id, total = {id(S): S for S in across}, np.zeros((residuals[0].follow.shape[1],) * 2)
        for (_, key), mine in alike.items():
            felt, S = mine[0].felt, by_id[key]
            ends = felt.along_ends
            through, out = S @ felt.L, S @ ends
            total += felt.gram(_signals(mine), Hermitian.of(felt.L.conj().swapaxes(1, 2) @ through))
            within = np.einsum("kim,kin->mn", ends.conj(), out).real
            along = felt.along(met_by(ends, through), stacked(_signals(mine)))
            for each, met in zip(mine, along, strict=True):
                mixed = (met - within @ each.follow / 2).T @ each.follow
                total -= mixed + mixed.T
        return total


def information(residuals: Sequence[Residual]) -> tuple[Array, Array]:
    """Of all records the information (nf, nf) were transients known, and as it is."""
    alike: dict[int, list[Residual]] = {}
    for each in residuals:
        alike.setdefault(id(each.felt), []).append(each)
    known = sum(mine[0].felt.gram(_signals(mine)) for mine in alike.values())
    follow = np.concatenate([each.follow for each in residuals])
    return np.asarray(known), np.asarray(known - follow.T @ follow)


def _products(x: ComplexArray, y: ComplexArray) -> Array:
    """Re Σ x ȳ over the last axis of contiguous arrays (K, ny, n)."""
    return np.asarray(np.einsum("kia,kia->ki", x.view(float), y.view(float)))


def _signals(residuals: Sequence[Residual]) -> ComplexArray:
    """Signals (K, nz, n) of n records."""
    return np.stack([each.Z for each in residuals], axis=2)


def met_by(columns: ComplexArray, L: ComplexArray) -> Array:
    """What columns (K, ny, m) meet of L (K, ny, p): (2 K, m p), for signals in halves."""
    met = (columns.conj().swapaxes(1, 2) @ L).reshape(len(L), -1)
    return np.concatenate([met.real, -met.imag])


def stacked(x: ComplexArray) -> Array:
    """Real and imaginary parts, one after the other, (2 K, ...)."""
    return np.concatenate([x.real, x.imag])


def halves(x: ComplexArray) -> Array:
    """Real and imaginary part, (K, 2, ...)."""
    return np.stack([x.real, x.imag], axis=1)


def as_real(x: ComplexArray) -> Array:
    """Complex matrices (K, m, n) as real ones (K, 2 m, 2 n), of halves one after the other."""
    out = np.empty((len(x), 2, x.shape[1], 2, x.shape[2]))
    out[:, 0, :, 0] = out[:, 1, :, 1] = x.real
    out[:, 0, :, 1], out[:, 1, :, 0] = -x.imag, x.imag
    return out.reshape(len(x), 2 * x.shape[1], -1)


def _root(T: Array, known: Array) -> Array:
    """A root (m, m) of the covariance of transients by which outputs move by T (K, 2, ny, m).

    Of which zeros are ``known`` with (m,) 1/variance.
    """
    flat = T.reshape(-1, T.shape[-1])
    G = flat.T @ flat + np.diag(known)
    unit = 1 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = np.linalg.eigh(G * np.outer(unit, unit))
    kept = values > RANK * max(float(values.max()), 1e-300)
    scale = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return np.asarray(unit[:, None] * vectors * scale)
