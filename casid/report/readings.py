"""The figure of a handling-qualities reading: what was read, where, on which definition."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from casid.baseline.handling import HandlingQualities
from casid.report.figures import frequency_axis, phase_axis

MARK: dict[str, Any] = {"color": "#D55E00", "linewidth": 0.9}


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
    magnitude.set(ylabel="gain [dB]", title=_title(read))
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


def _title(read: HandlingQualities) -> str:
    if read.kind == "loop":
        verdict = {True: "satisfactory", False: "not satisfactory", None: "not all in the band"}
        return f"{read.output}/{read.input}, open loop, margins {verdict[read.satisfactory]}"
    delay = "" if np.isnan(read.phase_delay) else f", phase delay {read.phase_delay:.3f} s"
    return f"{read.output}/{read.input}, bandwidth {read.bandwidth:.2f} rad/s{delay} (ADS-33)"
