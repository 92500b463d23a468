"""Sums over lines against rows laid out one by one."""

import numpy as np
import pytest

from casid.shooting import line_products
from casid.shooting.line_products import Hermitian, contracted, gram, parted

K, NY = 7, 3


def complex_normal(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def rows(z, L):
    """Row of every output of a line by signals and what is felt: (K, ny, n p)."""
    return (z[:, None, :, None] * L[:, :, None, :]).reshape(len(z), L.shape[1], -1)


@pytest.mark.parametrize(("n", "p", "records"), [(4, 3, 1), (5, 2, 3), (1, 2, 2), (3, 1, 1)])
@pytest.mark.parametrize("portion", [2, 1000])
def test_gram_matrices_are_those_of_the_rows(n, p, records, portion, monkeypatch):
    monkeypatch.setattr(line_products, "PORTION", portion)
    rng = np.random.default_rng(n)
    x, L = complex_normal(rng, K, n, records), complex_normal(rng, K, NY, p)
    found = gram(x, Hermitian.squares(L.swapaxes(1, 2)))
    flat = np.concatenate([rows(x[:, :, r], L).reshape(-1, n * p) for r in range(records)])
    np.testing.assert_allclose(found, (flat.conj().T @ flat).real, atol=1e-13 * len(flat))


@pytest.mark.parametrize(("n", "p"), [(4, 3), (1, 2), (3, 1)])
def test_what_a_covariance_makes_of_a_row_is_its_quadratic_form(n, p):
    rng = np.random.default_rng(p)
    x, L, root = complex_normal(rng, K, n), complex_normal(rng, K, NY, p), rng.random((n * p, 4))
    P = contracted(x, parted(root @ root.T, n))
    np.testing.assert_allclose(P, P.conj().swapaxes(1, 2), atol=1e-13)
    np.testing.assert_allclose(
        np.einsum("kip,kpq,kiq->ki", L, P, L.conj()).real,
        np.sum(np.abs(rows(x, L) @ root) ** 2, axis=2),
        rtol=1e-12,
    )


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_hermitian_matrix_is_what_it_was_cut_from(n):
    root = complex_normal(np.random.default_rng(n), K, n, n)
    whole = root @ root.conj().swapaxes(1, 2)
    np.testing.assert_allclose(Hermitian.of(whole).whole(), whole, atol=1e-13)
