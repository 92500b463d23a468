"""Figures of single results: handling qualities, low-order systems, distances, a chosen order."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from casid.baseline.handling import HandlingQualities
from casid.baseline.loes import TransferFunction
from casid.distances import Distances
from casid.report.content import BASELINE
from casid.report.figures import MEASURED, decibel, frequency_axis, phase, phase_axis, style
from casid.subspace.candidates import OrderSelection

MARK: dict[str, Any] = {"color": "#D55E00", "linewidth": 0.9}
MARKERS = "osD^vP*X"


def plot_handling_qualities(
    magnitude: Axes, angle: Axes, read: HandlingQualities
) -> tuple[Axes, Axes]:
    """Draw gain and phase of a reading with the places where its numbers come from.

    Parameters
    ----------
    magnitude, angle : Axes
        For dB and for degrees, over rad/s.
    read : HandlingQualities
        What `casid.handling_qualities` returned.
    """
    x = np.log(read.omega)
    name = f"{read.output}/{read.input}" + (", integrated" if read.kind == "rate" else "")
    for ax, curve in ((magnitude, read.gain_db), (angle, read.phase_deg)):
        ax.semilogx(read.omega, curve, color="#000000", linewidth=1.2, label=name)
        frequency_axis(ax, read.omega[0], read.omega[-1])
    phase_axis(angle, float(read.phase_deg.min()), float(read.phase_deg.max()))
    places = _loop(read) if read.kind == "loop" else _attitude(read)
    for number, (label, omega, on_phase) in enumerate(places):
        if not np.isfinite(omega):
            continue
        ax, curve = (angle, read.phase_deg) if on_phase else (magnitude, read.gain_db)
        ax.axvline(omega, linestyle=("-", "--", ":")[number % 3], label=label, **MARK)
        value = np.interp(np.log(omega), x, curve)
        ax.plot([omega], [value], "o", markersize=4, color=MARK["color"])
    for level in (-180.0, *(() if read.kind == "loop" else (-135.0,))):
        angle.axhline(level, color="#777777", linewidth=0.8, linestyle=":")
    above = np.interp(np.log(read.omega_180), x, read.gain_db) + 6
    level = 0.0 if read.kind == "loop" else float(above)
    magnitude.axhline(level, color="#777777", linewidth=0.8, linestyle=":")
    magnitude.set(ylabel="gain [dB]", title=read.headline())
    angle.set(ylabel="phase [deg]", xlabel="ω [rad/s]")
    for ax in (magnitude, angle):
        ax.legend(loc="lower left", fontsize="small")
    return magnitude, angle


def _attitude(read: HandlingQualities) -> list[tuple[str, float, bool]]:
    return [
        (f"phase bandwidth {read.bandwidth_phase:.2f} rad/s (-135°)", read.bandwidth_phase, True),
        (f"ω180 {read.omega_180:.2f} rad/s", read.omega_180, True),
        (f"gain bandwidth {read.bandwidth_gain:.2f} rad/s (6 dB)", read.bandwidth_gain, False),
    ]


def _loop(read: HandlingQualities) -> list[tuple[str, float, bool]]:
    return [
        (f"phase margin {read.phase_margin:.0f}° (45° wanted)", read.crossover, True),
        (f"gain margin {read.gain_margin:.1f} dB (6 dB wanted)", read.omega_180, False),
    ]


def plot_transfer_function(
    magnitude: Axes, angle: Axes, found: TransferFunction
) -> tuple[Axes, Axes]:
    """Draw the response of a low-order system over the measurement that it was fitted to."""
    fitted = found.response(found.omega)
    turn = np.radians(found.mismatch_deg)
    measured = fitted * 10 ** (-found.mismatch_db / 20) * np.exp(-1j * turn)
    for name, G in ((MEASURED, measured), (BASELINE, fitted)):
        label = name if name == MEASURED else "fit"
        magnitude.semilogx(found.omega, decibel(G), label=label, **style(name))
        angle.semilogx(found.omega, phase(G, phase(measured)), **style(name))
    magnitude.set(ylabel="magnitude [dB]", title=found.headline())
    angle.set(ylabel="phase [deg]", xlabel="ω [rad/s]")
    magnitude.legend()
    for ax in (magnitude, angle):
        frequency_axis(ax, found.omega[0], found.omega[-1])
    return magnitude, angle


def plot_distances(ax: Axes, found: Distances) -> Axes:
    """Draw in a grid of pairs and bands how many errors a structure misses.

    Marked by ! where it is at fault, in brackets where that is no evidence.
    """
    rows = found.by_pair()
    size = np.array([[each.structure for each in row] for row in rows.values()])
    ax.imshow(np.log10(np.maximum(size, 1.0)), cmap="Greys", vmin=0.0, vmax=2.5, aspect="auto")
    for y, row in enumerate(rows.values()):
        for x, each in enumerate(row):
            look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7}
            ink = "#ffffff" if each.structure > 20 else "#000000"
            ax.text(x, y, each.cell, color=ink, **look)
    ax.set_yticks(range(len(rows)), [" / ".join(pair) for pair in rows])
    ax.set_xticks(range(len(found.bands)), [f"{a:.2g}-{b:.2g}" for a, b in found.bands])
    ax.set(xlabel="band [rad/s]", title="distance of the structure to the black box")
    ax.grid(visible=False)
    return ax


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
