"""Interactive plots show what the pictures show."""

import json

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from truths.pages import draw

from casid.report import (
    BLACK_BOX,
    OUTPUT_ERROR,
)
from casid.report.interactive import STEPS, interactive


@pytest.mark.slow
def test_the_interactive_plot_has_the_curves_of_the_picture(content):
    drawing = next(d for d in draw(content) if d.name.startswith("response"))
    plot = json.loads(interactive(drawing.figure))
    curves = [line for ax in drawing.figure.axes for line in ax.lines if len(line.get_xdata()) > 2]
    drawn = [collection for ax in drawing.figure.axes for collection in ax.collections]
    bands = [each for each in drawn if isinstance(each, PolyCollection)]  # no lines of the grid
    assert len(plot["data"]) == len(curves) + len(bands)
    shown = [trace["name"] for trace in plot["data"] if trace["showlegend"]]
    assert len(shown) == len(set(shown))
    assert {BLACK_BOX, OUTPUT_ERROR} <= set(shown)


def numbers(packed):
    """What report.js makes of second differences."""
    told = np.array([np.nan if each is None else each for each in packed["turns"]], float)
    known = np.isfinite(told)
    told[known] = packed["step"] * np.cumsum(np.cumsum(told[known]))
    return 10**told if packed["log"] else told


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_packed_numbers_are_those_of_the_curve_gaps_too(scale):
    figure = Figure()
    ax = figure.subplots()
    x = np.geomspace(0.02, 30, 400)
    y = np.exp(np.random.default_rng(1).standard_normal(400))
    y[[0, 7, 8, 399]] = np.nan
    ax.plot(x, y)
    ax.set(xscale=scale, yscale=scale)
    (trace,) = json.loads(interactive(figure))["data"]
    for packed, values, limits in (
        (trace["x"], x, ax.get_xlim()),
        (trace["y"], y, ax.get_ylim()),
    ):
        found = numbers(packed)
        ends, there, back = limits, values, found
        if scale == "log":
            ends, there, back = (np.log10(each) for each in (limits, values, found))
        np.testing.assert_allclose(back, there, atol=0.51 * np.ptp(ends) / STEPS, rtol=0)
