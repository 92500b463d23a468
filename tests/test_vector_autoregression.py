"""Vector autoregressions: a known one is found, its order too, from sums of products."""

import numpy as np

from casid.vector_autoregression import lagged_products, of_records

A = np.array([[[0.9, 0.1], [-0.2, 0.5]], [[-0.5, 0.0], [0.1, 0.2]]])  # of lags 1 and 2, stable


def test_products_of_lags_are_those_of_the_matrix_of_all_lags():
    z = np.random.default_rng(4).standard_normal((40, 3))
    columns = np.hstack([z[4 - k : 40 - k] for k in range(5)])
    np.testing.assert_allclose(lagged_products(z, 4), columns.T @ columns, rtol=1e-12, atol=1e-12)


def test_the_coefficients_of_a_process_are_those_it_was_made_with():
    rng, N = np.random.default_rng(5), 20_000
    e = rng.standard_normal((N, 2)) @ np.diag([1.0, 0.3])
    z = np.zeros((N, 2))
    for k in range(2, N):
        z[k] = A[0] @ z[k - 1] + A[1] @ z[k - 2] + e[k]
    assert len(of_records([z[:480]], 0.1).A) == 2  # of up to 6, by Akaike's criterion
    found = of_records([z[: N // 2], z[N // 2 :]], 0.1)
    assert len(found.A) == 3  # half of them where samples abound
    # Standard errors: of A at most 1/(0.3 √N) = 0.024, of S at most √(2/N) = 0.01.
    np.testing.assert_allclose(found.A, [*A, np.zeros((2, 2))], atol=0.1)
    np.testing.assert_allclose(found.S, np.diag([1.0, 0.09]), atol=0.04)
