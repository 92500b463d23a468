"""Bands, points and loci over speed are where the numbers say."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from casid import Envelope
from casid.report.envelopes import plot_derivatives, plot_loci

NAMES = ("q' by w", "q' by lon")
OVER = Envelope(
    speed=np.array([20.0, 40.0]),
    names=NAMES,
    values=np.array([[-0.1, 3.0], [-0.2, 5.0]]),
    std_error=np.array([[0.01, 0.5], [0.02, 0.25]]),
    poles=np.array([[-1.0 + 1j, -1.0 - 1j], [-2.0 + 2j, -2.0 - 2j]]),
    beyond=np.zeros(2, dtype=bool),
)
LOCAL = replace(
    OVER,
    speed=np.array([30.0]),
    values=np.array([[-0.15, 4.5]]),
    std_error=np.full((1, 2), 0.1),
    poles=OVER.poles[:1],
)


def test_the_band_is_that_of_95_percent_and_local_fits_have_bars():
    axes = Figure().subplots(2)
    plot_derivatives(axes, replace(OVER, local=LOCAL))
    titles = [f"{NAMES[0]} [rad/s² per m/s]", f"{NAMES[1]} [rad/s² per travel]"]
    assert [ax.get_title(loc="left") for ax in axes] == titles
    edges = axes[1].collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(edges[:, 1].max(), 5 + 1.96 * 0.25, rtol=1e-3)
    point, _, (bars,) = axes[1].containers[0]
    assert point.get_xydata().tolist() == [[30.0, 4.5]]
    np.testing.assert_allclose(np.ptp(bars.get_segments()[0][:, 1]), 2 * 1.96 * 0.1, rtol=1e-3)


def test_loci_end_in_a_mark_at_the_highest_speed():
    ax = plot_loci(Figure().subplots(), replace(OVER, local=LOCAL))
    marks = [line.get_xydata().tolist() for line in ax.lines if line.get_marker() == "o"]
    assert marks == [[[-2.0, 2.0]], [[-2.0, -2.0]]]
    assert "20 to 40 m/s" in ax.get_title(loc="left")
    local = next(line for line in ax.lines if line.get_marker() == "x")
    assert local.get_xydata().tolist() == [[-1.0, 1.0], [-1.0, -1.0]]
