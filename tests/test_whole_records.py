"""What whole records say of a covariance by blocks, against regressions and draws of scores."""

import numpy as np
import pytest
import scipy.stats

from casid.whole_records import understated


def drawn(rng, K, H):
    """Scores (m, k) of records with shares H of all that scatters by K, none left in all."""
    root = np.linalg.cholesky(K)
    raw = np.array([root @ np.linalg.cholesky(h) @ rng.standard_normal(len(K)) for h in H])
    return raw - np.einsum("cij,j->ci", H, raw.sum(axis=0))


def test_records_alike_count_by_students_t_of_all_their_directions():
    K, H = np.diag([4.0, 1.0, 9.0]), np.full((4, 1, 1), 0.25) * np.eye(3)
    g = np.array([[8.0, 0, 0], [-8.0, 0, 0], [0, 6.0, 0], [0, -6.0, 0]])
    delta = (2 * 64 / 4 + 2 * 36) / (3 * 0.75)
    wider = scipy.stats.t(9).ppf(0.975) / scipy.stats.norm.ppf(0.975)
    assert understated(K, g, H) == pytest.approx(delta * wider**2, rel=1e-9)


def test_factor_is_unbiased_and_scatters_by_its_degrees_of_freedom():
    # Shares that differ, none of which are larger than two thirds of a direction.
    rng, k = np.random.default_rng(3), 4
    raw = [rng.standard_normal((6 + 4 * c, k)) for c in range(3)]
    whole = np.linalg.cholesky(np.linalg.inv(sum(x.T @ x for x in raw)))
    H = np.array([whole.T @ x.T @ x @ whole for x in raw])
    size = 100.0  # so that no factor is the least
    found = [understated(np.eye(k) / size, drawn(rng, np.eye(k), H), H) / size for _ in range(4000)]
    H2 = H @ H
    spare = k - np.trace(H2.sum(axis=0))
    parts = [
        [np.linalg.norm((c == d) * H[c] - H[c] @ H[d]) ** 2 for d in range(3)] for c in range(3)
    ]
    freedom = spare**2 / np.sum(parts)
    wider = (scipy.stats.t(freedom).ppf(0.975) / scipy.stats.norm.ppf(0.975)) ** 2
    assert np.mean(found) / wider == pytest.approx(1.0, abs=4 * np.sqrt(2 / freedom / 4000))
    assert np.var(found) / wider**2 == pytest.approx(2 / freedom, rel=0.15)


def test_scores_no_larger_than_blocks_tell_change_nothing():
    rng = np.random.default_rng(4)
    H = np.full((5, 1, 1), 0.2) * np.eye(3)
    assert understated(np.eye(3), 0.3 * drawn(rng, np.eye(3), H), H) == 1.0
    # One record, or two of one parameter, tell nothing whatever their scores.
    assert understated(np.eye(3), np.full((1, 3), 50.0), np.eye(3)[None]) == 1.0
    assert understated(np.eye(1), np.array([[50.0], [-50.0]]), np.full((2, 1, 1), 0.5)) == 1.0


def test_intervals_cover_where_the_slopes_differ_from_record_to_record():
    rng, whose, hits = np.random.default_rng(5), np.repeat(np.arange(2), 100), []
    for _ in range(500):
        X = rng.standard_normal((200, 6))
        y = np.einsum("nk,nk->n", X, 0.15 * rng.standard_normal((2, 6))[whose])
        y += rng.standard_normal(200)
        root = np.linalg.cholesky(np.linalg.inv(X.T @ X))
        S = X @ root
        r = y - S @ (S.T @ y)
        parts = [S[whose == c] for c in range(2)]
        g = np.array([s.T @ r[whose == c] for c, s in enumerate(parts)])
        more = understated(np.eye(6), g, np.array([s.T @ s for s in parts]))
        off = np.abs(root @ S.T @ y) / np.linalg.norm(root, axis=1)
        hits.append([np.mean(off < 1.96), np.mean(off < 1.96 * np.sqrt(more))])
    before, now = np.mean(hits, axis=0)  # 3000 errors scatter by 0.5 %
    assert before < 0.80
    assert 0.93 < now < 0.98
