"""Interactive plots show what the pictures show."""

import json
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from truths.pages import draw

from casid import Record, StateSpace, qualify, validate
from casid.report import BLACK_BOX, OUTPUT_ERROR, drawings
from casid.report.interactive import STEPS, interactive
from casid.report.look import LOOK


@pytest.mark.slow
def test_the_interactive_plot_has_the_curves_of_the_picture(content):
    drawing = next(d for d in draw(content) if d.name.startswith("response"))
    plot = json.loads(interactive(drawing.figure))
    grid = LOOK["grid.color"]
    lines = [line for ax in drawing.figure.axes for line in ax.lines if line.get_color() != grid]
    curves = [line for line in lines if len(line.get_xdata()) > 2]
    drawn = [collection for ax in drawing.figure.axes for collection in ax.collections]
    bands = [each for each in drawn if isinstance(each, PolyCollection)]
    assert len(plot["data"]) == len(curves) + len(bands)
    shown = [trace["name"] for trace in plot["data"] if trace["showlegend"]]
    assert len(shown) == len(set(shown))
    assert {BLACK_BOX, OUTPUT_ERROR} <= set(shown)


def test_an_output_that_was_never_measured_is_drawn_without_curves():
    t = 0.02 * np.arange(300)
    u = np.sin(t)[:, None]
    model = StateSpace([[-2.0]], [[4.0]], [[1.0]] * 2, [[0.0]] * 2, None, ("lat",), ("p", "phi"))
    y = model.simulate(t, u) + 0.01 * np.random.default_rng(1).standard_normal((300, 2))
    y[:, 0], y[20:, 1] = np.nan, np.nan  # the other has fewer samples than lags
    seen = validate({OUTPUT_ERROR: model}, Record(t, u, y, ("lat",), ("p", "phi"), "part"))
    drawn = chain(
        drawings.draw_histories(seen, {}),
        drawings.draw_rms(seen),
        drawings.draw_whiteness(seen, OUTPUT_ERROR),
        drawings.draw_qualification(qualify(seen), {}),
    )
    _, rms, whiteness, bands = (json.loads(interactive(each.figure)) for each in drawn)
    assert rms["data"][0]["y"] == [None, 1.0]
    nothing, short = (numbers(each["y"]) for each in whiteness["data"])
    assert np.isnan(nothing).all()
    assert np.isfinite(short).tolist() == [*[True] * 20, *[False] * 81]
    assert next(len(each["y"]["turns"]) for each in bands["data"] if "fill" in each) == 0


def test_a_model_that_runs_out_of_numbers_is_drawn_and_handed_on_as_json():
    t = 0.02 * np.arange(1000)
    model = StateSpace([[2000.0]], [[4.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
    y = 0.1 * np.random.default_rng(1).standard_normal((1000, 1))
    seen = validate({OUTPUT_ERROR: model}, Record(t, y, y, ("lat",), ("p",), "lost"), horizon=1.0)
    drawn = chain(
        drawings.draw_histories(seen, {}),
        drawings.draw_rms(seen),
        drawings.draw_whiteness(replace(seen, horizon=(np.inf,)), OUTPUT_ERROR),
        drawings.draw_qualification(qualify(seen), {}),
    )
    _, rms, whiteness, _ = (json.loads(interactive(each.figure)) for each in drawn)
    assert rms["data"][0]["y"] == [1.0]
    assert np.isnan(numbers(whiteness["data"][0]["y"])).all()


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
