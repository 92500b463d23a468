"""Sums over lines of rows that are products: of what is felt by what drives.

A row of output i on a line is Σ_qp z_q L_ip Ψ_qp, with the line's signals z (n,), what outputs
feel, L (ny, p), and a matrix Ψ (n p, m) that is the same on every line. So the rows' Gram matrix is
a congruence,

    Re Σ rowᴴ row = Ψᵀ M Ψ,     M = Re Σ Q ⊗ H,     Q = z̄ zᵀ,     H = Lᴴ L,

and M is two products of real matrices, over all lines at once and however many columns Ψ has: of a
Hermitian matrix, the real part on and above the diagonal and the imaginary one above it are all
there is. Records that share L share these products, too: Q is summed over them first.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, ComplexArray

PORTION = 1000  # lines whose products are held at once


class Hermitian(NamedTuple):
    """Hermitian matrices of size n, one a line, by what lies on the diagonal and above it."""

    n: int
    real: Array  # (K, n (n + 1) / 2)
    imag: Array  # (K, n (n - 1) / 2), above the diagonal

    @classmethod
    def of(cls, whole: ComplexArray) -> "Hermitian":
        """Of whole ones (K, n, n)."""
        n = whole.shape[1]
        flat, places = whole.reshape(len(whole), -1), _places(n)
        return cls(n, flat.real[:, places.upper], flat.imag[:, places.above])

    @classmethod
    def squares(cls, x: ComplexArray) -> "Hermitian":
        """Σ x̄ xᵀ over the last axis of (K, n, R)."""
        return cls.of(x.conj() @ x.swapaxes(1, 2))

    def whole(self) -> ComplexArray:
        """Whole ones (K, n, n)."""
        places, out = _places(self.n), np.empty((len(self.real), self.n**2), dtype=complex)
        out.real = self.real[:, places.real]
        if self.imag.size:
            out.imag = self.imag[:, places.imag] * places.sign
        else:
            out.imag = 0.0
        return out.reshape(-1, self.n, self.n)


class _Places(NamedTuple):
    """Where entries of a Hermitian matrix of a size stand, whole (n²,) and by half."""

    upper: NDArray[np.intp]  # in the whole, on the diagonal and above it
    above: NDArray[np.intp]
    real: NDArray[np.intp]  # (n²,) among those
    imag: NDArray[np.intp]
    sign: Array  # (n²,) of the imaginary part


@lru_cache(maxsize=64)
def _places(n: int) -> _Places:
    row, column = np.divmod(np.arange(n * n), n)
    upper, above = np.flatnonzero(row <= column), np.flatnonzero(row < column)
    mirrored = np.minimum(row, column) * n + np.maximum(row, column)
    real = np.searchsorted(upper, mirrored)
    imag = np.minimum(np.searchsorted(above, mirrored), max(len(above) - 1, 0))
    return _Places(upper, above, real, imag, np.sign(column - row).astype(float))


def gram(x: ComplexArray, felt: Hermitian) -> Array:
    """M = Re Σ Q ⊗ H over lines, (n p, n p), of Q = Σ x̄ xᵀ over the last axis of x (K, n, R)."""
    n, p = x.shape[1], felt.n
    rows, columns = _places(n), _places(p)
    M = np.zeros((len(rows.upper), len(columns.upper)))
    skew = np.zeros((len(rows.above), len(columns.above)))
    for k in range(0, len(x), PORTION):
        at = slice(k, k + PORTION)
        driven = Hermitian.squares(x[at])
        M += driven.real.T @ felt.real[at]
        skew += driven.imag.T @ felt.imag[at]
    M = M[rows.real][:, columns.real]
    if skew.size:
        M -= rows.sign[:, None] * skew[rows.imag][:, columns.imag] * columns.sign
    return M.reshape(n, n, p, p).transpose(0, 2, 1, 3).reshape(n * p, n * p)


def contracted(x: ComplexArray, C: Array) -> ComplexArray:
    """Σ x_q C_qp,q'p' x̄_q' of every line, (K, p, p), of x (K, n) and a symmetric C (n p, n p)."""
    n = x.shape[1]
    p, rows, driven = len(C) // n, _places(n), Hermitian.squares(x[:, :, None])
    columns = _places(p)
    by = C.reshape(n, p, n, p).transpose(0, 2, 1, 3).reshape(n * n, p * p)
    back = by.reshape(n, n, -1).swapaxes(0, 1).reshape(n * n, -1)
    both = (by + back)[rows.upper][:, columns.upper]
    both[rows.upper % (n + 1) == 0] /= 2
    apart = (back - by)[rows.above][:, columns.above]
    return Hermitian(p, driven.real @ both, driven.imag @ apart).whole()
