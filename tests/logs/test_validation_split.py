"""Which stretches judge: against all choices there are, and by hand."""

from itertools import combinations

import numpy as np
import pytest

from casid.logs.validation_split import unseen

BOTH, ROLL, PITCH = np.array([0.03, 0.02]), np.array([0.03, 1e-4]), np.array([0.0, 0.035])


@pytest.mark.parametrize(
    ("moved", "wanted"),
    [
        ([BOTH] * 2, [1]),
        ([BOTH] * 9, [3, 7]),
        ([BOTH, BOTH, BOTH, ROLL, PITCH], [2]),  # one that moves both, instead of the fourth
        ([ROLL, PITCH, ROLL, PITCH], [2, 3]),  # none does: one of each
        ([BOTH, ROLL], [1]),  # only the first identifies pitch
        ([ROLL, BOTH], [0]),
        ([ROLL, PITCH], [1]),  # neither can be spared: as ever
        ([np.zeros(2)] * 3, [2]),
    ],
)
def test_what_judges_moves_what_the_others_identify(moved, wanted):
    assert unseen(moved) == wanted


def test_no_choice_of_stretches_judges_an_input_that_is_left_unjudged():
    rng = np.random.default_rng(3)
    for _ in range(300):
        n, nu = rng.integers(2, 8), rng.integers(1, 5)
        moved = rng.uniform(0.5, 1.0, (n, nu)) * (rng.uniform(size=(n, nu)) < 0.6)
        flies, kept = moved > 0, unseen(moved)
        assert 0 < len(kept) < n
        every = flies.any(axis=0)

        def judged(some, flies=flies, every=every):
            rest = np.delete(flies, some, axis=0).any(axis=0)
            return flies[some].any(axis=0) if (rest == every).all() else np.zeros_like(every)

        choices = [list(c) for k in range(1, n) for c in combinations(range(n), k)]
        best = max(int(judged(some).sum()) for some in choices)
        assert int(judged(kept).sum()) >= best - 1
        if best and len(kept) > max(1, n // 4):  # none could be given back
            for k in kept:
                rest = [each for each in kept if each != k]
                assert judged(rest).sum() < judged(kept).sum()
