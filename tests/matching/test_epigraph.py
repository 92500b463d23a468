"""Hermitian matrices as numbers, and what their constraints say."""

import numpy as np
import pytest

from casid.matching import epigraph

RNG = np.random.default_rng(2)


def hermitian(r, count=5):
    M = RNG.standard_normal((count, r, r)) + 1j * RNG.standard_normal((count, r, r))
    return M + M.conj().transpose(0, 2, 1)


@pytest.mark.parametrize("r", [1, 2, 4])
def test_weights_make_the_inner_product(r):
    M, mu = hermitian(r), RNG.standard_normal((5, r * r))
    Y = epigraph.hermitian_weights(mu)
    np.testing.assert_array_equal(Y, Y.conj().transpose(0, 2, 1))
    inner = np.sum(Y.conj() * M, axis=(1, 2))
    np.testing.assert_allclose(inner, np.sum(mu * epigraph.numbers(M), axis=1), atol=1e-12)


@pytest.mark.parametrize("r", [1, 2, 4])
def test_the_table_squares_a_triangle(r):
    M = hermitian(r)
    L = np.linalg.cholesky(M @ M)
    l = epigraph.numbers(L)
    found = np.einsum("mvw,kv,kw->km", epigraph.squares(r), l, l)
    np.testing.assert_allclose(found, epigraph.numbers(M @ M), rtol=1e-9, atol=1e-9)
