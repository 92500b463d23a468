"""The figure of how the black box's settings were chosen."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from casid.subspace.settings import OrderSelection

MARKERS = "osD^vP*X"


def plot_order_selection(axes: Sequence[Axes], selection: OrderSelection) -> Sequence[Axes]:
    """Draw the candidates' scores against the order, and singular values, on two axes."""
    # A line a pole, or refinement of samples, through the best candidate of every order, its
    # standard error as a bar; the choice is ringed. The order chosen divides the singular values.
    scores, values = axes
    chosen = selection.chosen
    kinds = dict.fromkeys(c.label for c in sorted(selection.candidates, key=lambda c: c.pole))
    for marker, label in zip(MARKERS, kinds, strict=False):
        own = [c for c in selection.candidates if c.label == label]
        of_order = [[c for c in own if c.order == n] for n in sorted({c.order for c in own})]
        found = [min(each, key=lambda c: c.score) for each in of_order]
        at, score, error = zip(*((c.order, c.score, c.error) for c in found), strict=True)
        look: dict[str, Any] = {"markersize": 4, "linewidth": 1, "elinewidth": 0.6}
        scores.errorbar(at, score, error, label=label, marker=marker, **look)
    scores.plot(chosen.order, chosen.score, "o", markersize=13, fillstyle="none", color="#000000")
    scores.set(xlabel="order [-]", ylabel=f"{selection.criterion} [-]")
    scores.legend(fontsize="small")
    shown = np.asarray(selection.singular_values)[: 3 * chosen.order]
    values.semilogy(np.arange(1, len(shown) + 1), shown, "o", markersize=3.5, color="#0072B2")
    values.axvline(chosen.order + 0.5, color="#777777", linestyle=":", linewidth=1)
    values.set(xlabel="index [-]", ylabel="singular value [-]")
    for ax in axes:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    return axes
