"""Figures of a design: limits where they are, errors over those of the 3-2-1-1."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from casid import summary
from casid.design.plan import Alternative, Design
from casid.report.designs import plot_card, plot_errors

T = 0.1 * np.arange(50)
WAVE = 0.05 * np.sin(T)[:, None]


def design(feedback=0.0):
    usual, own = np.array([0.2, 0.4]), np.array([0.1, 0.1])
    return Design(
        kind="multi-step",
        inputs=("lat",),
        outputs=("p",),
        t=T,
        r=WAVE - feedback,
        u=WAVE,
        y=2 * WAVE,
        names=("Lp", "Llat"),
        values=np.array([-2.0, 9.0]),
        covariance=np.diag(own**2),
        before=np.full(2, np.inf),
        alternatives=(
            Alternative(name="3-2-1-1", r=WAVE, std_errors=usual),
            Alternative(name="multi-step", r=WAVE, std_errors=own),
        ),
        used={"lat": 0.5},
        used_at_worst={"lat": 0.6},
        limits={"lat": 0.11},
        instead=120.0,
    )


@pytest.mark.parametrize("feedback", [0.0, 0.01])
def test_limits_stand_where_they_were_asked_for_whatever_share_is_used(feedback):
    axes = Figure().subplots(2, 1)
    plot_card(axes, design(feedback))
    levels = [line.get_ydata()[0] for line in axes[0].lines if line.get_linestyle() == "--"]
    assert sorted(levels) == [-0.11, 0.11]
    assert (axes[0].get_legend() is not None) == (feedback > 0)
    assert not [line for line in axes[1].lines if line.get_linestyle() == "--"]


def test_errors_are_relative_to_those_of_the_usual_input():
    ax = plot_errors(Figure().subplots(), design())
    drawn = {line.get_label(): line.get_ydata().tolist() for line in ax.lines}
    assert drawn["3-2-1-1"] == [1.0, 1.0]
    assert drawn["multi-step"] == pytest.approx([0.5, 0.25])
    assert not ax.get_xlabel()


def test_what_no_input_tells_apart_is_left_out_of_the_picture_by_name():
    ax = plot_errors(Figure().subplots(), replace(design(), untold=("Lp",)))
    assert [label.get_text() for label in ax.get_xticklabels()] == ["Llat"]
    assert [line.get_ydata().tolist() for line in ax.lines] == [[1.0], [pytest.approx(0.25)]]
    assert ax.get_xlabel() == "without Lp, which no input identifies"


def test_a_designs_table_has_all_three_errors():
    assert "| Llat | 9 | ∞ | 0.4 | 0.1 |".replace(" ", "") in summary(design()).replace(" ", "")
