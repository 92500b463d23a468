"""Values as figures: ``value.plot()``, and `compare`, which draws several together.

Everything is drawn by the ``plot_*`` functions of `casid.report.figures`; here are the sheets.
"""

import itertools
from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.bands import ResponseBand
from casid.baseline.handling import HandlingQualities
from casid.baseline.loes import TransferFunction
from casid.bounds.compare import BoundsComparison
from casid.bounds.profiles import Profile
from casid.bounds.resampling import Ensemble
from casid.channels import UNITS
from casid.cover import Cover
from casid.design.plan import Design
from casid.distances import Distances
from casid.envelope import Envelope
from casid.excitations import Excitation
from casid.fit import Fit
from casid.frequency.response import FrequencyResponse
from casid.linear import StateSpace
from casid.qualification import Qualification
from casid.record import Record
from casid.records import Records, common_units, several
from casid.report import figures
from casid.report.content import BLACK_BOX, OUTPUT_ERROR
from casid.report.designs import plot_card, plot_errors
from casid.report.envelopes import plot_derivatives, plot_loci
from casid.report.prices import (
    CONFIDENCE,
    bounds_height,
    plot_bounds,
    plot_parameters,
    plot_profile,
)
from casid.report.readings import (
    plot_distances,
    plot_handling_qualities,
    plot_order_selection,
    plot_transfer_function,
)
from casid.report.sheets import as_given, known, new_axes, styled
from casid.residuals import Residuals
from casid.subspace.blackbox import BlackBox
from casid.subspace.candidates import OrderSelection
from casid.undermodelling import Undermodelling
from casid.validation import AnyModel, Validation, state_space, validate

SLOWEST = 1e-6  # rad/s: what is slower is an integrator
POINTS = 160  # of a response
GREY = "#777777"
ABOVE: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 0.9), "fontsize": "x-small"}


def plot(value: object, ax: Any = None, **choice: Any) -> Any:  # noqa: ANN401 - see Shown.plot
    """Draw a value on the axes given or on new ones; returns them."""
    with styled():
        return _draw(value, ax, **choice)


def compare(
    models: Mapping[str, AnyModel],
    data: FrequencyResponse | Records,
    *,
    pair: tuple[str, str] | None = None,
    channels: Sequence[str] = (),
    ax: Any = None,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Draw models over measurements; returns the axes.

    Parameters
    ----------
    models : mapping
        Name and model: `Fit`, `Model`, `BlackBox` or `StateSpace`.
    data : FrequencyResponse, Record or sequence of Record
        Over responses: magnitude, phase and coherence of one pair. Over records: time histories,
        simulated or predicted as `validate` does, the fit of each in the legend.
    pair : (str, str)
        Output and input of the response; the pair of the largest mean coherence unless given.
    channels : sequence of str
        Outputs of the records; all unless given.
    ax : Axes or sequence of Axes
        Three for a response; an output and record each for histories, outputs of the first record
        first; new ones unless given.

    Raises
    ------
    ValueError
        No model, unknown channels, another number of axes, and what `validate` raises.
    """
    if not models:
        raise ValueError('no models given; expected {"name": model, ...}')
    with styled():
        if isinstance(data, FrequencyResponse):
            systems = {name: state_space(model) for name, model in models.items()}
            return _pair(data, systems, pair or _clearest(data), ax)
        if pair is not None:
            raise ValueError(
                f"pair={pair}: a pair is of a frequency response; over records name outputs, "
                "channels=[...]"
            )
        own = [getattr(getattr(each, "model", each), "units", {}) for each in models.values()]
        own.append(common_units(several(data)))
        units = UNITS | {name: unit for named in own for name, unit in named.items()}
        return _histories(validate(models, data), channels, units, ax)


@singledispatch
def _draw(value: object, ax: Any) -> Any:  # noqa: ANN401, ARG001
    raise TypeError(f"{type(value).__name__} has no figure; casid.summary prints its table")


@_draw.register
def _(value: Record, ax: Any, channels: Sequence[str] = ()) -> Any:  # noqa: ANN401
    names = known(channels, (*value.inputs, *value.outputs))
    axes = new_axes(ax, len(names), 1, height=0.9)
    t, axis = figures.elapsed(value.t)
    for each, name in zip(axes, names, strict=True):
        own = UNITS | dict(value.units)
        figures.plot_input(each, t, value.channel(name), channel=name, units=own)
    axes[-1].set_xlabel(axis)
    return as_given(ax, axes)


@_draw.register
def _(value: Design, ax: Any, errors: bool = False) -> Any:  # noqa: ANN401
    count = 1 if errors else len(value.inputs) + len(value.outputs)
    axes = new_axes(ax, count, 1, height=2.8 if errors else 0.9)
    (plot_errors(axes[0], value) if errors else plot_card(axes, value))
    return as_given(ax, axes)


@_draw.register
def _(value: FrequencyResponse, ax: Any, pair: tuple[str, str] | None = None) -> Any:  # noqa: ANN401
    if pair is not None:
        return _pair(value, {}, pair, ax)
    width = np.minimum(2 * value.error, 0.99)
    return _magnitudes(value, value.omega, value.G, width, figures.MEASURED, None, ax)


@_draw.register
def _(value: BlackBox, ax: Any, pair: tuple[str, str] | None = None) -> Any:  # noqa: ANN401
    system, omega = value.continuous().system, np.geomspace(*value.band, POINTS)
    G = system.response(omega)
    spread = np.zeros(G.shape)
    if value.uncertainty is not None:
        spread = np.minimum(2 * value.response_std(omega)[0], 0.99)
    return _magnitudes(system, omega, G, spread, BLACK_BOX, pair, ax)


@_draw.register
def _(value: StateSpace, ax: Any, pair: tuple[str, str] | None = None) -> Any:  # noqa: ANN401
    poles = value.poles() if value.dt is None else np.log(value.poles()) / value.dt
    sizes = np.abs(poles)[np.abs(poles) > SLOWEST]
    low, high = (sizes.min(), sizes.max()) if len(sizes) else (1.0, 1.0)
    most = np.inf if value.dt is None else np.pi / value.dt
    omega = np.geomspace(low / 10, min(10 * high, most), POINTS)
    G = value.response(omega)
    return _magnitudes(value, omega, G, np.zeros(G.shape), figures.MEASURED, pair, ax)


@_draw.register
def _(value: Undermodelling, ax: Any, pair: tuple[str, str] | None = None) -> Any:  # noqa: ANN401
    std = np.where(value.std > 0, value.std, np.nan)
    return _magnitudes(value, value.omega, std, 0 * std, figures.MEASURED, pair, ax)


@_draw.register
def _(value: Fit, ax: Any, rows: int = 100) -> Any:  # type: ignore[type-arg] # noqa: ANN401
    free = [row for row in value.parameters if not row.fixed][:rows]
    axes = new_axes(ax, 1, 1, height=0.6 + 0.18 * len(free))
    plot_parameters(axes[0], free)
    axes[0].set_title(value.headline(), loc="left", wrap=True)
    return as_given(ax, axes)


@_draw.register
def _(value: Validation, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, len(value.records), 1, height=1.8)
    for k, each in enumerate(axes):
        figures.plot_rms(each, value, record=k)
        each.set_title(value.records[k], loc="left")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=len(value.models))
    return as_given(ax, axes)


@_draw.register
def _(value: BoundsComparison, ax: Any, rows: int = 16) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 1, 1, height=bounds_height(value, rows))
    plot_bounds(axes[0], value, rows=rows)
    return as_given(ax, axes)


@_draw.register
def _(value: Profile, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 1, 1, height=2.8 if len(value.names) == 1 else 4.2)
    plot_profile(axes[0], value)
    return as_given(ax, axes)


@_draw.register
def _(value: Ensemble, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 1, 1, height=0.8 + 0.22 * len(value.names))
    good = ~np.isnan(value.values).any(axis=1)
    size = np.maximum(np.nanmean(value.std_errors, axis=0), 1e-300)
    away = (value.values[good] - value.reference) / size
    axes[0].boxplot(away, orientation="horizontal", tick_labels=list(value.names), whis=(2.5, 97.5))
    for edge in (-CONFIDENCE, CONFIDENCE):
        axes[0].axvline(edge, color=GREY, linestyle=":")
    axes[0].set(xlabel="(estimate - reference) / mean standard error [-]; dotted: 95 % interval")
    axes[0].invert_yaxis()
    return as_given(ax, axes)


@_draw.register
def _(value: Residuals, ax: Any) -> Any:  # noqa: ANN401
    columns = 1 + len(value.inputs)
    axes = new_axes(ax, len(value.outputs), columns, height=1.1)
    grid = axes.reshape(len(value.outputs), columns)
    look: dict[str, Any] = {"color": GREY, "alpha": 0.15, "linewidth": 0}
    for i, row in enumerate(grid):
        curves = [value.auto[:, i], *value.cross[:, i].T]
        bands = [value.auto_band, *value.cross_band[i]]
        for each, curve, band in zip(row, curves, bands, strict=True):
            each.plot(value.lag, curve, color="#0072B2")
            each.axhspan(-band, band, **look)
        row[0].set_ylabel(value.outputs[i])
        row[0].set_ylim(1.05 * float(np.nanmin(value.auto[:, i], initial=-0.3)), 1.05)
    for each, name in zip(grid[0], ("autocorrelation", *value.inputs), strict=True):
        each.set_title(name, loc="left")
    for each in grid[-1]:
        each.set_xlabel("lag [s]")
    return as_given(ax, axes)


@_draw.register
def _(value: ResponseBand, ax: Any, pair: tuple[str, str] | None = None) -> Any:  # noqa: ANN401
    output, channel = pair or (value.outputs[0], value.inputs[0])
    known((output, channel), (*value.outputs, *value.inputs))
    place = slice(None), value.outputs.index(output), value.inputs.index(channel)
    axes = new_axes(ax, 2, 1, height=1.8)
    turn = figures.phase(value.G[place])
    half = 0.5 * np.degrees(np.ptp(value.phase()[(slice(None), *place)], axis=0))
    figures.plot_magnitude(axes[0], value.omega, value.G[place], name=OUTPUT_ERROR)
    figures.plot_phase(axes[1], value.omega, value.G[place], name=OUTPUT_ERROR)
    edges = figures.decibel(value.magnitude()[(slice(None), *place)])
    for each, low, high in ((axes[0], *edges), (axes[1], turn - half, turn + half)):
        each.fill_between(value.omega, low, high, color="#D55E00", alpha=0.2, linewidth=0)
        figures.frequency_axis(each, value.omega[0], value.omega[-1])
    axes[0].set_title(f"{output} / {channel}, {100 * value.level:.3g} % band", loc="left")
    axes[1].set_xlabel("ω [rad/s]")
    return as_given(ax, axes)


@_draw.register
def _(value: Qualification, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, len(value.records), 1, height=1.6)
    for each, record, row in zip(axes, value.records, value.largest, strict=True):
        colours = ["#0072B2" if x <= 1 else "#D55E00" for x in row]
        each.bar(value.outputs, np.where(np.isinf(row), 10.0, row), color=colours)  # or anything
        each.axhline(1.0, color="#000000", linestyle="--", linewidth=1)
        each.set_title(f"{record}: largest error over half the band", loc="left")
    return as_given(ax, axes)


@_draw.register
def _(value: Envelope, ax: Any, modes: bool = False) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 1 if modes else len(value.names), 1, height=2.8 if modes else 1.2)
    (plot_loci(axes[0], value) if modes else plot_derivatives(axes, value))
    return as_given(ax, axes)


@_draw.register
def _(value: Cover, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 1, 1, height=2.6)
    W = np.abs(value.weight.response(value.omega)[:, 0, 0])
    axes[0].loglog(value.omega, value.error, color="#000000", label="largest error of the models")
    axes[0].loglog(value.omega, W, color="#D55E00", label=f"weight of order {value.weight.nx}")
    axes[0].set(xlabel="ω [rad/s]", ylabel=f"{value.kind} error [-]")
    axes[0].legend()
    return as_given(ax, axes)


@_draw.register
def _(value: Distances, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 1, 1, height=0.8 + 0.2 * len(value.by_pair()))
    return as_given(ax, [plot_distances(axes[0], value)])


@_draw.register
def _(value: OrderSelection, ax: Any) -> Any:  # noqa: ANN401
    return as_given(ax, plot_order_selection(new_axes(ax, 1, 2, height=2.6), value))


@_draw.register
def _(value: Excitation, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, len(value.inputs), 1, height=1.3)
    for channel, each in enumerate(axes):
        figures.plot_excitation(each, value, channel).label_outer()
    axes[0].legend(loc="lower right", ncols=2)
    return as_given(ax, axes)


@_draw.register
def _(value: HandlingQualities | TransferFunction, ax: Any) -> Any:  # noqa: ANN401
    axes = new_axes(ax, 2, 1, height=2.0)
    if isinstance(value, HandlingQualities):
        plot_handling_qualities(axes[0], axes[1], value)
    else:
        plot_transfer_function(axes[0], axes[1], value)
    return as_given(ax, axes)


def _magnitudes(
    channels: FrequencyResponse | StateSpace | Undermodelling,
    omega: Array,
    G: ComplexArray | Array,
    width: Array,
    name: str,
    pair: tuple[str, str] | None,
    ax: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Magnitudes of one pair or of all, in rows of outputs and columns of inputs."""
    pairs = [pair] if pair else list(itertools.product(channels.outputs, channels.inputs))
    known([*itertools.chain(*pairs)], (*channels.outputs, *channels.inputs))
    shape = (1, 1) if pair else (len(channels.outputs), len(channels.inputs))
    axes = new_axes(ax, *shape, height=2.4 if pair else 1.2)
    figures.plot_magnitudes(axes, channels, pairs, omega, G, width, name)
    return as_given(ax, axes)


def _pair(
    measured: FrequencyResponse,
    systems: Mapping[str, StateSpace],
    pair: tuple[str, str],
    ax: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Magnitude, phase, coherence of one pair, models over it."""
    place, omega = measured.index(*pair), measured.omega
    axes = new_axes(ax, 3, 1, height=1.8)
    figures.plot_measured(axes[0], axes[1], measured, place)
    figures.plot_coherence(axes[2], measured, place)
    near = figures.phase(measured.G[:, place[0], place[1]])
    for name, system in systems.items():
        known(pair, (*system.outputs, *system.inputs))
        i, j = system.outputs.index(pair[0]), system.inputs.index(pair[1])
        G = system.response(omega)[:, i, j]
        figures.plot_magnitude(axes[0], omega, G, name=name, among=systems)
        figures.plot_phase(axes[1], omega, G, name=name, near=near, among=systems)
    axes[1].set_ylabel("phase [deg]")
    axes[0].set_title(f"{pair[0]} / {pair[1]}", loc="left")
    axes[0].legend(ncols=4)
    axes[2].set_xlabel("ω [rad/s]")
    for each in axes:
        figures.frequency_axis(each, omega[0], omega[-1])
    return as_given(ax, axes)


def _histories(
    found: Validation,
    channels: Sequence[str],
    units: Mapping[str, str],
    ax: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Outputs of each record below each other, models over them."""
    names = known(channels, found.outputs)
    axes = new_axes(ax, len(names), len(found.records), height=1.2)
    grid = axes.reshape(len(names), len(found.records))
    for k, record in enumerate(found.measured):
        t, axis = figures.elapsed(record.t)
        for each, name in zip(grid[:, k], names, strict=True):
            i = record.outputs.index(name)
            drawn = {model: y[k][:, i] for model, y in found.simulated.items()}
            figures.plot_history(each, t, record.y[:, i], drawn, channel=name, units=units)
            good = [f"{model} {found.fit[model][k, i]:.3g} %" for model in drawn]
            each.legend(["measured", *good], **ABOVE, ncols=len(good) + 1)
        grid[0, k].set_title(record.name, loc="left")
        grid[-1, k].set_xlabel(axis)
    return as_given(ax, axes)


def _clearest(data: FrequencyResponse) -> tuple[str, str]:
    """The pair of the largest mean coherence."""
    best = np.argmax(np.nanmean(data.coherence, axis=0))
    return data.outputs[best // len(data.inputs)], data.inputs[best % len(data.inputs)]
