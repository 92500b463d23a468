"""The figures of what bounds and ties cost: comparisons, profiles."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator
from matplotlib.tri import CubicTriInterpolator, Triangulation

from casid.arrays import Array
from casid.bounds.compare import BoundsComparison
from casid.bounds.profiles import Profile
from casid.fit import ParameterEstimate
from casid.report.layout import BESIDE, WIDE
from casid.report.look import LOOK, WIDTH

COLOURS = ("#000000", "#0072B2", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#6B3D00")
MARKS = ("o", "s", "D", "^", "v", "P", "X", "*")
CONFIDENCE = 1.96  # standard deviations of a 95 % interval
POINTS = 100  # of a curve between the points of a profile, and each way of its surface
LINE = 0.17  # inches of a line of a legend
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
    look: dict[str, Any] = {"bbox_to_anchor": (0.5, 1.0), "borderaxespad": 0.2, "frameon": False}
    ax.legend(loc="lower center", ncols=_columns(comparison), **look)
    return ax


def bounds_height(comparison: BoundsComparison, rows: int) -> float:
    """Inches that `plot_bounds` takes for all of its rows, those of its legend above them."""
    cases = sum(not case.reason for case in comparison.cases)
    drawn = min(rows, len(comparison.ranked())) * float(np.clip(0.05 * cases, 0.42, 0.6))
    return 0.8 + drawn + LINE * -(-cases // _columns(comparison))


def _columns(comparison: BoundsComparison) -> int:
    """How many names of cases stand beside each other in a legend as wide as a page, four at most.

    Wider than that a name stands alone.
    """
    longest = max(len(case.name) for case in comparison.cases)
    return max(1, min(4, int(72 * WIDTH / LOOK["font.size"] / (WIDE * longest + BESIDE))))


def plot_parameters(ax: Axes, rows: Sequence[ParameterEstimate]) -> Axes:
    """Draw values, 95 % intervals and bounds of one fit, each divided by the value's size."""
    sizes = [float(np.nanmax([abs(row.value), row.std_error, 1e-300])) for row in rows]
    for y, (row, size) in enumerate(zip(rows, sizes, strict=True)):
        _draw_one(ax, row, y, 0.6, size, "#D55E00" if row.active else "#0072B2")
    labels = [f"{row.name} [{row.unit}]" for row in rows]
    values = [f"{row.value:.3g}" for row in rows]
    _decorate(ax, labels, values, "larger of value and standard error", "value")
    return ax


def plot_profile(ax: Axes, profile: Profile) -> Axes:
    """Draw how the cost rises away from the estimate, over one parameter or two.

    Between the points it is cubic, with the slopes found at them; the cross is the estimate, the
    shaded range a parameter's 95 % interval.
    """
    rise, at = profile.cost - profile.fit.cost, [profile.fit[name] for name in profile.names]
    labels = [f"{row.name} [{row.unit}]".replace("^2", "²") for row in at]
    there = np.isfinite(rise) & np.isfinite(profile.slope).all(axis=1)
    points, slope = profile.points[there], profile.slope[there]
    if len(at) == 1:
        order = np.argsort(points[:, 0])
        x, y, known = points[order, 0], rise[there][order], slope[order, 0]
        ax.plot(x, y, "o", color="#0072B2", label="profile")
        if len(x) > 1:
            fine = np.linspace(x[0], x[-1], POINTS)
            ax.plot(fine, scipy.interpolate.CubicHermiteSpline(x, y, known)(fine), color="#0072B2")
        parabola = profile.parabola - profile.fit.cost
        ax.plot(profile.points[:, 0], parabola, "x", color="#777777", label="Cramér-Rao")
        ax.axvline(at[0].value, color="#000000", linewidth=0.8)
        ax.set(xlabel=labels[0], ylabel="rise of the cost [-]")
    else:
        if np.linalg.matrix_rank(points - points[:1]) == 2:  # no surface is over a line
            drawn = ax.contour(*_surface(points, rise[there], slope), colors="#0072B2")
            ax.clabel(drawn, fontsize=7)
        ax.plot(*points.T, ".", color="#777777", label="profile")
        ax.plot(*([row.value] for row in at), "+", color="#000000", label="estimate")
        ax.set(xlabel=labels[0], ylabel=labels[1], title="rise of the cost [-]")
    sides: Any = (ax.axvspan, ax.get_xlim()), (ax.axhspan, ax.get_ylim())
    for row, (span, edges) in zip(at, sides, strict=False):
        interval = np.array(profile.intervals[row.name])
        if not np.isnan(interval).any():  # to the edge where it has no end
            ends = np.where(np.isinf(interval), edges, interval)
            span(*ends, color="#0072B2", alpha=0.08, linewidth=0)
    ax.legend()
    return ax


def _surface(points: Array, rise: Array, slope: Array) -> tuple[Array, Array, Array]:
    """Grid over the points (n, 2), and the surface with their heights and slopes on it."""
    size = np.ptp(points, axis=0)
    triangles = Triangulation(*(points / size).T)
    curved = CubicTriInterpolator(triangles, rise, kind="user", dz=tuple((slope * size).T))
    edges = zip(points.min(axis=0), points.max(axis=0), strict=True)
    x, y = np.meshgrid(*(np.linspace(*edge, POINTS) for edge in edges))
    return x, y, curved(x / size[0], y / size[1])


def _look(case: int) -> tuple[str, str]:
    """Colour and mark of a case: the first eight are told without colour, too, 64 by both."""
    turn, colour = divmod(case, len(COLOURS))
    return COLOURS[colour], MARKS[(colour + turn) % len(MARKS)]


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
