"""Figures of a study: every ``plot_*`` function draws on axes it is given and returns them.

The layout follows M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency
domain approach": frequency responses (Figs. 1-8), time histories (9-10), RMS bars (11).
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, MaxNLocator, MultipleLocator, NullLocator

from casid.arrays import Array, ComplexArray
from casid.channels import UNITS
from casid.excitations import LITTLE, Excitation
from casid.fit import AnyFit
from casid.frequency.response import FrequencyResponse
from casid.goodness_of_fit import BAND
from casid.linear import StateSpace
from casid.report.content import BASELINE, BLACK_BOX, CHOSEN, MATCH, OUTPUT_ERROR
from casid.samples import SLOWER, at_instants, autocorrelation, usual_interval
from casid.subspace.pbsid import BlackBox
from casid.undermodelling import Undermodelling
from casid.validation import Validation

MEASURED = "measured"

DASH_DOT_DOT = (0, (7, 1, 1, 1, 1, 1))
# Okabe and Ito's palette, told apart without colour by dash and by lightness.
STYLES: Mapping[str, dict[str, Any]] = {
    MEASURED: {"color": "#000000", "linestyle": "-", "linewidth": 1.0},
    BLACK_BOX: {"color": "#0072B2", "linestyle": "-", "linewidth": 1.8},
    MATCH: {"color": "#E69F00", "linestyle": (0, (5, 1.5)), "linewidth": 1.6},
    OUTPUT_ERROR: {"color": "#D55E00", "linestyle": (0, (4, 1, 1, 1)), "linewidth": 1.6},
    BASELINE: {"color": "#009E73", "linestyle": (0, (1, 1)), "linewidth": 1.6},
    CHOSEN: {"color": "#CC79A7", "linestyle": DASH_DOT_DOT, "linewidth": 1.6},
}
LONG = 200.0  # ratio of frequencies
BEFORE = 1000.0  # durations of a record that a clock began before it, and ticks still show all
HATCHES = ("", "///", "...", "xxx", "\\\\\\")


def style(name: str, among: Iterable[str] = ()) -> dict[str, Any]:
    """Line style of a model, the same in every figure.

    Names that are not the chain's take, in their order ``among`` those drawn together, the styles
    that these leave; thin grey where none is left.
    """
    if name in STYLES:
        return dict(STYLES[name])
    drawn = list(among)
    left = [look for known, look in STYLES.items() if known not in (MEASURED, *drawn)]
    others = dict(zip([each for each in drawn if each not in STYLES], left, strict=False))
    return dict(others.get(name, {"color": "#777777", "linestyle": "-", "linewidth": 1.2}))


def axis_label(channel: str, units: Mapping[str, str]) -> str:
    """Name of a channel with its unit, if that is known."""
    return f"{channel} [{units[channel]}]" if channel in units else channel


def decibel(G: ComplexArray | Array) -> Array:
    """20 log10 |G|."""
    return np.asarray(20 * np.log10(np.maximum(np.abs(G), 1e-300)))


def phase(G: ComplexArray, near: Array | None = None) -> Array:
    """Phase [deg], unwrapped along the first axis and moved by whole turns towards ``near``."""
    there = np.isfinite(G)
    if not there.any():
        return np.full(G.shape, np.nan)
    angle = np.full(G.shape, np.nan)
    angle[there] = np.degrees(np.unwrap(np.angle(G[there])))
    gap = np.nanmedian(angle if near is None else angle - near)
    return np.asarray(angle - 360 * np.round(gap / 360))


def plot_magnitude(
    ax: Axes, omega: Array, G: ComplexArray | Array, *, name: str, among: Iterable[str] = ()
) -> Axes:
    """Draw the magnitude of one response G (K,) in dB over ω [rad/s]; ``among`` as in `style`."""
    _logarithmic(ax).plot(omega, decibel(G), label=name, **style(name, among))
    ax.set_ylabel("magnitude [dB]")
    return ax


def plot_magnitudes(
    axes: Any,  # noqa: ANN401 - an array of Axes
    channels: FrequencyResponse | StateSpace | Undermodelling,
    pairs: Sequence[tuple[str, str]],
    omega: Array,
    G: ComplexArray | Array,
    width: Array,
    name: str,
) -> Any:  # noqa: ANN401
    """Draw magnitudes (K, ny, nu) with bands of a relative width, each pair on axes of its own."""
    for ax, (output, channel) in zip(axes, pairs, strict=True):
        place = slice(None), channels.outputs.index(output), channels.inputs.index(channel)
        low, high = (decibel(G[place]) + decibel(1 + sign * width[place]) for sign in (-1, 1))
        ax.fill_between(omega, low, high, color="#000000", alpha=0.15, linewidth=0)
        plot_magnitude(ax, omega, G[place], name=name)
        ax.set_title(f"{output} / {channel}", loc="left", fontsize=7)
        ax.set_ylabel("")
        frequency_axis(ax, omega[0], omega[-1])
    grid = axes.reshape(-1, len({channel for _, channel in pairs}))
    for ax in grid[:, 0]:
        ax.set_ylabel("[dB]")
    for ax in grid[-1]:
        ax.set_xlabel("ω [rad/s]")
    return axes


def plot_phase(
    ax: Axes,
    omega: Array,
    G: ComplexArray,
    *,
    name: str,
    near: Array | None = None,
    among: Iterable[str] = (),
) -> Axes:
    """Draw the phase of one response G (K,) in degrees over ω [rad/s]; ``among`` as in `style`."""
    _logarithmic(ax).plot(omega, phase(G, near), label=name, **style(name, among))
    ax.set_ylabel("phase [deg]")
    return ax


def _logarithmic(ax: Axes) -> Axes:
    """An axis of frequencies; setting the scale anew for every curve costs more than the curves."""
    if ax.get_xscale() != "log":
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(
            "{x:g}"
        )  # a power of ten is a formula, whose setting takes long
    return ax


def frequency_axis(ax: Axes, low: float, high: float) -> Axes:
    """Limit an axis of frequencies [rad/s] and mark it 1, 2, 5, 10, a long one 1, 10, 100."""
    decades = 10.0 ** np.arange(-6, 7)
    ticks = (decades[:, None] * ([1, 2, 5] if high < LONG * low else [1])).ravel()
    ticks = ticks[(ticks >= 0.999 * low) & (ticks <= 1.001 * high)]
    ax.xaxis.set_major_locator(FixedLocator(ticks.tolist()))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xlim(low, high)
    return ax


def phase_axis(ax: Axes, low: float, high: float) -> Axes:
    """Limit an axis of phases [deg] and mark it in whole parts of a turn."""
    steps = [step for step in (15, 30, 45, 90, 180, 360) if (high - low) / step <= 4]
    step = steps[0] if steps else 720
    ax.yaxis.set_major_locator(MultipleLocator(step))
    ax.set_ylim(low - 0.1 * step, high + 0.1 * step)
    return ax


def plot_measured(
    magnitude: Axes,
    angle: Axes,
    measured: FrequencyResponse,
    pair: tuple[int, int],
    *,
    near: tuple[Array, Array] | None = None,
) -> tuple[Axes, Axes]:
    """Draw a measured response with its ±2σ band.

    Parameters
    ----------
    magnitude, angle : Axes
        For dB and for degrees.
    measured : FrequencyResponse
        With the random error of every pair.
    pair : (int, int)
        Output and input.
    near : pair of (K,) array
        Frequencies and phase [deg] of a response whose turn to take.
    """
    i, j = pair
    omega, G, error = measured.omega, measured.G[:, i, j], measured.error[:, i, j]
    reference = None if near is None else np.interp(omega, *near)
    angles = phase(G, reference)
    spread = np.minimum(2 * error, 0.99)
    low, high = decibel(G) + decibel(1 - spread), decibel(G) + decibel(1 + spread)
    look: dict[str, Any] = {"color": "#000000", "alpha": 0.15, "linewidth": 0}
    magnitude.fill_between(omega, low, high, label="measured ±2σ", **look)
    _logarithmic(magnitude).plot(omega, decibel(G), label=MEASURED, **style(MEASURED))
    width = np.degrees(np.arcsin(spread))
    angle.fill_between(omega, angles - width, angles + width, **look)
    _logarithmic(angle).plot(omega, angles, **style(MEASURED))
    return magnitude, angle


def plot_coherence(ax: Axes, measured: FrequencyResponse, pair: tuple[int, int]) -> Axes:
    """Draw the partial coherence of one pair over ω [rad/s]; 0.6 is the usual limit of use."""
    i, j = pair
    _logarithmic(ax).plot(measured.omega, measured.coherence[:, i, j], **style(MEASURED))
    ax.axhline(0.6, color="#777777", linewidth=0.8, linestyle=":")
    ax.set(ylim=(0, 1.05), ylabel="γ² [-]")
    ax.yaxis.set_major_locator(MultipleLocator(0.5))
    return ax


def plot_history(
    ax: Axes,
    t: Array,
    measured: Array,
    simulated: Mapping[str, Array],
    *,
    channel: str,
    units: Mapping[str, str] = UNITS,
) -> Axes:
    """Draw one measured output and its simulations over time.

    Parameters
    ----------
    ax : Axes
    t : (N,) array
        Instants [s].
    measured : (N,) array
        The record; NaN is a gap, except between samples of a slower channel.
    simulated : mapping to (N,) array
        By name of model.
    channel : str
        Name of the output.
    units : mapping
        Unit by channel; those of the usual names unless given.
    """
    ax.plot(
        t, joined_samples(t, measured), label=MEASURED, **(style(MEASURED) | {"linewidth": 1.6})
    )
    for name, y in simulated.items():
        ax.plot(t, y, label=name, **(style(name, simulated) | {"linewidth": 1.1}))
    ax.set_ylabel(axis_label(channel, units))
    return ax


def joined_samples(t: Array, x: Array) -> Array:
    """A channel (N,) with straight lines between its own samples where those are rarer than t."""
    own = t[np.isfinite(x)]
    if len(own) < 4 or usual_interval(own) < SLOWER * usual_interval(t):
        return x
    return at_instants(t, x, t, "foh")


def elapsed(t: Array) -> tuple[Array, str]:
    """Instants (N,) as a figure shows them, [s], with the words of the axis.

    From the first on where a clock began so long before, as in 1970, that its digits hide them.
    """
    if abs(t[0]) <= BEFORE * (t[-1] - t[0]):
        return t, "t [s]"
    return t - t[0], "t from start [s]"


def plot_input(
    ax: Axes, t: Array, u: Array, *, channel: str, units: Mapping[str, str] = UNITS
) -> Axes:
    """Draw one input over time."""
    ax.plot(t, joined_samples(t, u), **style(MEASURED))
    ax.set_ylabel(axis_label(channel, units))
    return ax


def plot_rms(ax: Axes, validation: Validation, *, record: int = 0) -> Axes:
    """Draw the RMS error of each model and output, divided by the largest among the models."""
    outputs, names = validation.outputs, validation.models
    width = 0.8 / len(names)
    at = np.arange(len(outputs))
    for k, name in enumerate(names):
        ax.bar(
            at + (k - (len(names) - 1) / 2) * width,
            validation.normalised[name][record],
            width,
            label=name,
            color=style(name, names)["color"],
            hatch=HATCHES[k % len(HATCHES)],
            edgecolor="white",
            linewidth=0.4,
        )
    ax.set_xticks(at, outputs)
    ax.set(ylabel="RMS error / largest [-]", ylim=(0, 1.05))
    return ax


def plot_singular_values(ax: Axes, black_box: BlackBox) -> Axes:
    """Draw the singular values of the predicted future; the chosen order is marked."""
    values = np.asarray(black_box.singular_values)[: 3 * black_box.system.nx]
    order = np.arange(1, len(values) + 1)
    ax.semilogy(order, values, "o", markersize=3.5, color=style(BLACK_BOX)["color"])
    ax.axvline(black_box.system.nx + 0.5, color="#777777", linestyle=":", linewidth=1)
    ax.set(xlabel="index [-]", ylabel="singular value [-]")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    return ax


def plot_excitation(ax: Axes, found: Excitation, channel: int) -> Axes:
    """Draw the share of one input from outside, with its upper bound, over its band."""
    inside = found.within[:, channel]
    omega = found.omega[inside]
    lower, upper = found.lower[inside, channel], found.upper[inside, channel]
    color = style(BLACK_BOX)["color"]
    ax.fill_between(omega, lower, upper, color=color, alpha=0.2, linewidth=0, label="at most")
    ax.semilogx(omega, lower, color=color, label="from outside")
    if len(band := found.omega[found.within.any(axis=1)]) > 1:
        frequency_axis(ax, band[0], band[-1])
    ax.axhline(LITTLE, color="#777777", linestyle=":", linewidth=1)
    ax.set(xlabel="frequency [rad/s]", ylabel=f"{found.inputs[channel]} [-]", ylim=(0, 1.02))
    return ax


def plot_match_error(ax: Axes, fit: AnyFit) -> Axes:
    """Draw the singular values of the weighted matching error against the certificate."""
    # Of every source over its band, the largest in full and the others thin; the points that were
    # matched, the bound over the band, and the frequency that holds the optimum.
    certificate = fit.certificate
    if certificate is None:
        raise ValueError(f"a fit by {fit.method} has no certificate: draw that of a match")
    color = style(MATCH)["color"]
    for source in fit.notes.sources:
        omega, sigma = source.omega, source.sigma
        _logarithmic(ax).plot(omega, sigma[:, 1:], color=color, linewidth=0.6, alpha=0.7)
        _logarithmic(ax).plot(omega, sigma[:, 0], color=color, linewidth=1.6, label=source.name)
        matched = np.interp(source.grid, omega, sigma[:, 0])
        ax.plot(source.grid, matched, "o", color=color, markersize=2.5)
    ax.axhline(certificate.upper_bound, color="#000000", linestyle="--", linewidth=1, label="bound")
    peak = fit.notes.peak
    label = f"{peak.output} from {peak.input}"
    ax.axvline(peak.omega, color="#777777", linestyle=":", linewidth=1, label=label)
    ax.set(xlabel="ω [rad/s]", ylabel="singular value [-]", ylim=(0, 1.1 * certificate.upper_bound))
    return ax


def plot_poles(ax: Axes, systems: Mapping[str, StateSpace]) -> Axes:
    """Draw the eigenvalues of continuous models."""
    marks = ("o", "s", "D", "^", "v")
    for k, (name, system) in enumerate(systems.items()):
        poles = system.poles()
        look: dict[str, Any] = {
            "color": style(name, systems)["color"],
            "markerfacecolor": "none",
            "linestyle": "none",
        }
        ax.plot(poles.real, poles.imag, marks[k % len(marks)], label=name, **look)
    ax.axvline(0, color="#777777", linewidth=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.set(xlabel="real part [1/s]", ylabel="imaginary part [1/s]")
    return ax


def plot_autocorrelation(ax: Axes, residual: Array, dt: float, *, name: str, lags: int) -> Axes:
    """Draw a residual's autocorrelation over lag [s] with the 99 % band of a white sequence."""
    e = residual[np.isfinite(residual)]
    values = np.full(lags + 1, np.nan)  # of lags that what is known does not reach
    if len(e):
        reach = min(lags, len(e) - 1)
        values[: reach + 1] = autocorrelation(e, reach)
        band = BAND / np.sqrt(len(e))
        ax.axhspan(-band, band, color="#777777", alpha=0.12, linewidth=0)
    ax.plot(dt * np.arange(lags + 1), values, label=name, **style(name))
    ax.set(ylim=(-1.05, 1.05), ylabel="autocorrelation [-]")
    return ax


def output_groups(outputs: Sequence[str], size: int = 3) -> list[tuple[str, ...]]:
    """Outputs in the groups a figure shows: accelerations, attitudes, rates, speeds, the rest."""
    known = (("ax", "ay", "az"), ("phi", "theta", "psi"), ("p", "q", "r"), ("u", "v", "w"))
    found = [tuple(name for name in group if name in outputs) for group in known]
    rest = [name for name in outputs if not any(name in group for group in known)]
    found += [tuple(rest[i : i + size]) for i in range(0, len(rest), size)]
    return [group for group in found if group]


def input_pairs(inputs: Sequence[str]) -> list[tuple[str, ...]]:
    """Inputs two by two: collective and lateral, pedal and longitudinal, as in the paper."""
    paper = ("col", "lat", "ped", "lon")
    order = [name for name in paper if name in inputs]
    order += [name for name in inputs if name not in paper]
    return [tuple(order[i : i + 2]) for i in range(0, len(order), 2)]
