"""The figure of a comparison of bounds."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator

from casid.bounds.compare import BoundsComparison
from casid.fit import ParameterEstimate

COLOURS = ("#000000", "#0072B2", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#6B3D00")
MARKS = ("o", "s", "D", "^", "v", "P", "X", "*")
CONFIDENCE = 1.96  # standard deviations of a 95 % interval
REACH = 1.6  # of the largest value of a row: how far its axis goes


def plot_bounds(ax: Axes, comparison: BoundsComparison, *, rows: int = 16) -> Axes:
    """Draw values, 95 % intervals and bounds of the most expensively held parameters, row by row.

    Every row is divided by the largest value any case gives the parameter, which stands at its
    right; the largest price is at the top. A bar is the range a case allows, a filled mark a value
    that its bounds hold.

    Parameters
    ----------
    ax : Axes
    comparison : BoundsComparison
        Failed cases are left out.
    rows : int
        How many parameters, at most.
    """
    shown = [case for case in comparison.cases if not case.reason]
    names = comparison.ranked()[:rows]
    labels, sizes = [], []
    for y, name in enumerate(names):
        each = [next(row for row in case.parameters if row.name == name) for case in shown]
        size = max(*(abs(row.value) for row in each), 1e-300)
        for k, row in enumerate(each):
            height = y + 0.8 * ((k + 0.5) / len(each) - 0.5)
            _draw_one(ax, row, height, 0.6 / len(each), size, *_look(k))
        labels.append(f"{name} [{each[0].unit}]")
        sizes.append(f"{size:.3g}")
    for k, case in enumerate(shown):
        colour, mark = _look(k)
        ax.plot([], [], mark, color=colour, markersize=4, label=case.name)
    _decorate(ax, labels, sizes, "largest value", "largest value")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return ax


def plot_parameters(ax: Axes, rows: Sequence[ParameterEstimate]) -> Axes:
    """Draw values, 95 % intervals and bounds of one fit, each divided by the value's size."""
    sizes = [float(np.nanmax([abs(row.value), row.std_error, 1e-300])) for row in rows]
    for y, (row, size) in enumerate(zip(rows, sizes, strict=True)):
        _draw_one(ax, row, y, 0.6, size, "#D55E00" if row.active else "#0072B2")
    labels = [f"{row.name} [{row.unit}]" for row in rows]
    values = [f"{row.value:.3g}" for row in rows]
    _decorate(ax, labels, values, "larger of value and standard error", "value")
    return ax


def _look(case: int) -> tuple[str, str]:
    """Colour and mark of a case; it is told without colour too."""
    return COLOURS[case % len(COLOURS)], MARKS[case % len(MARKS)]


def _draw_one(
    ax: Axes,
    row: ParameterEstimate,
    y: float,
    height: float,
    size: float,
    colour: str,
    mark: str = "o",
) -> None:
    """One case's range, interval and value in one row."""
    low, high = np.clip(np.array([row.lower, row.upper]) / size, -2 * REACH, 2 * REACH)
    ax.barh(y, high - low, height, left=low, color=colour, alpha=0.15, linewidth=0)
    ax.plot([low, low], [y - height / 2, y + height / 2], color=colour, linewidth=0.8)
    ax.plot([high, high], [y - height / 2, y + height / 2], color=colour, linewidth=0.8)
    if np.isfinite(row.std_error):
        spread = CONFIDENCE * row.std_error / size
        ends = [row.value / size - spread, row.value / size + spread]
        ax.plot(ends, [y, y], color=colour, linewidth=1.2)
    face = colour if row.active else "white"
    ax.plot(row.value / size, y, mark, color=colour, markerfacecolor=face, markersize=4)


def _decorate(
    ax: Axes, labels: Sequence[str], told: Sequence[str], size: str, right_label: str
) -> None:
    """Name the rows at the left, with a number each at the right, and what values are over."""
    ax.set_yticks(range(len(labels)), [label.replace("^2", "²") for label in labels])
    ax.set(xlim=(-REACH, REACH), ylim=(len(labels) - 0.4, -0.6), xlabel=f"value / {size} [-]")
    ax.axvline(0, color="#777777", linewidth=0.8, zorder=0)
    ax.grid(visible=False, axis="y")
    for y in range(1, len(labels)):
        ax.axhline(y - 0.5, color="#e4e4e4", linewidth=0.5, zorder=0)
    right = ax.secondary_yaxis("right")
    right.yaxis.set_major_locator(FixedLocator(list(range(len(told)))))
    right.set_yticklabels(list(told))
    right.set_ylabel(right_label)
