"""The figure of what bounds cost."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure
from truths.mixture import Positive, record

from casid import Profile, compare_bounds
from casid.report import plot_bounds
from casid.report.drawings import draw_bounds
from casid.report.look import LOOK
from casid.report.prices import MARKS, _surface, plot_profile


@pytest.fixture(scope="module")
def compared():
    cases = {"free": {}, "bound": {"a": "< 0.97"}, "tie": ["a = 2 b"],
             "impossible": ["a + b <= -1"]}  # fmt: skip
    return compare_bounds(Positive(), [record()], cases=cases)


@pytest.mark.second
def test_the_figure_has_a_row_a_parameter_the_largest_price_first(compared):
    ax = Figure().subplots()
    assert plot_bounds(ax, compared, rows=2) is ax
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert labels == [f"{name} [-]" for name in compared.ranked()[:2]]
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["free", "bound", "tie"]  # the failed case has nothing to show
    low, high = ax.get_ylim()
    assert low > high  # from the top


@pytest.mark.second
def test_a_held_value_is_filled_and_has_no_interval(compared):
    ax = Figure().subplots()
    plot_bounds(ax, compared)
    marks = [line for line in ax.lines if line.get_marker() in MARKS and len(line.get_xdata())]
    filled = [line for line in marks if line.get_markerfacecolor() != "white"]
    assert [line.get_marker() for line in marks] == ["o", "s", "D"] * 3  # told without colour
    assert len(filled) == 1


@pytest.mark.second
@pytest.mark.parametrize("name", ["case {}", "damping of roll above {} and all others free"])
def test_many_cases_are_told_apart_in_a_legend_within_the_picture(compared, name):
    cases = [replace(compared.cases[0], name=name.format(k)) for k in range(32)]
    with rc_context(LOOK):
        figure = next(draw_bounds(replace(compared, cases=tuple(cases)))).figure
        figure.draw_without_rendering()
    legend = figure.axes[0].get_legend()
    assert len({(line.get_color(), line.get_marker()) for line in legend.legend_handles}) == 32
    assert len(legend.texts) == 32
    edges, page = legend.get_window_extent(), figure.bbox
    assert page.x0 <= edges.x0 < edges.x1 <= page.x1
    assert figure.axes[0].bbox.y1 <= edges.y0 < edges.y1 <= page.y1


def test_the_surface_over_two_parameters_is_right_between_its_points():
    def cost(x, y):
        return 2 * x**2 - 3e3 * x * y + 5e6 * y**2  # a valley, scales far apart

    grid = np.meshgrid([-1.0, 0.4, 1.0], [-1e-3, 2e-4, 1e-3])
    a, b = points = np.array([each.ravel() for each in grid])
    slope = np.column_stack([4 * a - 3e3 * b, -3e3 * a + 1e7 * b])
    x, y, z = _surface(points.T, cost(a, b), slope)
    np.testing.assert_allclose(z, cost(x, y), atol=1e-6 * np.ptp(cost(a, b)))


@pytest.mark.parametrize("points", [[[1.0]], [[0.9, 0.5]], [[0.9, 0.5], [0.9, 0.6], [0.9, 0.8]]])
def test_a_profile_of_few_points_is_drawn_without_a_curve(compared, points):
    points = np.array(points)
    names, fit, cost = tuple("ab")[: points.shape[1]], compared.cases[0].fit, np.ones(len(points))
    spans = {"a": (0.4, np.inf), "b": (np.nan, np.nan)}
    found = Profile(
        names=names, points=points, cost=cost, slope=np.ones(points.shape), reasons=(), fit=fit,
        level=0.95, parabola=cost, intervals=spans, standard=spans, cramer_rao=spans,
    )  # fmt: skip
    figure = Figure()
    drawn = next(line for line in plot_profile(figure.subplots(), found).lines)
    assert len(drawn.get_xdata()) == len(points)
    figure.canvas.draw()
