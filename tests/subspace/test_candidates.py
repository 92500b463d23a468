"""Settings of a black box as candidates."""

import numpy as np
import pytest
from truths.shown import ORDERS, values

from casid.subspace.campaign import Windows
from casid.subspace.candidates import Candidate


def test_a_score_is_the_mean_over_its_folds():
    found = Candidate.of(3, Windows(20, 20, 8.0, 0.01)).scored([1.0, 2.0, 6.0])
    assert (found.score, found.folds) == (3.0, (1.0, 2.0, 6.0))
    assert found.windows == Windows(20, 20, 8.0, 0.01)


@pytest.mark.parametrize(("pole", "label"), [(8.0, "a = 8 rad/s"), (np.nan, "samples, prediction")])
def test_candidates_of_samples_have_no_pole(pole, label):
    found = Candidate(order=1, past=20, pole=pole, regularisation=0.0, refinement="prediction")
    assert found.label == label


def test_the_chosen_candidate_is_marked_in_the_table_and_named_in_the_line():
    found = values()["OrderSelection"]
    assert "order 2, past 20, a = 8 rad/s: of 2 candidates by AICc" in repr(found)
    heading, _, first, second = found.to_markdown().splitlines()
    assert "AICc" in heading
    assert "**chosen**" not in first
    assert second == "| 2 | 20 | a = 8 rad/s | 0.01 | -4.5000 ± 0.1000 **chosen** |"
    assert found.chosen is ORDERS[1]
