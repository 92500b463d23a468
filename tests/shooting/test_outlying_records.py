"""Records of linear measurements that contradict each other, by least squares of their parts."""

import numpy as np
import pytest

from casid.shooting.hausman import Source
from casid.shooting.outlying_records import Records, discord, scattered

NF = 2


def records(J, y):
    """Sources of least squares of y_i = J_i θ + e, e of unit variance, in whitened coordinates."""
    F = np.sum([j.T @ j for j in J], axis=0)
    root = np.linalg.inv(np.linalg.cholesky(F)).T  # F⁻¹ = root rootᵀ
    best = estimate(J, y)
    own = [j @ root for j in J]
    sources = [
        Source(s.T @ (j @ best - v), s.T @ s, s.T @ s) for s, j, v in zip(own, J, y, strict=True)
    ]
    return Records(sources, root)


def estimate(J, y):
    return np.linalg.lstsq(np.concatenate(J), np.concatenate(y), rcond=None)[0]


def flown(*truths, seed=1):
    rng = np.random.default_rng(seed)
    J = [rng.standard_normal((40, NF)) for _ in truths]
    y = [j @ np.asarray(own) + rng.standard_normal(40) for j, own in zip(J, truths, strict=True)]
    return J, y


def test_the_record_without_which_the_others_agree_is_named_and_how_far_it_moves_the_estimate():
    J, y = flown((1, 2), (1, 2), (3, 2), (1, 2))
    found = discord(records(J, y), white=False)
    assert found.which == (2,)
    without = [0, 1, 3]
    others = estimate([J[i] for i in without], [y[i] for i in without])
    np.testing.assert_allclose(found.off.step, others - estimate(J, y))


def test_records_of_one_truth_agree():
    for seed in range(20):
        made = records(*flown(*[(1, 2)] * 4, seed=seed))
        assert made.agree()
        assert discord(made, white=True) is None


def test_two_of_five_are_named_together():
    J, y = flown((1, 2), (3, 2), (1, 2), (1, 2), (1, 4))
    found = discord(records(J, y), white=False)
    assert set(found.which) == {1, 4}
    assert not found.any
    kept = [0, 2, 3]
    others = estimate([J[i] for i in kept], [y[i] for i in kept])
    np.testing.assert_allclose(found.off.step, others - estimate(J, y))


def test_of_three_points_off_a_line_any_one_may_be_wrong():
    J = [np.array([[1.0, v]]) * 20 for v in (-1.0, 0.0, 1.0)]
    found = discord(
        records(J, [j @ [1, 2] + off for j, off in zip(J, (0, 20, 0), strict=True)]), white=False
    )
    assert found.any
    assert set(found.which) == {0, 1, 2}


@pytest.mark.parametrize("white", [True, False])
def test_two_records_accuse_each_other_where_nothing_else_is_left_of_them(white):
    found = discord(records(*flown((1, 2), (3, 2))), white=white)
    assert (found is not None) == white
    assert found is None or (found.any and set(found.which) == {0, 1})


def test_records_of_which_no_two_agree_are_nobodys_fault():
    assert discord(records(*flown((3, 0), (-3, 0), (0, 3), (0, -3), (0, 0))), white=True) is None


def test_of_records_of_which_no_two_agree_the_worst_is_told_and_what_it_moves():
    J, y = flown((3, 0), (-3, 0), (0, 3), (0, -3), (0, 9))
    made = records(J, y)
    found = scattered(made)
    assert found.which == (4,)
    assert found.any is None
    np.testing.assert_allclose(found.off.step, estimate(J[:4], y[:4]) - estimate(J, y))
    np.testing.assert_allclose(found.noise, np.sqrt(np.diag(made.root @ made.root.T)))
    assert scattered(records(*flown(*[(1, 2)] * 4))) is None
