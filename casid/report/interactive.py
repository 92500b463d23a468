"""The figures of a report as interactive plots: the same artists, handed on to plotly.

One conversion for every figure, so that the static picture and the interactive plot cannot differ,
in plain dictionaries in the words of plotly.js: the Python package's own objects take longer to
check every attribute than matplotlib takes to draw.
"""

import json
from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MultipleLocator

from casid.arrays import Array

PIXELS = 104  # per inch of figure
STEPS = 5000  # along an axis as drawn, so that zooming in still shows curves
FONT = {"family": "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif", "size": 12}
SHAPES = {"o": "circle", "s": "square", "D": "diamond", "^": "triangle-up", "v": "triangle-down"}
MARKS = {marker: f"{shape}-open" for marker, shape in SHAPES.items()}
Trace = dict[str, Any]
PATTERNS = {"": "", "///": "/", "...": ".", "xxx": "x", "\\\\\\": "\\"}


def interactive(figure: Figure) -> str:
    """JSON of the plotly figure that shows what a matplotlib figure shows."""
    data: list[Trace] = []
    layout: dict[str, Any] = {"annotations": [], "shapes": []}
    shown = [ax for ax in figure.axes if ax.get_visible()]
    for k, ax in enumerate(shown, start=1):
        x, y = _reference("x", k), _reference("y", k)
        for trace in _traces(ax):
            label = trace["name"]
            named = not label or any(other["name"] == label for other in data)
            place = {"xaxis": x, "yaxis": y, "legendgroup": label, "showlegend": not named}
            data.append(trace | place)
        group = ax.get_shared_x_axes().get_siblings(ax)  # zooming one of them moves them all
        first = min(shown.index(other) for other in group if other in shown) + 1
        follows = {} if first == k else {"matches": _reference("x", first)}
        layout[_key("x", k)] = _axis(ax, "x", y) | follows
        layout[_key("y", k)] = _axis(ax, "y", x)
        layout["annotations"] += _titles(ax, x, y)
        layout["shapes"] += [*_bands(ax, x, y), *_levels(ax, x, y)]
    layout |= {
        "height": round(float(figure.get_size_inches()[1]) * PIXELS),
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "font": FONT,
        "plot_bgcolor": "#ffffff",
        "hovermode": "x",
        "barmode": "overlay",
        "legend": {"orientation": "h", "x": 0.04, "xanchor": "left", "y": 1.0, "yanchor": "top"},
    }
    return json.dumps({"data": data, "layout": layout}, allow_nan=False, separators=(",", ":"))


def _traces(ax: Axes) -> Iterator[Trace]:
    for collection in ax.collections:
        if isinstance(collection, PolyCollection):
            yield _band(ax, collection)
    for container in ax.containers:
        if isinstance(container, BarContainer):
            yield _bars(ax, container)
    for line in ax.lines:
        if line.get_transform().contains_branch(ax.transData) and _size(line) > 2:
            yield _curve(ax, line)


def _label(artist: Any) -> str:  # noqa: ANN401 - any artist has one
    label = str(artist.get_label())
    return "" if label.startswith("_") else label


def _curve(ax: Axes, line: Line2D) -> Trace:
    x, y = (np.asarray(values, dtype=float) for values in line.get_data())
    steps = np.diff(x)
    even = bool(np.all(np.abs(steps - steps[0]) < 1e-6 * np.abs(steps[0]))) and steps[0] > 0
    along: Trace = (
        {"x0": float(x[0]), "dx": float(steps.mean())} if even else {"x": _packed(x, ax.xaxis)}
    )
    color = _color(line.get_color())
    marker = str(line.get_marker())
    look: Trace = {"mode": "lines", "line": _line(line, color)}
    if marker not in ("None", "", " "):
        size = 1.5 * line.get_markersize()
        symbol = MARKS.get(marker, "circle")
        look = {"mode": "markers", "marker": {"symbol": symbol, "color": color, "size": size}}
    shown = {"y": _packed(y, ax.yaxis), "name": _label(line), "hovertemplate": "%{y:.4g}"}
    return {"type": "scatter"} | shown | along | look


def _size(line: Line2D) -> int:
    return int(np.size(line.get_xdata()))


def _line(line: Line2D, color: str) -> dict[str, Any]:
    width = line.get_linewidth()
    # The pattern as drawn: matplotlib keeps it in units of the line's width.
    _, pattern = line._unscaled_dash_pattern  # type: ignore[attr-defined]
    dash = ",".join(f"{1.4 * width * part:.1f}px" for part in pattern) if pattern else "solid"
    return {"color": color, "width": 1.2 * width, "dash": dash}


def _band(ax: Axes, collection: PolyCollection) -> Trace:
    parts = (path.vertices for path in collection.get_paths())
    corners = np.vstack([np.zeros((0, 2)), *parts])  # none around what nobody measured
    return {
        "type": "scatter",
        "x": _packed(corners[:, 0], ax.xaxis),
        "y": _packed(corners[:, 1], ax.yaxis),
        "mode": "lines",
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": _color(collection.get_facecolor()[0]),
        "name": _label(collection),
        "hoverinfo": "skip",
    }


def _bars(ax: Axes, container: BarContainer) -> Trace:
    names = [text.get_text() for text in ax.get_xticklabels()]
    bars = list(container.patches)
    hatch = PATTERNS.get(bars[0].get_hatch() or "", "")
    return {
        "type": "bar",
        "x": [float(bar.get_x()) for bar in bars],
        "y": [h if np.isfinite(h := float(bar.get_height())) else None for bar in bars],
        "width": [float(bar.get_width()) for bar in bars],
        "offset": 0,
        "name": _label(container),
        "customdata": names,
        "hovertemplate": "%{customdata}: %{y:.3f}",
        "marker": {
            "color": _color(bars[0].get_facecolor()),
            "pattern": {"shape": hatch, "fgcolor": "#ffffff", "size": 6, "fillmode": "overlay"},
        },
    }


def _axis(ax: Axes, letter: str, anchor: str) -> dict[str, Any]:
    box = ax.get_position()
    axis, (low, high) = (ax.xaxis, ax.get_xlim()) if letter == "x" else (ax.yaxis, ax.get_ylim())
    domain = [box.x0, box.x1] if letter == "x" else [box.y0, box.y1]
    log = axis.get_scale() == "log"
    limits = [np.log10(low), np.log10(high)] if log else [low, high]
    look = {
        "domain": [round(float(edge), 5) for edge in domain],
        "anchor": anchor,
        "type": "log" if log else "linear",
        "range": [float(limit) for limit in limits],
        "title": {
            "text": axis.get_label_text().replace("\n", "<br>"),
            "standoff": 4,
            "font": {"size": 12},
        },
        "showline": True,
        "linecolor": "#444444",
        "ticks": "outside",
        "ticklen": 4,
        "gridcolor": "#e4e4e4",
        "zeroline": False,
        "tickfont": {"size": 11},
    }
    return look | _ticks(axis, letter)


def _ticks(axis: Axis, letter: str) -> dict[str, Any]:
    locator = axis.get_major_locator()
    look: dict[str, Any] = {"nticks": 6}
    if isinstance(locator, FixedLocator):
        places = [float(place) for place in locator.tick_values(0, 0)]
        labels = axis.get_major_formatter().format_ticks(places)
        look = {"tickvals": places, "ticktext": labels}
    elif isinstance(locator, MultipleLocator):
        first, second = list(locator.tick_values(*axis.get_view_interval()))[:2]
        look = {"tick0": 0, "dtick": float(second - first)}
    params = axis.get_tick_params()
    shown = letter == "y" or (axis.get_visible() and params.get("labelbottom", True))
    return look | {"showticklabels": shown}


def _titles(ax: Axes, x: str, y: str) -> Iterator[dict[str, Any]]:
    if title := ax.get_title(loc="left"):
        look = {
            "text": f"<b>{escape(title, quote=False)}</b>",
            "showarrow": False,
            "font": {"size": 12},
        }
        place = {"x": 0, "y": 1, "xref": f"{x} domain", "yref": f"{y} domain"}
        yield look | place | {"xanchor": "left", "yanchor": "bottom"}


def _bands(ax: Axes, x: str, y: str) -> Iterator[dict[str, Any]]:
    """Bands across the axes."""
    for band in (patch for patch in ax.patches if patch not in _bar_patches(ax)):
        (_, y0), (_, y1) = np.asarray(band.get_extents().transformed(ax.transData.inverted()))
        place = {"x0": 0, "x1": 1, "y0": float(y0), "y1": float(y1)}
        look = {"type": "rect", "layer": "below", "fillcolor": _color(band.get_facecolor())}
        yield place | look | {"xref": f"{x} domain", "yref": y, "line": {"width": 0}}


def _levels(ax: Axes, x: str, y: str) -> Iterator[dict[str, Any]]:
    """Lines across the axes that mark a value."""
    for line in (line for line in ax.lines if _size(line) == 2):
        (x0, x1), (y0, y1) = (np.asarray(v, dtype=float).tolist() for v in line.get_data())
        level = y0 == y1
        dash = "dot" if line.get_linestyle() == ":" else "solid"
        look = {"color": _color(line.get_color()), "width": 1, "dash": dash}
        ends = {"type": "line", "x0": x0, "x1": x1, "y0": y0, "y1": y1, "line": look}
        axes = (f"{x} domain", y) if level else (x, f"{y} domain")
        yield ends | dict(zip(("xref", "yref"), axes, strict=True))


def _bar_patches(ax: Axes) -> list[Any]:
    bars = [container for container in ax.containers if isinstance(container, BarContainer)]
    return [patch for container in bars for patch in container.patches]


def _key(letter: str, k: int) -> str:
    return f"{letter}axis{'' if k == 1 else k}"


def _reference(letter: str, k: int) -> str:
    return f"{letter}{'' if k == 1 else k}"


def _packed(values: Array, axis: Axis) -> dict[str, Any]:
    """An array as second differences of whole steps, null where unknown; report.js sums them.

    A step is a five-thousandth of what the axis shows, of the decimal logarithm on a logarithmic
    one: a tenth of what numbers in full take.
    """
    log = axis.get_scale() == "log"
    x, ends = np.asarray(values, dtype=float), np.asarray(axis.get_view_interval(), dtype=float)
    if log:
        x, ends = np.log10(np.where(x > 0, x, np.nan)), np.log10(ends)
    step = float(f"{np.ptp(ends) / STEPS:.3g}")
    known = np.isfinite(x)
    whole = np.round(x[known] / step).astype(np.int64)
    told: list[int | None] = np.full(len(x), None).tolist()
    for k, second in zip(
        np.flatnonzero(known), np.diff(whole, n=2, prepend=[0, 0]).tolist(), strict=True
    ):
        told[k] = second
    return {"step": step, "log": log, "turns": told}


def _color(color: Any) -> str:  # noqa: ANN401 - any of matplotlib's
    red, green, blue, alpha = to_rgba(color)
    return f"rgba({255 * red:.0f},{255 * green:.0f},{255 * blue:.0f},{alpha:.2f})"
