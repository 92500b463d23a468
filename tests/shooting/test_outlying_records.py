"""Records of linear measurements that contradict each other, by least squares of their parts."""

from dataclasses import replace

import numpy as np
import pytest

from casid.shooting.amplitudes import Sides
from casid.shooting.hausman import Source
from casid.shooting.outlying_records import RARELY, Records, discord, parted, scattered
from casid.shooting.spectral_homogeneity import Opposed

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


def squares(J, y):
    """Sum of squares that the estimate of some leaves."""
    best = estimate(J, y)
    return sum(np.sum((v - j @ best) ** 2) for j, v in zip(J, y, strict=True))


def test_heterogeneity_is_what_one_estimate_leaves_beyond_one_of_each():
    J, y = flown((1, 2), (1, 3), (2, 2), (1, 2))
    found = records(J, y).heterogeneity
    alone = sum(squares([j], [v]) for j, v in zip(J, y, strict=True))
    assert found.square == pytest.approx(squares(J, y) - alone)
    assert found.freedom == 6
    none = records(*flown((1, 2))).heterogeneity
    assert none.square == pytest.approx(0, abs=1e-9)
    assert (none.freedom, none.chance) == (0, 1.0)


def test_of_what_a_record_does_not_tell_nothing_is_asked():
    J, y = flown((1, 2), (1, 2), (1, 2))
    J[0] = J[0] * [1, 0]
    y[0] = y[0] - y[0].mean()
    found = records(J, y).heterogeneity
    alone = sum(squares([j], [v]) for j, v in zip(J, y, strict=True))
    assert found.square == pytest.approx(squares(J, y) - alone)
    assert found.freedom == 3


@pytest.mark.campaign
def test_heterogeneity_is_of_the_chance_it_says():
    chances = [records(*flown(*[(1, 2)] * 4, seed=s)).heterogeneity.chance for s in range(2000)]
    for level in (0.5, 0.1, 0.01):
        share = np.mean(np.array(chances) < level)
        assert abs(share - level) < 3 * np.sqrt(level * (1 - level) / 2000)


def test_halves_of_the_records_that_contradict_each_other_are_told_by_their_inputs_size():
    J, y = flown((0.6, 2), (0.6, 2), (1.4, 2), (1.4, 2))
    made, at = records(J, y), Sides((0, 1), (2, 3))
    found = parted(made, at, None)
    assert found.sides == at
    small = estimate(J[:2], y[:2])
    np.testing.assert_allclose(found.off.step, small - estimate(J, y))
    # Records that scatter across sizes are not told by them.
    assert parted(made, Sides((0, 2), (1, 3)), None) is None
    assert parted(made, None, None) is None


def exact(*values):
    """Records of the first parameter without noise, of information 40 each."""
    J = [np.sqrt(20) * np.array([[1.0, 1.0], [1.0, -1.0]]) for _ in values]
    return J, [j @ [value, 2.0] for j, value in zip(J, values, strict=True)]


def test_sides_are_told_where_they_are_beyond_chance_and_most_of_what_differs():
    at = Sides((0, 1), (2, 3))
    # Of two means of two, χ² is 40 d².
    told = parted(records(*exact(0, 0, 0.8, 0.8)), at, None)
    assert told.off.square == pytest.approx(40 * 0.8**2)
    assert parted(records(*exact(0, 0, 0.35, 0.35)), at, None) is None  # χ² of 4.9
    assert parted(records(*exact(0, 2.4, 1.4, 3.8)), at, None) is None  # 78 of 309


def test_errors_widen_for_what_only_sides_show():
    made = records(*exact(0, 0, 0.65, 0.65))
    assert scattered(made, RARELY) is None
    for at, wide in ((Sides((0, 1), (2, 3)), True), (Sides((0, 2), (1, 3)), False), (None, False)):
        assert Opposed(made, None, None, [], at, None).scatter is wide


def test_scores_that_scatter_more_than_their_information_says_count_for_less():
    made = records(*flown((1, 2), (1, 3), (2, 2), (1, 2)))
    loud = replace(made, sources=[each._replace(S=4 * each.F) for each in made.sources])
    assert loud.heterogeneity.square == pytest.approx(made.heterogeneity.square / 4)
    quiet = replace(made, sources=[each._replace(S=each.F / 4) for each in made.sources])
    assert quiet.heterogeneity.square == pytest.approx(made.heterogeneity.square)


def test_one_record_at_fault_is_told_rather_than_its_side():
    J, y = flown((1, 2), (1, 2), (1, 2), (3, 2))
    made = records(J, y)
    few = discord(made, white=False)
    assert few.which == (3,)
    assert parted(made, Sides((0, 1), (2, 3)), few) is None


def test_records_that_scatter_a_little_each_are_told_together():
    J, y = flown(*[(1 + 0.22 * (-1) ** k, 2 + 0.22 * (-1) ** (k // 2)) for k in range(12)], seed=2)
    made = records(J, y)
    assert min(each.chance for each in made.each.values()) > RARELY / 12
    found = scattered(made, RARELY)
    assert found.whole == made.heterogeneity
    assert found.whole.chance < RARELY
