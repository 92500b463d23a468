"""The figure of what bounds cost."""

import pytest
from matplotlib.figure import Figure
from truths.mixture import Mixture, record

from casid import (
    compare_bounds,
)
from casid.report import plot_bounds
from casid.report.prices import MARKS


@pytest.fixture(scope="module")
def compared():
    cases = {"free": {}, "bound": {"a": "< 0.97"}, "tie": ["a = 2 b"],
             "impossible": ["a + b <= -1", "a >= 0", "b >= 0"]}  # fmt: skip
    return compare_bounds(Mixture(), [record()], cases=cases)


def test_the_figure_has_a_row_a_parameter_the_largest_price_first(compared):
    ax = Figure().subplots()
    assert plot_bounds(ax, compared, rows=2) is ax
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert labels == [f"{name} [-]" for name in compared.ranked()[:2]]
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["free", "bound", "tie"]  # the failed case has nothing to show
    low, high = ax.get_ylim()
    assert low > high  # from the top


def test_a_held_value_is_filled_and_has_no_interval(compared):
    ax = Figure().subplots()
    plot_bounds(ax, compared)
    marks = [line for line in ax.lines if line.get_marker() in MARKS and len(line.get_xdata())]
    filled = [line for line in marks if line.get_markerfacecolor() != "white"]
    assert [line.get_marker() for line in marks] == ["o", "s", "D"] * 3  # told without colour
    assert len(filled) == 1
