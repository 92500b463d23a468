"""Axes on a sheet: one scale of x for all, its ticks once, places by the inch, one legend."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter
from matplotlib.transforms import ScaledTranslation, Transform

from casid.report.look import LOOK

WIDE, BESIDE = 0.57, 3.8  # of a legend: a letter, a line with its gaps; in sizes of the letters
LEFT, RIGHT, TOP, BOTTOM, GAP = 0.66, 0.1, 0.42, 0.42, 0.1  # inches around and between axes


class _Late:
    """Of an axis: no ticks until they are drawn, which in a stack most never are."""

    majorTicks: Any = cached_property(lambda _: [])  # noqa: N815 - as matplotlib has it
    minorTicks: Any = cached_property(lambda _: [])  # noqa: N815


class _LateX(_Late, XAxis):
    """Of x."""


class _LateY(_Late, YAxis):
    """Of y."""


class _Light(Axes):
    """Axes that are made in half the time."""

    def _init_axis(self) -> None:
        """Make the axes of x and y, as matplotlib's projections do."""
        self.xaxis, self.yaxis = _LateX(self, clear=False), _LateY(self, clear=False)
        for axis, sides in ((self.xaxis, ("bottom", "top")), (self.yaxis, ("left", "right"))):
            for side in sides:
                self.spines[side].register_axis(axis)


def stacked(figure: Figure, heights: Sequence[float], columns: int = 1) -> np.ndarray:
    """Axes (rows, columns) of relative heights and one scale of x, whose ticks stand at the bottom.

    An axis with its ticks takes longer to draw than the curves: those above have none of their own.
    """
    light = {"axes_class": _Light}
    axes: np.ndarray = figure.subplots(
        len(heights), columns, squeeze=False, height_ratios=heights, subplot_kw=light
    )
    first = axes[-1, 0]
    for ax in axes.flat:
        if ax is not first:
            ax.sharex(first)
        ax.patch.set_visible(False)  # white on white
        ax.spines[["left", "bottom"]].set_position(("outward", 0.0))  # which ticks would do else
        ax.xaxis.set_visible(ax in axes[-1])
    return axes


def place_axes(figure: Figure, axes: np.ndarray, *, lines: int = 1) -> Figure:
    """Place axes by the inch (a layout engine is slow), labels of so many lines beside them."""
    width, height = figure.get_size_inches()
    rows, columns = axes.shape
    gap = GAP + (0.14 if any(ax.get_title(loc="left") for ax in axes[1:].flat) else 0.0)
    each = (height - TOP - BOTTOM - gap * (rows - 1)) / rows
    left = LEFT + 0.14 * (lines - 1)
    between = left + 0.05
    wide = (width - left - RIGHT - between * (columns - 1)) / columns
    across = {"left": left / width, "right": 1 - RIGHT / width, "wspace": between / wide}
    down = {"top": 1 - TOP / height, "bottom": BOTTOM / height, "hspace": gap / each}
    figure.subplots_adjust(**across, **down)
    for ax in axes.flat:
        ax.yaxis.set_label_coords(-0.51 / wide, 0.5)
        below = ax.transAxes + ScaledTranslation(0, -0.21, figure.dpi_scale_trans)
        ax.xaxis.set_label_coords(0.5, 0, transform=below)  # looked for, its place takes time
    _lines_of_grid(axes)
    for ax in axes.flat:
        if ax.get_visible() and isinstance(ax.yaxis.get_major_formatter(), ScalarFormatter):
            _scale_of_y(ax, -0.51 / wide)
    return figure


def _scale_of_y(ax: Axes, left: float) -> None:
    """Lines, numbers and name of an axis of y in the place of its own, which take longest to draw.

    The name stands so far left of the axes, in parts of their width.
    """
    axis, (low, high) = ax.yaxis, sorted(ax.get_ylim())
    places = [y for y in axis.get_majorticklocs() if low <= y <= high]
    formatter, across = axis.get_major_formatter(), ax.get_yaxis_transform()
    beside = across + ScaledTranslation(-7 / 72, 0, ax.figure.dpi_scale_trans)
    for y, label in zip(places, formatter.format_ticks(places), strict=True):
        ax.text(0, y, label, transform=beside, ha="right", va="center_baseline")
    if factor := formatter.get_offset():
        ax.text(0, 1, factor, transform=ax.transAxes, va="bottom")
    if name := axis.label.get_text():
        look: dict[str, Any] = {"rotation_mode": "anchor", "va": "bottom", "ha": "center"}
        size = axis.label.get_fontsize()
        look |= {"transform": ax.transAxes, "rotation": "vertical", "size": size}
        ax.text(left, 0.5, name, **look)
    ax.add_artist(_grid(places, across, level=True))
    axis.set_visible(False)


def _lines_of_grid(axes: np.ndarray) -> None:
    """Lines of the grid where the axis of x that would draw them is not shown."""
    low, high = axes[-1, 0].get_xlim()
    ticks = [x for x in axes[-1, 0].xaxis.get_majorticklocs() if low <= x <= high]
    for ax in (ax for ax in axes.flat if not ax.xaxis.get_visible()):
        ax.add_artist(_grid(ticks, ax.get_xaxis_transform(), level=False))


def _grid(places: Sequence[float], transform: Transform, *, level: bool) -> Line2D:
    """Lines of the grid, upright or level, as one curve with gaps: it is drawn fastest."""
    across, along = np.repeat(places, 3), np.tile([0.0, 1.0, np.nan], len(places))
    x, y = (along, across) if level else (across, along)
    look = {"color": LOOK["grid.color"], "linewidth": LOOK["grid.linewidth"], "zorder": 0.5}
    return Line2D(x, y, transform=transform, **look)


def legend_above(figure: Figure, ax: Axes) -> None:
    """What the curves of these axes are called, above all, in letters that fit; bands last."""
    handles, labels = ax.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda k: labels[k].endswith("σ"))
    handles, labels = [handles[k] for k in order], [labels[k] for k in order]
    wide = sum(WIDE * len(label) + BESIDE for label in labels)
    look: dict[str, Any] = {"ncols": len(labels), "borderaxespad": 0.2, "columnspacing": 1.0}
    look["fontsize"] = min(LOOK["font.size"], 72 * figure.get_figwidth() / wide)
    figure.legend(handles, labels, loc="upper center", **look)
