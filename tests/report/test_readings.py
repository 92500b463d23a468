"""Figures of a handling-qualities reading and of how settings were chosen."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from truths.attitudes import response, roll

from casid.baseline.handling import handling_qualities
from casid.report import plot_handling_qualities, plot_order_selection
from casid.subspace.candidates import Candidate, OrderSelection

TRIED = tuple(
    Candidate(order=n, past=past, pole=pole, regularisation=0.0, score=abs(n - 5) + pole + past)
    for n in (4, 5, 6)
    for past in (8, 10)
    for pole in (6.0, 8.0)
)


@pytest.mark.parametrize("kind", ["attitude", "loop"])
def test_the_figure_marks_what_was_read(kind):
    figure, (magnitude, angle) = plt.subplots(2, 1)
    read = handling_qualities(response(roll), ("phi", "lat"), kind=kind)
    plot_handling_qualities(magnitude, angle, read)
    marks = [line.get_xdata()[0] for ax in (magnitude, angle) for line in ax.lines
             if line.get_marker() == "o"]  # fmt: skip
    wanted = (
        [read.crossover, read.omega_180] if kind == "loop"
        else [read.bandwidth_phase, read.omega_180, read.bandwidth_gain]
    )  # fmt: skip
    assert sorted(marks) == pytest.approx(sorted(wanted))
    assert f"{read.bandwidth:.2f}" in magnitude.get_title() or kind == "loop"
    plt.close(figure)


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
