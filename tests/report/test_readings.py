"""The figure of a handling-qualities reading."""

import matplotlib.pyplot as plt
import pytest
from truths.attitudes import response, roll

from casid.baseline.handling import handling_qualities
from casid.report import plot_handling_qualities


@pytest.mark.parametrize("kind", ["attitude", "loop"])
def test_the_figure_marks_what_was_read(kind):
    figure, (magnitude, angle) = plt.subplots(2, 1)
    read = handling_qualities(response(roll), ("phi", "lat"), kind=kind)
    plot_handling_qualities(magnitude, angle, read)
    marks = [line.get_xdata()[0] for ax in (magnitude, angle) for line in ax.lines
             if line.get_marker() == "o"]  # fmt: skip
    wanted = (
        [read.crossover, read.omega_180] if kind == "loop"
        else [read.bandwidth_phase, read.omega_180, read.bandwidth_gain]
    )  # fmt: skip
    assert sorted(marks) == pytest.approx(sorted(wanted))
    assert f"{read.bandwidth:.2f}" in magnitude.get_title() or kind == "loop"
    plt.close(figure)
