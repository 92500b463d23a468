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

PORTION = 200  # lines whose products are held at once, in the cache


class Hermitian(NamedTuple):
    """Hermitian matrices of size n, one a line, by what lies on the diagonal and above it."""

    n: int
    parts: Array  # (K, n²): real parts, n (n + 1) / 2, behind them imaginary ones off the diagonal

    @classmethod
    def of(cls, whole: ComplexArray) -> "Hermitian":
        """Of whole ones (K, n, n)."""
        n = whole.shape[1]
        flat = np.ascontiguousarray(whole).reshape(len(whole), n * n).view(float)
        return cls(n, flat.take(_places(n).parts, axis=1, mode="clip"))

    @classmethod
    def squares(cls, x: ComplexArray) -> "Hermitian":
        """Σ x̄ xᵀ over the last axis of (K, n, R)."""
        return cls.of(x.conj() @ x.swapaxes(1, 2))

    @property
    def real(self) -> Array:
        """(K, n (n + 1) / 2)."""
        return self.parts[:, : self.n * (self.n + 1) // 2]

    @property
    def imag(self) -> Array:
        """(K, n (n - 1) / 2), above the diagonal."""
        return self.parts[:, self.n * (self.n + 1) // 2 :]

    def whole(self) -> ComplexArray:
        """Whole ones (K, n, n)."""
        places = _places(self.n)
        flat = self.parts.take(places.both, axis=1, mode="clip")
        flat *= places.signs
        return flat.view(complex).reshape(-1, self.n, self.n)


class _Places(NamedTuple):
    """Where entries of a Hermitian matrix of a size stand, whole (n²,) and by parts."""

    upper: NDArray[np.intp]  # in the whole, on the diagonal and above it
    above: NDArray[np.intp]
    real: NDArray[np.intp]  # (n²,) among those
    imag: NDArray[np.intp]
    sign: Array  # (n²,) of the imaginary part
    parts: NDArray[np.intp]  # (n²,) of all parts among real and imaginary ones by turns
    both: NDArray[np.intp]  # (2 n²,) of these among all parts
    signs: Array  # (2 n²,)


@lru_cache(maxsize=64)
def _places(n: int) -> _Places:
    row, column = np.divmod(np.arange(n * n), n)
    upper, above = np.flatnonzero(row <= column), np.flatnonzero(row < column)
    mirrored = np.minimum(row, column) * n + np.maximum(row, column)
    real = np.searchsorted(upper, mirrored)
    imag = np.minimum(np.searchsorted(above, mirrored), max(len(above) - 1, 0))
    sign = np.sign(column - row).astype(float)
    both = np.stack([real, len(upper) + imag], axis=1).ravel()
    signs = np.stack([np.ones(n * n), sign], axis=1).ravel()
    parts = np.concatenate([2 * upper, 2 * above + 1])
    return _Places(upper, above, real, imag, sign, parts, np.minimum(both, n * n - 1), signs)


@lru_cache(maxsize=64)
def _pairs(n: int, p: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Where entries of M (n p, n p) stand among products of real parts, and of imaginary ones.

    With the sign of the latter.
    """

    def apart(x: NDArray[np.intp], y: NDArray[np.intp]) -> NDArray[np.intp]:
        parts = x.reshape(n, 1, n, 1), y.reshape(1, p, 1, p)
        return np.asarray(parts[0] + parts[1]).reshape(n * p, n * p)

    rows, columns = _places(n), _places(p)
    real = apart(rows.real * len(columns.upper), columns.real)
    imag = apart(rows.imag * len(columns.above), columns.imag)
    sign = rows.sign.reshape(n, 1, n, 1) * columns.sign.reshape(1, p, 1, p)
    return real, imag, -sign.reshape(n * p, n * p)


def gram(x: ComplexArray, felt: Hermitian) -> Array:
    """M = Re Σ Q ⊗ H over lines, (n p, n p), of Q = Σ x̄ xᵀ over the last axis of x (K, n, R)."""
    n, p = x.shape[1], felt.n
    M = np.zeros((n * (n + 1) // 2, p * (p + 1) // 2))
    skew = np.zeros((n * (n - 1) // 2, p * (p - 1) // 2))
    for k in range(0, len(x), PORTION):
        at = slice(k, k + PORTION)
        driven = Hermitian.squares(x[at])
        M += driven.real.T @ felt.real[at]
        skew += driven.imag.T @ felt.imag[at]
    real, imag, sign = _pairs(n, p)
    whole = M.take(real)
    if skew.size:
        whole += sign * skew.take(imag)
    return whole


def parted(C: Array, n: int) -> tuple[Array, Array]:
    """What a symmetric C (n p, n p) makes of the parts of Q, to be `contracted` with."""
    p, rows = len(C) // n, _places(n)
    columns = _places(p)
    by = C.reshape(n, p, n, p).transpose(0, 2, 1, 3).reshape(n * n, p * p)
    back = by.reshape(n, n, -1).swapaxes(0, 1).reshape(n * n, -1)
    both = (by + back)[rows.upper][:, columns.upper]
    both[rows.upper % (n + 1) == 0] /= 2
    return both, (back - by)[rows.above][:, columns.above]


def contracted(x: ComplexArray, C: tuple[Array, Array]) -> ComplexArray:
    """Σ x_q C_qp,q'p' x̄_q' of every line, (K, p, p), of x (K, n) and C that is `parted`."""
    driven = Hermitian.squares(x[:, :, None])
    parts = np.concatenate([driven.real @ C[0], driven.imag @ C[1]], axis=1)
    return Hermitian(round(np.sqrt(parts.shape[1])), parts).whole()
