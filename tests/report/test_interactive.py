"""Interactive plots show what the pictures show."""

import json

import pytest
from matplotlib.collections import PolyCollection
from truths.pages import draw

from casid.report import (
    BLACK_BOX,
    OUTPUT_ERROR,
)
from casid.report.interactive import interactive


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
