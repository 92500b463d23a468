"""Figures of values: what is drawn is what the value holds, on the axes given or on new ones."""

import os
import subprocess
import sys
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from truths.shown import Roll, record, values

from casid import Design, StateSpace, compare
from casid.design.plan import Alternative


@pytest.fixture(autouse=True)
def _closed():
    plt.switch_backend("Agg")
    yield
    plt.close("all")


def first(axes):
    return np.atleast_1d(np.asarray(axes, dtype=object)).ravel()[0]


NAMES = ("Identification", "Multistart", "Distortion", "Log")
TABLES = (*NAMES, "ModeBand", "HandlingBand", "Identifiability", "KinematicCheck", "Inspection")


@pytest.mark.parametrize("name", TABLES)
def test_what_is_a_table_says_so_when_asked_for_a_figure(name):
    with pytest.raises(TypeError, match=f"{name} has no figure; casid.summary prints its table"):
        values()[name].plot()


@pytest.mark.second
@pytest.mark.parametrize("name", [name for name in values() if name not in TABLES])
def test_every_value_draws_itself_on_new_axes(name):
    figure = first(values()[name].plot()).figure
    figure.canvas.draw()
    assert any(ax.lines or ax.patches or ax.collections or ax.images for ax in figure.axes)


@pytest.mark.parametrize("name", ["BlackBox", "Fit", "BoundsComparison", "Profile", "Ensemble"])
def test_a_figure_of_one_sheet_takes_the_axes_given(name):
    _, ax = plt.subplots()
    assert values()[name].plot(ax) is ax


def test_a_low_order_system_is_drawn_over_what_it_was_fitted_to():
    found, measured = values()["TransferFunction"], values()["FrequencyResponse"]
    lines = {line.get_label(): line for line in found.plot()[0].lines}
    omega = lines["measured"].get_xdata()
    there = np.searchsorted(measured.omega, omega)
    np.testing.assert_allclose(
        lines["measured"].get_ydata(), 20 * np.log10(np.abs(measured.G[there, 0, 0])), atol=1e-9
    )
    (b,), (_, a) = found.numerator, found.denominator
    np.testing.assert_allclose(  # by hand
        lines["fit"].get_ydata(), 20 * np.log10(np.abs(b / (1j * omega + a))), atol=1e-6
    )


def test_a_system_draws_its_response_around_its_poles():
    line = values()["StateSpace"].plot().lines[0]
    omega = line.get_xdata()
    assert omega[[0, -1]] == pytest.approx([0.25, 25.0])
    np.testing.assert_allclose(line.get_ydata(), 20 * np.log10(5 / np.abs(1j * omega + 2.5)))
    discrete = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    assert discrete.plot().lines[0].get_xdata()[-1] == pytest.approx(np.pi / 0.1)
    still = StateSpace(np.zeros((1, 1)), [[1.0]], [[1.0]], [[0.0]])
    assert np.isfinite(still.plot().lines[0].get_ydata()).all()


def test_distances_are_written_in_a_grid_of_pairs_and_bands():
    found = values()["Distances"]
    ax = found.plot()
    assert [text.get_text() for text in ax.texts] == [f"{x.structure:.2g}σ" for x in found.rows]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["p / lat"]


def test_a_record_draws_its_channels():
    _, axes = plt.subplots(2)
    record().plot(axes)
    np.testing.assert_array_equal(axes[1].lines[0].get_ydata(), record().y[:, 0])
    assert record().plot(channels=("p",)).get_ylabel() == "p [rad/s]"
    with pytest.raises(ValueError, match=r"2 axes, 1 given: pass plt.subplots\(2, 1\)"):
        record().plot(axes[0])
    with pytest.raises(ValueError, match="no channel 'q'; there are lat, p"):
        record().plot(channels=("q",))


def test_comparisons_draw_each_model_over_the_measurement():
    fit, box = values()["Fit"], values()["BlackBox"]
    axes = compare({"fit": fit, "black box": box, "guess": Roll()}, record())
    labels = [text.get_text() for text in first(axes).get_legend().get_texts()]
    assert [label.split()[0] for label in labels] == ["measured", "fit", "black", "guess"]
    axes = compare({"fit": fit}, values()["FrequencyResponse"])
    drawn = {line.get_label(): line for line in axes[0].lines}
    omega = drawn["fit"].get_xdata()
    G = fit["Llat"].value / (1j * omega - fit["Lp"].value)  # by hand
    np.testing.assert_allclose(drawn["fit"].get_ydata(), 20 * np.log10(abs(G)), atol=1e-9)
    with pytest.raises(ValueError, match="no models given"):
        compare({}, record())
    with pytest.raises(ValueError, match="ax holds 3, expected Axes"):
        compare({"fit": fit}, record(), ax=[3, 3])
    with pytest.raises(ValueError, match="a pair is of a frequency response"):
        compare({"fit": fit}, record(), pair=("p", "lat"))
    with pytest.raises(ValueError, match="no pair"):
        compare({"fit": fit}, values()["FrequencyResponse"], pair=("q", "lat"))


def test_a_design_draws_its_errors_over_those_of_the_first_alternative():
    t, errors = np.linspace(0, 4, 41), np.array([2.0, 5.0])
    ways = {"3-2-1-1": errors, "steps": errors * [0.5, 0.2]}
    design = Design(
        kind="steps", inputs=("lat",), outputs=("p",), t=t, r=t[:, None], u=t[:, None],
        y=t[:, None], names=("Lp", "Llat"), values=errors, covariance=np.eye(2), before=errors,
        used={}, used_at_worst={},
        alternatives=tuple(
            Alternative(name=n, r=t[:, None], std_errors=e) for n, e in ways.items()
        ),
    )  # fmt: skip
    ax = design.plot(errors=True)
    drawn = {line.get_label(): line.get_ydata().tolist() for line in ax.lines}
    assert drawn == {"3-2-1-1": [1, 1], "steps": [0.5, 0.2]}
    assert [label.get_text() for label in ax.get_xticklabels()] == ["Lp", "Llat"]


def test_a_design_draws_sticks_and_outputs_with_their_limits():
    t = np.linspace(0, 4, 41)
    signal = np.sin(t)[:, None]
    design = Design(
        kind="steps", inputs=("lat",), outputs=("p",), t=t, r=0.5 * signal, u=signal, y=2 * signal,
        names=("Lp",), values=np.ones(1), covariance=np.eye(1), before=np.ones(1), alternatives=(),
        used={"p": 0.5}, used_at_worst={"p": 0.5}, limits={"p": 4.0},
    )  # fmt: skip
    axes = design.plot()
    labels = [line.get_label() for line in axes[0].lines]
    assert "card, before feedback" in labels
    edges = [line.get_ydata()[0] for line in axes[1].lines if len(line.get_ydata()) == 2]
    assert edges == [-4.0, 4.0]


@pytest.mark.second
def test_what_a_backend_sets_when_it_is_loaded_outlasts_the_first_figure(tmp_path):
    # That of notebooks makes pyplot interactive; otherwise later figures are not shown.
    (tmp_path / "like_notebooks.py").write_text(
        "import matplotlib\n"
        "from matplotlib.backends.backend_agg import FigureCanvas\n"
        "matplotlib.interactive(True)\n",
        encoding="utf-8",
    )
    program = "import matplotlib, truths.shown; truths.shown.record().plot(); "
    program += "assert matplotlib.is_interactive()"
    path = os.pathsep.join([str(tmp_path), *sys.path])
    own = os.environ | {"MPLBACKEND": "module://like_notebooks", "PYTHONPATH": path}
    subprocess.run([sys.executable, "-c", program], check=True, env=own, timeout=100)


def test_scores_and_singular_values_have_axes_of_their_own():
    scores, singular = values()["OrderSelection"].plot()
    assert scores.get_position().y0 == singular.get_position().y0
    assert not scores.get_shared_x_axes().joined(scores, singular)
    assert (scores.get_xlabel(), singular.get_xlabel()) == ("order [-]", "index [-]")


def test_histories_of_a_clock_since_1970_are_drawn_from_their_start():
    flown = replace(record(), t=record().t + 1780358400.0)
    for drawn in (flown.plot(), compare({"guess": Roll()}, flown)):
        axes = np.atleast_1d(drawn)
        assert axes.flat[-1].get_xlabel() == "t from start [s]"
        for ax in axes.flat:
            np.testing.assert_allclose(ax.lines[0].get_xdata(), record().t, atol=1e-6)
        plt.close("all")
