"""Figures of a design: sticks and responses within their limits, and what the flight buys."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

from casid.channels import UNITS
from casid.design.plan import Design
from casid.display import listed
from casid.report import figures
from casid.report.prices import COLOURS

GREY = "#777777"


def plot_card(axes: Sequence[Axes], design: Design) -> None:
    """Sticks and outputs that the model predicts, one axes a channel, with their limits."""
    for j, each in enumerate(axes[: len(design.inputs)]):
        if not np.allclose(design.r[:, j], design.u[:, j]):  # feedback adds to what is designed
            label = "card, before feedback"
            line = each.plot(design.t, design.r[:, j], color=GREY, linestyle=":", label=label)
            over = axes[0].legend(handles=line, loc="lower right", fontsize="x-small")
            over.set_bbox_to_anchor((1.0, 1.0))
    names, flown = (*design.inputs, *design.outputs), np.hstack([design.u, design.y])
    for each, name, signal in zip(axes, names, flown.T, strict=True):
        figures.plot_input(each, design.t, signal, channel=name, units=UNITS)
        if limit := design.limits.get(name):
            for edge in (-limit, limit):
                each.axhline(edge, color=GREY, linestyle="--", linewidth=0.6)
    axes[-1].set_xlabel("t [s]")


def plot_errors(ax: Axes, design: Design) -> Axes:
    """Predicted standard errors over those of the 3-2-1-1, of each parameter that is told."""
    told = [k for k, name in enumerate(design.names) if name not in design.untold]
    usual, place = design.alternatives[0].std_errors[told], np.arange(len(told))
    for k, each in enumerate(design.alternatives):
        marker = "-" if k == 0 else "o"
        ax.plot(place, each.std_errors[told] / usual, marker, color=COLOURS[k], label=each.name)
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FormatStrFormatter("%.3g"))
    ax.set_ylabel("standard error over that of 3-2-1-1")
    ax.set_xticks(place, [design.names[k] for k in told], rotation=90)
    if design.untold:
        ax.set_xlabel(f"without {listed(design.untold)}, which no input identifies")
    many = len(design.alternatives)
    ax.legend(fontsize="x-small", ncols=many, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return ax
