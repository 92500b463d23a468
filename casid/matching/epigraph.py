"""The largest singular value as smooth constraints, one Hermitian matrix a point.

    Eᴴ E + L Lᴴ = t I,    L lower triangular, its diagonal >= 0,

so that √t is at least the largest singular value of every E (q, r). Hermitian matrices are held as
r² real numbers, the diagonal and then real and imaginary parts below it; so is L.
"""

from functools import cache

import numpy as np

from casid.arrays import Array, ComplexArray


def numbers(M: ComplexArray) -> Array:
    """The real numbers (..., r²) of Hermitian, or of lower triangular, matrices (..., r, r)."""
    r = M.shape[-1]
    i, j = np.tril_indices(r, -1)
    below, diagonal = M[..., i, j], M[..., range(r), range(r)]
    return np.concatenate([diagonal.real, below.real, below.imag], axis=-1)


def hermitian_weights(mu: Array) -> ComplexArray:
    """Hermitian Y (..., r, r) with Σ mu ∘ numbers(M) = Σ conj(Y) ∘ M for all Hermitian M."""
    r = round(np.sqrt(mu.shape[-1]))
    i, j = np.tril_indices(r, -1)
    Y = np.zeros((*mu.shape[:-1], r, r), dtype=complex)
    Y[..., range(r), range(r)] = mu[..., :r]
    half = (mu[..., r : r + len(i)] + 1j * mu[..., r + len(i) :]) / 2
    Y[..., i, j], Y[..., j, i] = half, half.conj()
    return Y


@cache
def squares(r: int) -> Array:
    """Table Q (r², r², r²) with numbers(L Lᴴ)_m = Σ Q_mvw l_v l_w for the numbers l of L."""
    basis = np.zeros((r * r, r, r), dtype=complex)
    basis[range(r), range(r), range(r)] = 1
    below = np.tril_indices(r, -1)
    for k, (i, j) in enumerate(zip(*below, strict=True)):
        basis[r + k, i, j], basis[r + len(below[0]) + k, i, j] = 1, 1j
    products = basis[:, None] @ basis.conj().transpose(0, 2, 1)
    table = numbers((products + products.transpose(1, 0, 2, 3)) / 2)
    return np.asarray(table.transpose(2, 0, 1))
