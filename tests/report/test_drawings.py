"""Figures put together: units, labels, paper."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from truths.pages import draw, shown

from casid import StateSpace
from casid.channels import units_of
from casid.report import (
    write_report,
)
from casid.report.drawings import draw_poles, with_states


@pytest.mark.slow
def test_every_figure_names_the_unit_of_every_axis(content):
    for drawing in draw(content):
        for ax in drawing.figure.axes:
            labels = [ax.get_ylabel()] if ax.get_ylabel() else []
            if ax.xaxis.get_tick_params().get("labelbottom", True) and ax.get_xlabel():
                labels.append(ax.get_xlabel())
            assert all(re.search(r"\[.+\]", label) for label in labels), (drawing.name, labels)
        assert any(ax.get_ylabel() for ax in drawing.figure.axes)


@pytest.mark.slow
def test_a_stick_in_degrees_is_shown_in_radians(content, tmp_path):
    angle = dataclasses.replace(content, units=units_of({"lat": "deg"}))
    labels = [ax.get_ylabel() for drawing in draw(angle) for ax in drawing.figure.axes]
    assert "lat\n[rad]" in labels
    assert "lat rad." in write_report(angle, shown(angle), tmp_path).read_text(encoding="utf-8")


@pytest.mark.slow
def test_no_label_covers_another_or_leaves_the_paper(content):
    for drawing in draw(content):
        canvas = FigureCanvasAgg(drawing.figure)
        canvas.draw()
        paper, pen = drawing.figure.bbox, canvas.get_renderer()
        names, ticks = [], []
        for ax in drawing.figure.axes:
            if ax.yaxis.get_visible():  # drawn by itself, not for a sheet
                names.append(ax.yaxis.label.get_window_extent(pen))
                inside = ax.get_ylim()
                ticks += [tick.label1.get_window_extent(pen) for tick in ax.yaxis.get_major_ticks()
                          if inside[0] <= tick.get_loc() <= inside[1]]  # fmt: skip
            elif ax.get_visible():
                for text in (text for text in ax.texts if text.get_text()):
                    place = names if text.get_rotation() == 90 else ticks
                    place.append(text.get_window_extent(pen))
        assert names, drawing.name
        for name in names:
            assert name.x0 >= paper.x0, drawing.name
            assert name.count_overlaps([*names, *ticks]) == 1, drawing.name  # itself


@pytest.mark.parametrize("growing", [0.1, 1.08, 1.95, 7.0])
def test_no_slow_eigenvalue_is_outside_the_enlarged_plane(growing):
    unstable = StateSpace(np.diag([-1.97, growing]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    (drawing,) = draw_poles(SimpleNamespace(models={"one": unstable}))
    left, right = drawing.figure.axes[1].get_xlim()
    assert left < -1.97
    assert right > growing or growing > 2.0
    assert right <= 2.2  # enlarged


@pytest.mark.parametrize("states", [(), ("r",), ("r", "p")])
def test_states_beside_the_outputs_become_outputs_be_there_any_or_none(states):
    system = StateSpace(
        A=np.diag([-1.0, -2.0]), B=np.eye(2), C=np.eye(2), D=np.zeros((2, 2)),
        inputs=("lat", "ped"), outputs=("p", "r"), states=("p", "r"),
    )  # fmt: skip
    shown = with_states(system, states)
    omega = np.array([0.5, 3.0])
    found, whole = shown.response(omega), system.response(omega)
    assert found.shape == (2, len(states), 2)
    for i, name in enumerate(states):
        np.testing.assert_allclose(found[:, i], whole[:, "pr".index(name)])
