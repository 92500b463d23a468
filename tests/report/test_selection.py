"""The figure of how settings were chosen."""

import numpy as np
from matplotlib.figure import Figure

from casid.report import plot_order_selection
from casid.subspace.settings import Candidate, OrderSelection

TRIED = tuple(
    Candidate(order=n, past=past, pole=pole, regularisation=0.0, score=abs(n - 5) + pole + past)
    for n in (4, 5, 6)
    for past in (8, 10)
    for pole in (6.0, 8.0)
)


def test_figure_shows_every_pole_and_the_choice():
    chosen = min(TRIED, key=lambda each: each.score)
    values = np.geomspace(1, 1e-6, 40)
    made = OrderSelection(chosen=chosen, candidates=TRIED, criterion="AICc", singular_values=values)
    scores, singular = plot_order_selection(Figure().subplots(1, 2), made)
    labels = [text.get_text() for text in scores.get_legend().get_texts()]
    assert labels == ["a = 6 rad/s", "a = 8 rad/s"]
    for pole, curve in zip((6, 8), scores.containers, strict=True):  # of every order the best past
        assert curve.lines[0].get_xydata().tolist() == [
            [n, abs(n - 5) + pole + 8] for n in (4, 5, 6)
        ]
    assert scores.lines[-1].get_xydata().tolist() == [[5, 14]]  # the ring
    np.testing.assert_array_equal(singular.lines[0].get_ydata(), values[:15])
    assert singular.lines[1].get_xdata()[0] == 5.5
    assert scores.get_ylabel() == "AICc [-]"
