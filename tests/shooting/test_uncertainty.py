"""Bounds, collinearity and coloured residuals against closed forms and brute force."""

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
import scipy.sparse
from truths.scores import autoregressive, process_scores

from casid.shooting.uncertainty import (
    bound,
    collinearities,
    coloured_covariance,
    coordinates,
    correlation,
    eliminate,
    own_step,
    residual_covariance,
)

RNG = np.random.default_rng(8)
START = RNG.bit_generator.state


@pytest.fixture(autouse=True)
def every_test_begins_with_the_same_numbers():
    RNG.bit_generator.state = START


NONE = np.zeros((0, 3))


def test_eliminating_nuisances_is_least_squares_with_them_projected_out():
    # Residuals J_l λ + J_n ν with ν_2 = ν_1 + λ_1: substitute and project by hand.
    J_l, J_n = RNG.standard_normal((40, 3)), RNG.standard_normal((40, 2))
    G, G_cross = np.array([[1.0, -1.0]]), np.array([[1.0, 0.0, 0.0]])
    F, follow = eliminate(
        J_l.T @ J_l,
        scipy.sparse.csc_array(J_n.T @ J_n),
        J_n.T @ J_l,
        scipy.sparse.csc_array(G),
        G_cross,
    )
    S = J_l + np.outer(J_n[:, 1], [1.0, 0.0, 0.0])
    n = J_n.sum(axis=1)
    projected = S - np.outer(n, n @ S) / (n @ n)
    np.testing.assert_allclose(F, projected.T @ projected, rtol=1e-9)
    move, price = follow[:2], follow[2:]
    np.testing.assert_allclose(J_l + J_n @ move, projected, atol=1e-9)
    np.testing.assert_allclose(J_n.T @ projected + G.T @ price, 0, atol=1e-9)


def test_a_nuisance_with_many_neighbours_is_eliminated_as_any_other(monkeypatch):
    # A bias beside a chain of nodes: the bias alone has more than three neighbours.
    nodes, nf = 12, 2
    J_l, J_b = RNG.standard_normal((60, nf)), RNG.standard_normal((60, 1))
    J_n = np.kron(np.eye(nodes), np.ones((5, 1))) * RNG.standard_normal((60, 1))
    J = np.hstack([J_b, J_n])
    G = np.hstack([np.zeros((nodes - 1, 1)), np.eye(nodes)[1:] - 0.9 * np.eye(nodes)[:-1]])
    G_cross = RNG.standard_normal((nodes - 1, nf))
    parts = (J_l.T @ J_l, scipy.sparse.csc_array(J.T @ J), J.T @ J_l, scipy.sparse.csc_array(G),
             G_cross)  # fmt: skip
    together = eliminate(*parts)
    monkeypatch.setattr("casid.shooting.uncertainty.MANY", 3)
    for one, two in zip(together, eliminate(*parts), strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-8, atol=1e-8)


def test_a_nuisance_that_is_hardly_known_takes_its_information_all_the_same():
    # Information 2 and 3 of λ and a nuisance of unit 1e-6, correlated; another is known to 1e-3.
    weak = np.array([[1e6, 0.0], [0.0, 1e-6 * 3]])
    F, _ = eliminate(
        np.array([[2.0]]), scipy.sparse.csc_array(weak), np.array([[0.0], [1e-3 * 2.4]]),
        scipy.sparse.csc_array((0, 2)), np.zeros((0, 1)),
    )  # fmt: skip
    assert F[0, 0] == pytest.approx(2 - 2.4**2 / 3, rel=5e-3)  # rounding is 1e-16 of 1e6


@pytest.mark.parametrize("size", [1.0, 3.0, 7.0])
def test_two_nuisances_that_are_the_same_take_what_one_of_them_would(size):
    # An integral's initial value and its bias: of unit size their factor is exactly singular.
    F, follow = eliminate(
        size * np.eye(1),
        scipy.sparse.csc_array(np.full((2, 2), size)),
        np.full((2, 1), size / 2),
        scipy.sparse.csc_array((0, 2)),
        np.zeros((0, 1)),
    )
    np.testing.assert_allclose(F, 3 * size / 4, rtol=1e-12)  # the rest of a share of a quarter
    assert follow.sum() == pytest.approx(-0.5)


def test_the_bound_is_the_inverse_of_the_information():
    J, unit = RNG.standard_normal((50, 3)), np.array([1.0, 1e-4, 1e5])
    expected = np.linalg.inv(J.T @ J) / np.outer(unit, unit)
    scaled = J * unit
    np.testing.assert_allclose(bound(scaled.T @ scaled, NONE), expected, rtol=1e-9)


def test_a_tie_takes_its_direction_out_of_the_bound():
    # λ_2 = 2 λ_1: one parameter with the gradient (1, 2, 0) and one of its own.
    J = RNG.standard_normal((50, 3))
    T = np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 1.0]])
    expected = T @ np.linalg.inv(T.T @ J.T @ J @ T) @ T.T
    np.testing.assert_allclose(bound(J.T @ J, np.array([[2.0, -1.0, 0.0]])), expected, rtol=1e-9)


def test_what_the_data_do_not_show_is_named_and_has_no_bound():
    J = RNG.standard_normal((60, 4))
    J[:, 2] = 0.0  # no effect
    J[:, 3] = -2 * J[:, 1]  # only the combination shows
    F = J.T @ J
    variance = np.diag(bound(F, np.zeros((0, 4))))
    np.testing.assert_array_equal(np.isinf(variance), [False, True, True, True])
    assert np.isfinite(variance[0])
    found = collinearities(F, np.zeros((0, 4)), ("a", "b", "c", "d"))
    assert all(np.isinf(c.condition) for c in found)
    assert {name for c in found for name in c.names} == {"b", "c", "d"}


@pytest.mark.parametrize("little", [0.0, 1e-90, 1e-40])
def test_what_has_no_effect_spoils_no_other_error(little):
    F = np.array([[4.0, 1.0, 1e-16, 2e-16], [1.0, 9.0, -1e-16, 1e-16]])
    F = np.vstack([F, [1e-16, -1e-16, 2.0, 0.0], [2e-16, 1e-16, 0.0, little]])
    ties = np.eye(4)[[2, 3]]
    wanted = np.linalg.inv(F[:2, :2])
    tied, told = bound(F, ties), bound(F, ties[:1])  # the last one held, and not
    for found in (tied, told):
        assert found[:2, :2] == pytest.approx(wanted, rel=1e-12)
        assert found[2, 2] == 0
    assert tied[3, 3] == 0
    assert np.isinf(told[3, 3])


def test_near_collinear_parameters_are_named_with_their_condition_index():
    J = RNG.standard_normal((500, 3))
    J[:, 2] = J[:, 0] + 0.01 * J[:, 2]
    (found,) = collinearities(J.T @ J, NONE, ("Lp", "Lq", "Llat"))
    assert set(found.names) == {"Lp", "Llat"}
    # Two unit columns 0.01 apart: eigenvalues 2 and ½·0.01², condition √(2/0.5e-4) = 200.
    np.testing.assert_allclose(found.condition, 200, rtol=0.15)
    rho = correlation(bound(J.T @ J, NONE))
    assert abs(rho[0, 2]) > 0.999


def test_orthogonal_parameters_are_not_collinear():
    assert collinearities(np.diag([1.0, 1e6, 1e-6]), NONE, ("a", "b", "c")) == ()


def test_intervals_cover_where_residuals_grow_with_what_excites_them():
    # What is left out is a slow factor of the slope itself; twenty blocks, Student's t.
    n, hits = 1500, []
    for run in range(80):
        rng = np.random.default_rng([12, run])
        *X, slow = scipy.signal.lfilter([1], [1, -0.9], rng.standard_normal((3, n)))
        X = np.column_stack(X)
        y = X[:, 0] * slow / 3 + rng.standard_normal(n)
        P = np.linalg.inv(X.T @ X)
        r = (y - X @ (P @ X.T @ y)) / (sigma := np.std(y))
        S = (X / sigma)[:, None]
        P = P * sigma**2
        V, _ = coloured_covariance(P, [r[:, None]], lambda root, S=S: [[S @ root]])
        by_process = P @ process_scores(2, residual_covariance([r[:, None]]), [[S]]) @ P
        error = (P @ X.T @ y)[0] / sigma**2
        hits.append([abs(error) < 2.10 * np.sqrt(v[0, 0]) for v in (by_process, V)])
    before, now = np.mean(hits, axis=0)
    assert before < 0.80
    assert 0.88 < now < 0.995  # 80 runs scatter by 2.5 %


def test_covariance_of_residuals_is_that_of_their_process():
    A = np.array([[0.7, 0.3], [-0.2, 0.5]])
    C = residual_covariance([autoregressive(20000, A, RNG) for _ in range(2)])
    now = scipy.linalg.solve_discrete_lyapunov(A, np.eye(2))  # E z(t) z(t)ᵀ
    for m in (0, 1, 5):  # E z(t) z(t + m)ᵀ = now (Aᵀ)^m; some 10⁴ independent samples
        expected = now @ np.linalg.matrix_power(A.T, m)
        np.testing.assert_allclose(C[m], expected, rtol=0, atol=4 * now.max() / 100)
    beyond = now @ np.linalg.matrix_power(A.T, len(C))
    assert np.abs(beyond).max() < 4 * now.max() / 100
    assert not C[-1].any()
    white = [RNG.standard_normal((400, 3)) for _ in range(3)]
    np.testing.assert_allclose(residual_covariance(white)[0], np.eye(3), atol=4 / np.sqrt(1200))
    assert len(residual_covariance(white)) == 1


def test_correlation_of_a_channel_slower_than_the_others_counts():
    # Every tenth sample of one channel, correlated by 0.8 from one to its next; white the other.
    n, each = 6000, 10
    r, s = RNG.standard_normal((n, 2)), np.ones((n, 2, 1))
    slow = autoregressive(n // each, np.array([[0.8]]), RNG)
    r[:, 0], s[:, 0] = 0.0, 0.0
    r[::each, :1], s[::each, 0] = slow * np.sqrt(1 - 0.8**2), 1.0
    C = residual_covariance([r])
    # The mean of 600 such samples has nine times its variance if they were white, the sum over both
    # signs of 0.8^k; that of the correlation of 600 samples scatters by a quarter.
    scores = n + 9 * n / each
    assert process_scores(1, C, [[s]])[0, 0] == pytest.approx(scores, abs=9 * n / each / 2)
    assert process_scores(1, C[:1], [[s]])[0, 0] == pytest.approx(n + n / each, rel=0.1)


def test_white_residuals_of_which_many_are_missing_are_white():
    # A correlation of 16 % of the pairs scatters by 2.5 times as much, beyond limits for all.
    found = []
    for _ in range(40):
        r = RNG.standard_normal((600, 2))
        r[RNG.random(r.shape) < 0.6] = 0.0
        found.append(len(residual_covariance([r])) == 1)
    assert np.mean(found) > 0.9


def test_white_residuals_need_no_correction():
    n, nf = 20000, 2
    s = RNG.standard_normal((n, 1, nf))
    covariance = np.linalg.inv(np.einsum("nai,naj->ij", s, s))
    found, _ = coloured_covariance(
        covariance, [RNG.standard_normal((n, 1))], lambda root: [[s @ root]]
    )
    # The variance of 20000 residuals scatters by 1 %.
    np.testing.assert_allclose(np.diag(found), np.diag(covariance), rtol=0.04)


def test_few_residuals_that_alternate_by_chance_do_not_make_errors_smaller():
    rng = np.random.default_rng(0)
    s, r = rng.standard_normal((40, 1, 2)), np.tile([[1.0], [-1.0]], (20, 1))
    s += 2.0  # slow, so that an alternating noise would average out
    covariance = np.linalg.inv(np.einsum("nai,naj->ij", s, s))
    found, _ = coloured_covariance(covariance, [r], lambda root: [[s @ root]])
    assert np.linalg.eigvalsh(found - covariance).min() > -1e-9 * covariance.max()
    C = residual_covariance([r])
    root = np.linalg.cholesky(covariance)
    assert np.linalg.eigvalsh(process_scores(2, C, [[s @ root]])).min() < 0.5  # what it would be


def test_a_parameter_known_far_worse_than_the_others_takes_nothing_from_their_errors():
    n, nf = 4000, 3
    s = RNG.standard_normal((n, 1, nf)) * [1.0, 1.0, 1e-9]  # the last is not known at all
    P = np.diag(1 / np.einsum("nai,nai->i", s, s))
    residuals = autoregressive(n, np.array([[0.8]]), RNG)
    std = np.sqrt(np.diag(coloured_covariance(P, [residuals], lambda A: [[s @ A]])[0]))
    alone = coloured_covariance(P[:2, :2], [residuals], lambda A: [[s[..., :2] @ A]])[0]
    np.testing.assert_allclose(std[:2], np.sqrt(np.diag(alone)), rtol=0.1)


def test_in_its_coordinates_a_covariance_is_the_identity_whatever_the_units():
    rng = np.random.default_rng(4)
    some = rng.standard_normal((4, 3)) * np.array([1e6, 1.0, 1e-6, 0.0])[:, None]  # the last held
    some[1] = 2e-6 * some[0]  # two that move together
    P = some @ some.T
    root, inverse = coordinates(P)
    assert root.shape == (4, 2)
    size = np.sqrt(np.diag(P)) + (np.diag(P) == 0)
    np.testing.assert_allclose(
        root @ root.T / np.outer(size, size), P / np.outer(size, size), atol=1e-12
    )
    np.testing.assert_allclose(inverse @ root, np.eye(2), atol=1e-12)


def test_a_step_goes_where_the_information_tells_of():
    rows = np.random.default_rng(5).standard_normal((9, 3)) @ np.diag([1.0, 1.0, 0.0])
    r = np.arange(9.0)
    step, directions = own_step(rows.T @ r, rows.T @ rows)
    np.testing.assert_allclose(step, np.linalg.lstsq(rows, r, rcond=None)[0], rtol=1e-9)
    assert directions == 2
