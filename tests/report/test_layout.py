"""Axes on a sheet."""

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from casid.report.layout import legend_above, place_axes, stacked
from casid.report.look import LOOK


def test_axes_share_one_scale_whose_ticks_are_drawn_at_the_bottom_only():
    with rc_context(LOOK):
        figure = Figure(figsize=(5, 4))
        axes = stacked(figure, [2.0, 1.0], 2)
        axes[0, 0].plot([0.0, 4.0], [0.0, 1.0])
        axes[-1, 0].set_xlim(0.0, 3.0)
        place_axes(figure, axes)
    assert all(ax.get_xlim() == (0.0, 3.0) for ax in axes.flat)
    assert [ax.xaxis.get_visible() for ax in axes.flat] == [False, False, True, True]
    heights = [ax.get_position().height for ax in axes[:, 0]]
    np.testing.assert_allclose(heights[0], 2 * heights[1])


def test_axes_that_make_ticks_late_look_like_others():
    drawn = []
    for light in (True, False):
        with rc_context(LOOK):
            figure = Figure(figsize=(5, 4))
            ax = stacked(figure, [1.0])[0, 0] if light else figure.subplots()
            ax.plot([0.0, 4.0], [0.0, 1.0])
            ax.grid(visible=False, axis="x")
            ax.tick_params(axis="x", labelsize=5.0)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
            drawn.append(np.asarray(canvas.buffer_rgba()))
    other = np.any(drawn[0] != drawn[1], axis=2)  # the first line's end, which is not cut off
    assert np.flatnonzero(other.any(axis=0)).size <= 1
    assert other.sum() < 10


def test_a_line_of_the_grid_stands_above_every_tick():
    with rc_context(LOOK):
        figure = Figure(figsize=(5, 4))
        axes = stacked(figure, [1.0, 1.0])
        axes[-1, 0].set_xlim(0.0, 3.0)
        place_axes(figure, axes)
        FigureCanvasAgg(figure).draw()
    upright = axes[0, 0].lines[0]  # each from 0 to 1 with a gap behind
    places, along = upright.get_xdata()[::3].tolist(), upright.get_ydata()
    np.testing.assert_array_equal(along.reshape(-1, 3), [[0, 1, np.nan]] * len(places))
    ticks = [x for x in axes[1, 0].get_xticks() if 0 <= x <= 3]
    assert places == ticks
    assert len(ticks) > 3
    assert axes[0, 0].get_ylim() == (0.0, 1.0)  # the lines move no limit


def test_an_axis_of_y_shows_what_its_own_would():
    with rc_context(LOOK):
        ours, theirs = Figure(figsize=(5, 4)), Figure(figsize=(5, 4))
        axes = stacked(ours, [1.0])
        for ax in (axes[0, 0], theirs.subplots()):
            ax.plot([0.0, 1.0], [-2e-7, 3.1e-7])
            ax.set_ylabel("p [rad/s]")
        place_axes(ours, axes)
        canvas = FigureCanvasAgg(theirs)
        canvas.draw()
    low, high = theirs.axes[0].get_ylim()
    ticks = [t for t in theirs.axes[0].yaxis.get_major_ticks() if low <= t.get_loc() <= high]
    own = theirs.axes[0].yaxis.get_offset_text().get_text()
    told = [text.get_text() for text in axes[0, 0].texts]
    assert own
    assert told == [*(tick.label1.get_text() for tick in ticks), own, "p [rad/s]"]
    numbers = axes[0, 0].texts[: len(ticks)]
    assert [text.get_position()[1] for text in numbers] == [tick.get_loc() for tick in ticks]
    level = axes[0, 0].lines[-1]
    assert level.get_ydata()[::3].tolist() == [tick.get_loc() for tick in ticks]


def test_a_legend_names_every_curve_and_bands_last():
    figure = Figure()
    ax = figure.subplots()
    ax.fill_between([0, 1], [0, 1], [1, 2], label="measured ±2σ")
    ax.plot([0, 1], [0, 1], label="measured")
    legend_above(figure, ax)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["measured", "measured ±2σ"]
