"""Curves, bars and bands: what each draws."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from truths.structures import SECOND, Lag, black_box

from casid import Fit, match
from casid.report import (
    BASELINE,
    BLACK_BOX,
    MATCH,
    OUTPUT_ERROR,
    plot_history,
    plot_input,
    plot_magnitude,
    plot_match_error,
    plot_measured,
    plot_phase,
    plot_rms,
)
from casid.report.figures import STYLES, decibel, elapsed, input_pairs, output_groups, phase, style
from casid.report.prices import COLOURS

MODELS = (BLACK_BOX, MATCH, OUTPUT_ERROR, BASELINE)


def axes(rows=1):
    return Figure().subplots(rows, 1, squeeze=False)[:, 0]


def test_magnitude_and_phase_of_an_integrator_are_its_textbook_ones():
    omega = np.array([0.1, 1.0, 10.0])
    G = 1 / (1j * omega)
    np.testing.assert_allclose(decibel(G), [20, 0, -20], atol=1e-12)
    np.testing.assert_allclose(phase(G), -90, atol=1e-12)
    top, bottom = axes(2)
    plot_magnitude(top, omega, G, name=BLACK_BOX)
    plot_phase(bottom, omega, G, name=BLACK_BOX)
    np.testing.assert_allclose(top.lines[0].get_ydata(), [20, 0, -20], atol=1e-12)
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("magnitude [dB]", "phase [deg]")


def test_phase_is_taken_on_the_turn_of_its_neighbour():
    omega = np.geomspace(0.1, 10, 50)
    G = np.exp(-1j * omega) / (1j * omega) ** 2
    np.testing.assert_allclose(phase(G, phase(G) + 720) - phase(G), 720, atol=1e-9)


def test_phase_passes_over_pairs_that_were_not_measured():
    G = np.array([1j, np.nan, -1.0])
    np.testing.assert_allclose(phase(G), [90, np.nan, 180])
    assert np.isnan(phase(np.full(3, np.nan + 0j))).all()


def test_a_history_keeps_the_gap_of_missing_samples():
    ax = axes()[0]
    t, y = np.arange(4.0), np.array([0.0, np.nan, 2.0, 3.0])
    assert plot_history(ax, t, y, {OUTPUT_ERROR: y}, channel="q") is ax
    assert np.isnan(ax.lines[0].get_ydata()[1])
    assert ax.get_ylabel() == "q [rad/s]"


@pytest.mark.parametrize("duration", [8.0, 60.0, 900.0])
@pytest.mark.parametrize("begins", [0.0, -3.0, 131.4, 4000.2, 20000.3, 1780358400.5])
def test_no_instant_of_a_history_hides_in_the_corner_of_its_axis(begins, duration):
    t, axis = elapsed(begins + np.linspace(0, duration, 400))
    figure = Figure(figsize=(6, 2))
    (ax,) = figure.subplots(1, 1, squeeze=False)[0]
    ax.plot(t, t)
    FigureCanvasAgg(figure).draw()
    assert ax.xaxis.get_offset_text().get_text() == ""  # what matplotlib takes out of all ticks
    assert (axis == "t [s]") == (t[0] == begins)
    assert t[-1] - t[0] == pytest.approx(duration)


def test_a_slower_channel_is_drawn_between_its_own_samples_and_stops_where_they_are_lost():
    t = np.arange(60.0)
    y = np.where((t % 2 == 0) & ~((t > 20) & (t < 30)), 0.5 * t, np.nan)
    top, bottom = axes(2)
    plot_history(top, t, y, {}, channel="q")
    drawn = top.lines[0].get_ydata()
    there = (t <= 20) | ((t >= 30) & (t <= 58))
    np.testing.assert_allclose(drawn[there], 0.5 * t[there])
    assert np.isnan(drawn[~there]).all()
    plot_input(bottom, t, y, channel="q")
    np.testing.assert_array_equal(bottom.lines[0].get_ydata(), drawn)


def test_styles_differ_in_dash_and_not_in_colour_alone():
    looks = [style(name) for name in MODELS]
    assert len({str(look["linestyle"]) for look in looks}) == len(looks)
    assert len({look["color"] for look in looks}) == len(looks)


def test_outputs_and_inputs_are_laid_out_as_in_the_paper():
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "beta")
    assert output_groups(outputs) == [
        ("ax", "ay", "az"),
        ("phi", "theta"),
        ("p", "q", "r"),
        ("beta",),
    ]
    assert input_pairs(("col", "lat", "lon", "ped")) == [("col", "lat"), ("ped", "lon")]
    assert input_pairs(("elevator", "aileron", "rudder")) == [("elevator", "aileron"), ("rudder",)]


@pytest.mark.slow
def test_rms_bars_have_the_heights_of_the_normalised_errors(content):
    ax = axes()[0]
    plot_rms(ax, content.results["validation"])
    heights = [bar.get_height() for bar in ax.containers[0]]
    np.testing.assert_allclose(heights, content.results["validation"].normalised[BLACK_BOX][0])


@pytest.mark.slow
def test_a_measured_response_lies_within_its_band(content):
    top, bottom = axes(2)
    plot_measured(top, bottom, content.results["frequency"], (0, 0))
    curve = top.lines[0].get_xydata()
    band = np.vstack([path.vertices for path in top.collections[0].get_paths()])
    measured = curve[np.isfinite(curve[:, 1])]
    assert len(measured) > 10
    for omega, value in measured:
        edges = band[np.isclose(band[:, 0], omega), 1]
        assert edges.min() <= value <= edges.max()


def test_singular_values_lie_under_the_bound_and_touch_the_grid_norm(tmp_path):
    match(Lag(), black_box(SECOND), weight=np.ones((1, 1))).save(tmp_path / "fit.json")
    fit = Fit.load(tmp_path / "fit.json", model=Lag)  # as a study kept it
    ax = plot_match_error(Figure().subplots(), fit)
    lines = {line.get_label(): line for line in ax.get_lines()}
    sigma = lines["black box"].get_ydata()
    error = fit.model.system().response(lines["black box"].get_xdata()) - SECOND.response(
        lines["black box"].get_xdata()
    )
    np.testing.assert_allclose(sigma, np.abs(error[:, 0, 0]), rtol=1e-12)
    bound = lines["bound"].get_ydata()[0]
    assert bound == fit.certificate.upper_bound
    assert sigma.max() <= bound
    assert sigma.max() == pytest.approx(fit.certificate.grid_norm, rel=0.01)
    assert lines["x from u"].get_xdata()[0] == fit.certificate.peak_omega


@pytest.mark.second
def test_a_fit_without_certificate_is_refused():
    fit = match(Lag(), black_box(SECOND))
    bare = Fit(**{name: getattr(fit, name) for name in vars(fit)} | {"certificate": None})
    with pytest.raises(ValueError, match="has no certificate"):
        plot_match_error(Figure().subplots(), bare)


# Linear RGB as seen, severity 1: G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, A
# physiologically-based model for simulation of color vision deficiency, IEEE TVCG 15 (2009), table.
SEEN = {
    "protanopia": [
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
    "all colours": np.eye(3).tolist(),
}  # fmt: skip
XYZ = [[0.4125, 0.3576, 0.1804], [0.2127, 0.7152, 0.0722], [0.0193, 0.1192, 0.9503]]  # of sRGB


def lab(colour, seen):
    """CIELAB of a colour as somebody sees it."""
    own = np.array(to_rgb(colour))
    light = np.where(own <= 0.04045, own / 12.92, ((own + 0.055) / 1.055) ** 2.4)
    x = np.array(XYZ) @ np.clip(np.array(seen) @ light, 0, 1) / np.sum(XYZ, axis=1)
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize("colours", [[look["color"] for look in STYLES.values()], COLOURS])
def test_whoever_sees_no_red_green_or_blue_tells_the_colours_apart(seen, colours):
    # 2.3 is just noticeable (Mahy and others 1994); curves a millimetre wide want some more.
    apart = [
        np.linalg.norm(lab(a, SEEN[seen]) - lab(b, SEEN[seen])) for a, b in combinations(colours, 2)
    ]
    assert min(apart) > 15


def test_models_of_any_name_look_different():
    names = ["mine", BLACK_BOX, "theirs", "older"]
    looks = [style(name, names) for name in names]
    assert len({look["color"] for look in looks}) == 4
    assert looks[1] == STYLES[BLACK_BOX]
    assert style("alone") == style("seventh", [*"abcdef", "seventh"])
