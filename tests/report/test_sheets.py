"""Axes for a figure: those given if they fit, else new ones."""

import matplotlib.pyplot as plt
import pytest

from casid.report.sheets import as_given, known, new_axes


@pytest.fixture(autouse=True)
def _closed():
    plt.switch_backend("Agg")
    yield
    plt.close("all")


def test_axes_are_those_given_if_there_are_as_many_as_needed():
    _, axes = plt.subplots(2)
    assert [*new_axes(axes, 2, 1, height=1.0)] == [*axes]
    assert as_given(axes[0], [axes[0]]) is axes[0]
    with pytest.raises(ValueError, match=r"6 axes, 2 given: pass plt.subplots\(3, 2\)"):
        new_axes(axes, 3, 2, height=1.0)
    with pytest.raises(ValueError, match="ax holds 'left', expected Axes"):
        new_axes("left", 1, 1, height=1.0)


def test_new_axes_grow_with_their_rows():
    low, high = (new_axes(None, rows, 1, height=1.5)[0].figure for rows in (1, 3))
    assert high.get_figheight() - low.get_figheight() == pytest.approx(3.0)


def test_names_asked_for_are_known_and_none_means_all():
    assert known((), ("lat", "p")) == ("lat", "p")
    assert known(("p",), ("lat", "p")) == ("p",)
    with pytest.raises(ValueError, match="no channel 'q'; there are lat, p"):
        known(("q",), ("lat", "p"))
