"""Figures over the flight envelope: derivatives with their bands and local fits, root loci."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from casid.channels import UNITS
from casid.envelope import Envelope
from casid.report.content import Drawing
from casid.report.look import LOOK, WIDTH
from casid.report.prices import CONFIDENCE

LINE, LOCAL = "#D55E00", "#000000"


def draw_envelope(found: Envelope) -> Iterator[Drawing]:
    """Derivatives over speed, one below the other, and the loci of the poles."""
    names = ", ".join(found.names)
    yield Drawing(
        name="envelope_derivatives",
        caption=f"Derivatives over speed: {names}",
        draw=partial(_derivatives, found),
    )
    yield Drawing(name="envelope_modes", caption="Poles over speed", draw=partial(_loci, found))


def _derivatives(found: Envelope) -> Figure:
    with rc_context(LOOK):
        n = len(found.names)
        figure = Figure(figsize=(WIDTH, 0.6 + 1.2 * n), layout="constrained")
        plot_derivatives(list(figure.subplots(n, sharex=True, squeeze=False)[:, 0]), found)
        return figure


def _loci(found: Envelope) -> Figure:
    with rc_context(LOOK):
        figure = Figure(figsize=(WIDTH, 3.5), layout="constrained")
        plot_loci(figure.subplots(), found)
        return figure


def plot_derivatives(axes: Sequence[Axes], value: Envelope) -> Sequence[Axes]:
    """Draw each entry over speed [m/s], with its 95 % band and the local fits as points.

    Outside what was flown the line is dashed and has no band.
    """
    flown = np.where(value.beyond, np.nan, 1.0)
    for k, (ax, name) in enumerate(zip(axes, value.names, strict=True)):
        middle, half = value.values[:, k], CONFIDENCE * value.std_error[:, k] * flown
        ax.plot(value.speed, middle * flown, color=LINE, label="scheduled")
        if value.beyond.any():
            ax.plot(value.speed, middle, "--", color=LINE, linewidth=1, label="not flown")
        ax.fill_between(
            value.speed, middle - half, middle + half, color=LINE, alpha=0.2, linewidth=0
        )
        if value.local is not None:
            own = value.local
            ax.errorbar(
                own.speed,
                own.values[:, k],
                CONFIDENCE * own.std_error[:, k],
                color=LOCAL,
                fmt="o",
                markersize=4,
                capsize=2,
                linestyle="none",
                label="local",
            )
        ax.set_title(_titled(name), loc="left")
        ax.yaxis.set_major_locator(MaxNLocator(4))
    axes[-1].set_xlabel("speed [m/s]")
    _legend(axes[0])
    return axes


def _titled(entry: str) -> str:
    """An entry's name, "q' by w", with its unit where the names of both channels say theirs."""
    state, _, by = entry.partition("' by ")
    if state not in UNITS or by not in UNITS:
        return entry
    rate = {"m/s": "m/s²", "rad/s": "rad/s²"}.get(UNITS[state], f"{UNITS[state]}/s")
    return f"{entry} [{rate} per {UNITS[by]}]"


def plot_loci(ax: Axes, value: Envelope) -> Axes:
    """Draw how the poles move with speed: lines that end in a mark where it is highest."""
    for pole in value.poles.T:
        ax.plot(pole.real, pole.imag, ".-", color=LINE, markersize=3, linewidth=1)
        ax.plot(pole.real[-1:], pole.imag[-1:], "o", color=LINE, markersize=5)
    if value.local is not None:
        poles = value.local.poles.ravel()
        ax.plot(poles.real, poles.imag, "x", color=LOCAL, linestyle="none", label="local")
        _legend(ax)
    ax.axvline(0, color="#777777", linewidth=0.8)
    ax.set_title(f"{value.speed[0]:.3g} to {value.speed[-1]:.3g} m/s (o)", loc="left")
    ax.set(xlabel="real part [rad/s]", ylabel="imaginary part [rad/s]")
    return ax


def _legend(ax: Axes) -> None:
    """The legend above the axes: within, its marks look like points or poles."""
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderaxespad=0)
