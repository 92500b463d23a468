"""Gains that change with the sample: likelihood by SciPy, derivatives by differences."""

import numpy as np
import pytest
import scipy.stats

from casid.shooting.gains import Gains

NX, NY, NF, N = 3, 2, 2, 40


def gains(lam, rng_seed=0):
    """Two kinds of samples, gains and covariances linear in two unknowns."""
    rng = np.random.default_rng(rng_seed)
    K0, K_lam = rng.standard_normal((2, NX, NY)), rng.standard_normal((2, NX, NY, NF))
    half = rng.standard_normal((2, NY, NY))
    S0 = half @ half.transpose(0, 2, 1) + 2 * np.eye(NY)
    S_lam = 0.1 * rng.standard_normal((2, NY, NY, NF))
    S_lam = S_lam + S_lam.transpose(0, 2, 1, 3)
    S = S0 + S_lam @ lam
    W = np.linalg.inv(np.linalg.cholesky(S))
    which = rng.integers(0, 2, N)
    return Gains(which=which, K=K0 + K_lam @ lam, S=S, W=W, K_lam=K_lam, S_lam=S_lam)


LAM = np.array([0.3, -0.2])
R = np.random.default_rng(1).standard_normal((N, NY))


def test_the_cost_is_the_likelihood_of_the_innovations():
    g = gains(LAM)
    pairs = zip(R, g.which, strict=True)
    known = sum(scipy.stats.multivariate_normal(np.zeros(NY), g.S[k]).logpdf(r) for r, k in pairs)
    assert g.cost(R) == pytest.approx(-known - N * NY / 2 * np.log(2 * np.pi), rel=1e-12)


def test_gradient_and_information_through_the_covariance():
    gradient, information = gains(LAM).through_covariance(R)
    h = 1e-6 * np.eye(NF)
    by_difference = [(gains(LAM + d).cost(R) - gains(LAM - d).cost(R)) / 2e-6 for d in h]
    np.testing.assert_allclose(gradient, by_difference, rtol=1e-6)
    # Fisher's information of covariances: ½ tr(S⁻¹ S_i S⁻¹ S_j), sample by sample.
    g = gains(LAM)
    by_hand = np.zeros((NF, NF))
    for k in g.which:
        V = [np.linalg.solve(g.S[k], g.S_lam[k, :, :, i]) for i in range(NF)]
        by_hand += [[np.trace(V[i] @ V[j]) / 2 for j in range(NF)] for i in range(NF)]
    np.testing.assert_allclose(information, by_hand, rtol=1e-10)


def test_what_innovations_add_to_states_and_their_derivatives():
    g, at = gains(LAM), np.array([3, 17, 20])
    by_hand = np.array([g.K[g.which[k]] @ R[k] for k in at])
    np.testing.assert_allclose(g.push(at, R[at]), by_hand, rtol=1e-12)
    h = 1e-6 * np.eye(NF)
    slopes = [(gains(LAM + d).push(at, R[at]) - gains(LAM - d).push(at, R[at])) / 2e-6 for d in h]
    np.testing.assert_allclose(g.force(at, R[at]), np.transpose(slopes, (2, 1, 0)), atol=1e-8)
    heard = np.random.default_rng(2).standard_normal((NY, len(at), 4))
    carried = np.array([g.K[g.which[k]] @ heard[:, i] for i, k in enumerate(at)])
    np.testing.assert_allclose(g.carry(at, heard), carried.transpose(1, 0, 2), rtol=1e-12)
